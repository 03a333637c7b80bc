"""What stages made for a grid keep: lines of both families, whole where they cross, and one surface."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, DataError, StageError
from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import Aligner, Calibrator, Coder, Extractor, Triangulator
from roemetry.testing.cases import calibration_for, calibration_set_for
from roemetry.testing.checks.points import require_it_survives_its_file
from roemetry.testing.scenes import GridRig, frame_of, moved_grid
from roemetry.testing.verdict import refused, require

_FOUND_MIN = 0.99
"""Share of the places where lines cross rows that is found, and labelled."""
_CORRECTED_PX = 0.1
"""Lines whose peaks scatter by 0.05 px, over hundreds of rows, are known to a tenth of this."""
_SHIFT_PX = 0.8  # what an aligner corrects, not what it refuses


def check_lines_of_a_grid_are_right(extractor: Extractor[Any]) -> None:
    """Lines of both families are found in a noise-free image, within `tolerance_px`, also at crossings."""
    rig = GridRig()
    heights = rig.hill()
    peaks = extractor.extract(frame_of(rig.grid_light(heights)))
    for family, found, height in zip((rig, rig.across), _families(peaks), heights, strict=True):
        true = family.x_px(height)
        off = np.abs(true[:, found.row] - found.x_px).min(axis=0)
        limit = extractor.capabilities.tolerance_px
        require(bool((off <= limit).all()), f"errors up to {off.max():.3g} px, {limit:g} px are declared")
        share = len(found) / true.size
        require(share >= _FOUND_MIN, f"{share:.1%} of the lines is found")


def check_white_crossings_give_no_peak(extractor: Extractor[Any]) -> None:
    """Where two lines together saturate, no peak is off by more than `saturated_tolerance_px`."""
    rig = GridRig()
    heights = rig.hill(0.0)
    peaks = extractor.extract(frame_of(rig.grid_light(heights, 180.0)))
    for family, found, height in zip((rig, rig.across), _families(peaks), heights, strict=True):
        off = float(np.abs(family.x_px(height)[:, found.row] - found.x_px).min(axis=0).max(initial=0.0))
        limit = extractor.capabilities.saturated_tolerance_px
        require(off <= limit, f"errors up to {off:.3g} px, {limit:g} px are declared")


def check_dark_gives_no_line(extractor: Extractor[Any]) -> None:
    """An image without light gives no peak of either family, with the sensor's noise on it."""
    peaks = extractor.extract(frame_of(np.full((120, 160), 10.0), noise=2.0))
    count = sum(len(found) for found in _families(peaks))
    require(count == 0, f"{count} peaks in the dark")


def check_a_colour_frame_of_a_grid_is_refused(extractor: Extractor[Any]) -> None:
    """A frame with colours is refused by a `DataError`, and the smallest frames give nothing."""
    with refused("a frame with colours", DataError):
        extractor.extract(Frame(np.zeros((60, 80, 3), np.uint8)))
    for shape in ((1, 1), (2, 9)):
        peaks = extractor.extract(Frame(np.zeros(shape, np.uint8)))
        require(sum(len(found) for found in _families(peaks)) == 0, f"peaks in a dark frame of {shape}")


def check_a_camera_over_a_grid_at_rest_is_left_alone(aligner: Aligner[Any]) -> None:
    """Where both families lie as calibrated, under a product, there is no correction and no reason."""
    rig = GridRig()
    found = aligner.align(rig.grid_peaks(_product(rig)), rig.grid_calibration(), moved_grid)
    require(not found.moved, f"a motion of {found.motion} is corrected where nothing has moved")
    require(not found.reasons, f"it says {[reason.code for reason in found.reasons]} of a belt at rest")


def check_a_moved_camera_over_a_grid_is_corrected(aligner: Aligner[Any]) -> None:
    """Shifts, a rotation and a zoom of about 0.8 px are corrected to within 0.1 px, with a reason."""
    rig = GridRig()
    made = rig.grid_calibration()
    for motion in ((0.8, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 8e-4), (0.0, 7e-3, 0.0, 0.0), (0.0, 0.0, 7e-3, 0.0)):
        moved = moved_grid(made, Alignment(np.array(motion), np.zeros((4, 4))))
        found = aligner.align(_seen_after(rig, moved), made, moved_grid)
        require(found.moved and bool(found.reasons), f"{motion} is not seen, or corrected in silence")
        corrected = moved_grid(made, found)
        for one, other in ((corrected, moved), (corrected.across, moved.across)):
            assert one is not None and other is not None
            rows = np.arange(one.image_size[0], dtype=np.float64)
            off = float(np.abs(one.rest_line_px(rows) - other.rest_line_px(rows)).max())
            require(off <= _CORRECTED_PX, f"after {motion} the corrected lines are up to {off:.2g} px off")


