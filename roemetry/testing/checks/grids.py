"""What stages made for a grid keep: lines of both families, whole where they cross, and one surface."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, StageError
from roemetry.records import Peaks
from roemetry.records.calibration import Alignment
from roemetry.stages import Calibrator, Coder, Extractor, Triangulator
from roemetry.testing.cases import calibration_for, calibration_set_for
from roemetry.testing.checks.points import require_it_survives_its_file
from roemetry.testing.scenes import GridRig, frame_of
from roemetry.testing.verdict import refused, require, within

_FOUND_MIN = 0.99
"""Share of the places where lines cross rows that is found, and labelled."""
_SHIFT_PX = 0.8  # what an aligner corrects, not what it refuses


def check_lines_of_a_grid_are_right(extractor: Extractor[Any]) -> None:
    """Lines of both families are found in a noise-free image, within `tolerance_px`, also at crossings."""
    rig = GridRig()
    heights = rig.hill()
    peaks = extractor.extract(frame_of(rig.grid_light(heights)))
    for family, found, height in zip((rig, rig.across), _families(peaks), heights, strict=True):
        true = family.x_px(height)
        off = np.abs(true[:, found.row] - found.x_px).min(axis=0)
        within(off, extractor.capabilities.tolerance_px, "errors")
        share = len(found) / true.size
        require(share >= _FOUND_MIN, f"{share:.1%} of the lines is found")


def check_white_crossings_give_no_peak(extractor: Extractor[Any]) -> None:
    """Where two lines together saturate, no peak is off by more than `saturated_tolerance_px`."""
    rig = GridRig()
    heights = rig.hill(0.0)
    peaks = extractor.extract(frame_of(rig.grid_light(heights, 180.0)))
    for family, found, height in zip((rig, rig.across), _families(peaks), heights, strict=True):
        off = np.abs(family.x_px(height)[:, found.row] - found.x_px).min(axis=0)
        within(off, extractor.capabilities.saturated_tolerance_px, "errors")


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
        within(np.abs(true - found), limit, "points are off by", "mm")


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
        off = np.abs(found.rest_line_px(np.arange(family.rows, dtype=np.float64)) - family.rest_px())
        within(off, calibrator.capabilities.tolerance_px, "rest lines are off by")
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