def check_a_grid_far_off_is_refused(aligner: Aligner[Any]) -> None:
    """A grid shifted by 5 px, or turned by 8°, and peaks of one family are refused by a `StageError`."""
    rig = GridRig()
    made = rig.grid_calibration()
    for motion in ((5.0, 0.0, 0.0, 0.0), (0.0, np.radians(8.0), 0.0, 0.0)):
        moved = moved_grid(made, Alignment(np.array(motion), np.zeros((4, 4))))
        with refused(f"a motion of {motion}", StageError):
            aligner.align(_seen_after(rig, moved), made, moved_grid)
    with refused("peaks of one family", StageError):
        aligner.align(replace(rig.grid_peaks(rig.hill()), across=None), made, moved_grid)


def check_a_belt_without_a_grid_is_told(aligner: Aligner[Any]) -> None:
    """Where no line is seen there is no correction, and a reason says that nothing was compared."""
    rig = GridRig()
    upright, across = (np.full_like(height, np.nan) for height in rig.hill())
    found = aligner.align(rig.grid_peaks((upright, across)), rig.grid_calibration(), moved_grid)
    require(not found.moved, "it corrects by a belt that is not seen")
    require(bool(found.reasons), "it says nothing of a belt that is not seen")


def _product(rig: GridRig) -> tuple[Floats, Floats]:
    """Give heights of both families of a hill that stands on the belt with an edge."""
    upright, across = (np.where(height > 2.0, height, 0.0) for height in rig.hill())
    return upright, across


def _seen_after(rig: GridRig, moved: Calibration) -> Peaks:
    """Give peaks of the product, seen by a camera that has moved since the rig's calibration."""
    found = []
    for family, made, height in zip((rig, rig.across), (moved, moved.across), _product(rig), strict=True):
        assert made is not None
        rest = made.rest_line_px(np.arange(family.rows, dtype=np.float64))
        found.append(family.peaks(rest + family.px_per_mm * height, scatter_px=0.05).peaks)
    return replace(found[0], across=found[1])


def check_a_hill_of_a_grid_is_coded(coder: Coder[Any]) -> None:
    """On a dome at least 99 % of the peaks of both families are labelled, and none wrongly."""
    rig = GridRig()
    heights = rig.hill()
    stripes = coder.code(rig.grid_peaks(heights), rig.grid_calibration())
    require(stripes.across is not None, "there are no lines across")
    assert stripes.across is not None
    families = zip((rig, rig.across), (stripes, stripes.across), heights, strict=True)
    for family, found, height in families:
        off = np.abs(found.x_px - family.x_px(height))[found.seen]
        wrong = int((off > 1.0).sum())
        require(wrong == 0, f"{wrong} peaks carry another line's label")
        share = found.seen.sum() / height.size
        require(share >= _FOUND_MIN, f"{share:.1%} of the peaks are labelled")
        products = np.unique(found.product[height > 1.0])
        require(products.tolist() == [1], f"the dome is product {products.tolist()} in both families")


def check_families_that_contradict_are_refused(coder: Coder[Any]) -> None:
    """With the lines across of another scene, the product has no point, or a `StageError` is raised."""
    rig = GridRig()
    mixed = rig.hill(19.0)[0], rig.hill(0.0)[1]
    try:
        stripes = coder.code(rig.grid_peaks(mixed), rig.grid_calibration())
    except StageError:
        return
    crossed = stripes.product[:, rig.rows // 2 - 4 : rig.rows // 2 + 5][1:-1] > 0
    require(not crossed.any(), "stripes keep heights that the lines across contradict")


def check_one_family_is_refused(coder: Coder[Any]) -> None:
    """Peaks, and a calibration, of one family of lines are refused by a `StageError`."""
    rig = GridRig()
    peaks = rig.grid_peaks(rig.hill())
    with refused("peaks of one family", StageError):
        coder.code(replace(peaks, across=None), rig.grid_calibration())
    with refused("a calibration of one family", StageError):
        coder.code(peaks, replace(rig.grid_calibration(), across=None))
    with refused("no calibration", StageError):
        coder.code(peaks, None)


def check_both_families_lie_on_the_surface(triangulator: Triangulator[Any]) -> None:
    """Exact lines of both families give every point within the declared `height_tolerance_mm`."""
    rig = GridRig()
    heights = rig.hill()
    profiles = triangulator.triangulate(rig.grid_map(heights), calibration_for(triangulator, rig))
    down, across = (family.xyz_mm(height) for family, height in zip((rig, rig.across), heights, strict=True))
    # the turned image's X is the image's −Y, and its Y the image's X
    across = np.stack([across[..., 1], -across[..., 0], across[..., 2]], axis=2)
    limit = triangulator.capabilities.height_tolerance_mm
    for true, found in (
        (down, profiles.xyz_mm[: rig.stripes, : rig.rows]),
        (across, profiles.xyz_mm[rig.stripes :, : rig.columns]),
    ):
        off = float(np.abs(true - found).max())
        require(off <= limit, f"points are off by up to {off:.3g} mm, {limit:g} mm are declared")


def check_other_grids_are_refused(triangulator: Triangulator[Any]) -> None:
    """Lines of one family, and another number of lines, are refused by a `StageError`."""
    rig = GridRig()
    calibration, seen = calibration_for(triangulator, rig), rig.grid_map(rig.hill())
    few = GridRig(lines=3)
    for what, other in (
        ("one family", replace(seen, across=None)),
        ("three lines", few.grid_map(few.hill())),
    ):
        with refused(what, StageError):
            triangulator.triangulate(other, calibration)


def check_a_moved_camera_gives_both_families(triangulator: Triangulator[Any]) -> None:
    """A calibration corrected for a small motion gives correct heights of the moved lines."""
    rig = GridRig()
    calibration = calibration_for(triangulator, rig)
    if type(triangulator).moved is Triangulator.moved:
        return
    motion = Alignment(np.array([_SHIFT_PX, 0.0, 0.0, 0.0]), np.zeros((4, 4)))
    moved = triangulator.moved(calibration, motion)
    require(moved.across is not None, "there are no lines across")
    assert moved.across is not None and calibration.across is not None
    for what, one, other, by in (
        ("stripes", moved, calibration, _SHIFT_PX),
        ("lines across", moved.across, calibration.across, 0.0),
    ):
        rows = np.arange(one.image_size[0], dtype=np.float64)
        off = float(np.abs(one.rest_line_px(rows) - other.rest_line_px(rows) - by).max())
        require(off <= 0.05, f"{what} on the belt are up to {off:.2g} px beside where they are seen")


def check_both_families_come_back(calibrator: Calibrator[Any]) -> None:
    """Rest lines of both families are recovered within `tolerance_px`; one family or no image is refused."""
    rig = GridRig()
    observed = calibration_set_for(calibrator, rig)
    calibration = calibrator.calibrate(observed)
    require(calibration.across is not None, "there are no lines across")
    assert calibration.across is not None
    for family, found in ((rig, calibration), (rig.across, calibration.across)):
        off = float(
            np.abs(found.rest_line_px(np.arange(family.rows, dtype=np.float64)) - family.rest_px()).max()
        )
        limit = calibrator.capabilities.tolerance_px
        require(off <= limit, f"rest lines are off by up to {off:.3g} px, {limit:g} px are declared")
    require_it_survives_its_file(calibration)
    one_family = tuple(replace(one, peaks=replace(one.peaks, across=None)) for one in observed.observations)
    for what, other in (
        ("peaks of one family", replace(observed, observations=one_family)),
        ("a set without observations", replace(observed, observations=())),
    ):
        with refused(what, CalibrationError):
            calibrator.calibrate(other)


def _families(peaks: Peaks) -> tuple[Peaks, Peaks]:
    require(peaks.across is not None, "it gives no lines across")
    assert peaks.across is not None
    return peaks, peaks.across
