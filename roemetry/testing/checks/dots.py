"""What stages made for a matrix of dots keep: centres, labels, points and rays where the scene has them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, StageError
from roemetry.records import SATURATED, WIDE, Peaks, StripeMap
from roemetry.records.arrays import Flags, Floats
from roemetry.records.calibration import Alignment
from roemetry.records.light import at_height
from roemetry.stages import Calibrator, Coder, Extractor, Triangulator
from roemetry.testing.cases import calibration_for, calibration_set_for
from roemetry.testing.checks.points import require_it_survives_its_file
from roemetry.testing.patterns import DotRig
from roemetry.testing.scenes import SEED, frame_of
from roemetry.testing.verdict import refused, require, within

_NEAR_PX = 3.0
"""Down the rows, within which what is found belongs to a pair of merged dots."""
_LABELLED_MIN = 0.99
"""Share of drawn dots, sound and seen, that a coder labels."""
_SHIFT_PX = 0.8  # what an aligner corrects, not what it refuses


def check_dots_are_right(extractor: Extractor[Any]) -> None:
    """Every dot of a noise-free image is found once, within the declared `tolerance_px`, and nothing else."""
    rig = DotRig()
    places = rig.places_px(rig.hill()).reshape(-1, 2)
    off = _off_px(extractor.extract(frame_of(rig.spots(places))), places)
    require(off.size == len(places), f"{off.size} dots are found, {len(places)} are there")
    within(off, extractor.capabilities.tolerance_px, "errors")


def check_brightness_of_dots_does_not_matter(extractor: Extractor[Any]) -> None:
    """An image 1.3 times as bright, or of 12 bit, gives the same dots, unflagged ones within 0.02 px."""
    rig = DotRig()
    light = rig.spots(rig.places_px(rig.hill()), 120.0)
    one = extractor.extract(frame_of(light))
    for other in (frame_of(1.3 * light), frame_of(light, bit_depth=12)):
        found = extractor.extract(other)
        require(len(found) == len(one), f"{len(one)} dots, then {len(found)}")
        sound = found.flags == 0
        require(bool(sound.any()), "no dot is without a flag")
        off = float(_off_px(found, np.column_stack([one.x_px, _y(one)]))[sound].max())
        require(off < 0.02, f"dots move by up to {off:.3g} px")


def check_saturated_dots_are_flagged(extractor: Extractor[Any]) -> None:
    """A dot at the white level is flagged `SATURATED`, and right within `saturated_tolerance_px`."""
    rig = DotRig()
    places = rig.places_px(rig.level()).reshape(-1, 2)
    bright = np.arange(len(places)) % 5 == 0
    peaks = extractor.extract(frame_of(rig.spots(places, np.where(bright, 900.0, 160.0))))
    off = _off_px(peaks, places)
    flagged = (peaks.flags & SATURATED) > 0
    require(
        int(flagged.sum()) == int(bright.sum()), f"{int(flagged.sum())} of {int(bright.sum())} are flagged"
    )
    within(off, extractor.capabilities.saturated_tolerance_px, "errors")


def check_merged_dots_are_no_sound_dot(extractor: Extractor[Any]) -> None:
    """Two dots 4 px apart are found as two or flagged `WIDE`; there is no unflagged dot between them."""
    rig = DotRig()
    places = rig.places_px(rig.level()).reshape(-1, 2)
    first = places[len(places) // 2]
    both = np.concatenate([places, [first + np.array([4.0, 0.0])]])
    peaks = extractor.extract(frame_of(rig.spots(both)))
    here = np.abs(peaks.x_px - first[0] - 2.0) < 5.0
    here &= np.abs(_y(peaks) - first[1]) < _NEAR_PX
    sound = here & ((peaks.flags & WIDE) == 0)
    between = np.abs(peaks.x_px[sound] - first[0] - 2.0) < 1.0
    require(not between.any(), "a dot is given where two have merged")


def check_covariances_of_dots_are_positive(extractor: Extractor[Any]) -> None:
    """Every covariance of a noisy image's dots is positive definite, or NaN."""
    rig = DotRig()
    peaks = extractor.extract(frame_of(rig.spots(rig.places_px(rig.hill())), noise=2.0))
    require(peaks.dots is not None, "it gives no dots")
    assert peaks.dots is not None
    covariance = peaks.dots.covariance_px2
    known = covariance[np.isfinite(covariance).all(axis=(1, 2))]
    require(bool((np.linalg.eigvalsh(known) > 0.0).all()), "a covariance is not positive definite")


def check_a_hill_of_dots_is_coded(coder: Coder[Any]) -> None:
    """On a dome at least 99 % of the dots are labelled with column and line, and none wrongly."""
    rig = DotRig()
    for height_mm in (3.0, 10.0, 20.0):
        _coded(coder, rig, rig.hill(height_mm), np.ones((rig.stripes, rig.lines), np.bool_))


def check_missing_dots_shift_nothing(coder: Coder[Any]) -> None:
    """Hidden dots, one in five and a whole column, change no label of other dots."""
    rig = DotRig()
    shown = np.random.default_rng(7).uniform(size=(rig.stripes, rig.lines)) > 0.2
    shown[4] = False
    _coded(coder, rig, rig.hill(), shown)


def check_a_step_of_dots_is_not_mistaken(coder: Coder[Any]) -> None:
    """A box of 15 mm, whose walls no dot shows, is labelled correctly or not at all."""
    rig = DotRig()
    heights = rig.level()
    heights[3:8, 2:7] = 15.0
    coded = coder.code(rig.dots(rig.places_px(heights)), rig.dot_calibration())
    wrong = int((_labels_of(coded, rig, heights)[0] > 0).sum())
    require(wrong == 0, f"{wrong} dots carry another dot's label")


def check_half_the_dots_are_refused(coder: Coder[Any]) -> None:
    """An image in which every second dot is missing is refused by a `StageError`."""
    rig = DotRig()
    shown = np.add.outer(np.arange(rig.stripes), np.arange(rig.lines)) % 2 == 0
    with refused("half of the dots", StageError):
        coder.code(_seen(rig, rig.level(), shown), rig.dot_calibration())


def check_another_pattern_is_refused(coder: Coder[Any]) -> None:
    """Random dots, and the matrix with columns and lines exchanged, are refused by a `StageError`."""
    rig = DotRig()
    places = rig.places_px(rig.level()).reshape(-1, 2)
    middle = places.mean(axis=0)
    random = np.random.default_rng(SEED).uniform(
        [5.0, 5.0], [rig.columns - 5.0, rig.rows - 5.0], places.shape
    )
    for what, other in (
        ("random dots", random),
        ("a matrix on its side", middle + (places - middle)[:, ::-1]),
    ):
        with refused(what, StageError):
            coder.code(rig.dots(other), rig.dot_calibration())


def check_lines_are_refused(coder: Coder[Any]) -> None:
    """Peaks of lines, and a calibration without rays, are refused by a `StageError`."""
    rig = DotRig()
    peaks = rig.dots(rig.places_px(rig.level()))
    with refused("peaks of lines", StageError):
        coder.code(replace(peaks, dots=None), rig.dot_calibration())
    with refused("a calibration without rays", StageError):
        coder.code(peaks, replace(rig.dot_calibration(), rays=None))


def check_dots_are_where_the_scene_is(triangulator: Triangulator[Any]) -> None:
    """Exact dots give every point within the declared `height_tolerance_mm`; unseen ones give none."""
    rig = DotRig()
    heights = rig.hill()
    heights[3, 4] = heights[5] = np.nan
    stripes = rig.dot_map(heights)
    profiles = triangulator.triangulate(stripes, calibration_for(triangulator, rig))
    assert stripes.dots is not None
    stripe, row = np.nonzero(stripes.seen)
    truth = rig.points_mm(heights)[stripe, stripes.dots.line[stripe, row]]
    off = np.linalg.norm(profiles.xyz_mm[stripe, row] - truth, axis=1)
    within(off, triangulator.capabilities.height_tolerance_mm, "points are off by", "mm")
    found = int(np.isfinite(profiles.xyz_mm[..., 0]).sum())
    require(found == stripe.size, f"{found} points from {stripe.size} dots")
    require(not (profiles.height_std_mm < 0.0).any(), "height_std_mm is negative")


def check_other_dots_are_refused(triangulator: Triangulator[Any]) -> None:
    """Lines, another number of columns and another image are refused by a `StageError`."""
    rig = DotRig()
    calibration, seen = calibration_for(triangulator, rig), rig.dot_map(rig.hill())
    few, small = DotRig(stripes=7), DotRig(rows=210)
    for what, other in (
        ("lines", replace(seen, dots=None)),
        ("seven columns", few.dot_map(few.hill())),
        ("210 rows", small.dot_map(small.hill())),
    ):
        with refused(what, StageError):
            triangulator.triangulate(other, calibration)


def check_a_moved_camera_gives_the_same_dots(triangulator: Triangulator[Any]) -> None:
    """A calibration corrected for a small motion has the belt's dots where the image shows them."""
    rig = DotRig()
    calibration = calibration_for(triangulator, rig)
    if type(triangulator).moved is Triangulator.moved:
        return
    motion = Alignment(np.array([_SHIFT_PX, 0.0, 0.0, 0.0]), np.diag([1e-4, 0.0, 0.0, 0.0]))
    moved = triangulator.moved(calibration, motion)
    before, after = calibration.view, triangulator.view(moved)
    require(before is not None and after is not None, "there is no view")
    assert before is not None and after is not None and moved.rays is not None
    belt = rig.points_mm(rig.level())
    lines = moved.rays.moved(moved.parameters).reshape(-1, 4)
    shift = after.project(at_height(lines, 0.0)) - before.project(belt).reshape(-1, 2)
    off = float(np.abs(shift - [_SHIFT_PX, 0.0]).max())
    require(off <= 0.05, f"the belt's dots are up to {off:.2g} px beside where the camera shows them")
    wider = float(np.trace(moved.covariance) - np.trace(calibration.covariance))
    require(wider > 0.0, "the motion's uncertainty is not in the calibration's covariance")


def check_rays_come_back(calibrator: Calibrator[Any]) -> None:
    """Rays meet the belt where dots are seen, with the rig's spacing and divergence; the file is complete."""
    rig = DotRig()
    observed = calibration_set_for(calibrator, rig)
    calibration = calibrator.calibrate(observed)
    require(calibration.rays is not None and calibration.view is not None, "there are no rays")
    assert calibration.rays is not None and calibration.view is not None
    found, true = calibration.rays.lines.reshape(-1, 4), rig.rays().reshape(-1, 4)
    known = np.isfinite(found[:, 0])
    require(float(known.mean()) >= 0.8, f"{known.mean():.0%} of the rays are found")
    found, true = found[known], true[known]
    belt = observed.showing("belt")[0].peaks
    seen = np.column_stack([belt.x_px, _y(belt)])
    places = calibration.view.project(at_height(found, 0.0))
    off = float(np.linalg.norm(places[:, None] - seen[None], axis=2).min(axis=1).max())
    within(off, calibrator.capabilities.tolerance_px, "rays meet the belt beside their dots by")
    # where the frame's origin lies depends on the camera's middle: distances do not
    apart, slopes = (
        np.linalg.norm(found[:, part] - found[:, part].mean(axis=0), axis=1)
        / np.linalg.norm(true[:, part] - true[:, part].mean(axis=0), axis=1)
        for part in (slice(0, 2), slice(2, 4))
    )
    share = calibrator.capabilities.relative_tolerance
    for what, ratio in (("distances of the rays on the belt", apart), ("how rays diverge", slopes)):
        wrong = abs(float(np.median(ratio)) - 1.0)
        require(wrong <= share, f"{what}: off by {wrong:.2%}, {share:.2%} are declared")
    require_it_survives_its_file(calibration)


def check_a_wrong_number_of_dots_is_refused(calibrator: Calibrator[Any]) -> None:
    """A wrong number of columns, and a set without images, are refused by a `CalibrationError`."""
    observed = calibration_set_for(calibrator, DotRig())
    for what, other in (
        ("nine columns where fifteen are seen", replace(observed, stripe_count=9)),
        ("a set without observations", replace(observed, observations=())),
    ):
        with refused(what, CalibrationError):
            calibrator.calibrate(other)


def _y(peaks: Peaks) -> Floats:
    assert peaks.dots is not None, "it gives peaks of lines"
    return peaks.dots.y_px


def _off_px(peaks: Peaks, places: Floats) -> Floats:
    """Distances of the peaks from the nearest true dot, px."""
    found = np.column_stack([peaks.x_px, _y(peaks)])
    return np.asarray(np.linalg.norm(found[:, None] - places[None], axis=2).min(axis=1))


def _seen(rig: DotRig, heights: Floats, shown: Flags) -> Peaks:
    return rig.dots(np.where(shown[..., None], rig.places_px(heights), np.nan))


def _labels_of(coded: StripeMap, rig: DotRig, heights: Floats) -> tuple[Floats, Floats]:
    """Give (stripe, line): 1 where a dot's label is another's; and 1 where a dot is labelled rightly."""
    assert coded.dots is not None
    places = rig.places_px(heights)
    wrong, right = np.zeros(heights.shape), np.zeros(heights.shape)
    for stripe, row in np.argwhere(coded.seen):
        here = np.array([coded.x_px[stripe, row], coded.dots.y_px[stripe, row]])
        nearest = np.nanargmin(np.linalg.norm(places - here, axis=2))
        true = np.unravel_index(int(nearest), heights.shape)
        same = true == (stripe, coded.dots.line[stripe, row])
        (right if same else wrong)[true] = 1.0
    return wrong, right


def _coded(coder: Coder[Any], rig: DotRig, heights: Floats, shown: Flags) -> None:
    coded = coder.code(_seen(rig, heights, shown), rig.dot_calibration())
    wrong, right = _labels_of(coded, rig, heights)
    require(not wrong.any(), f"{int(wrong.sum())} dots carry another dot's label")
    share = float(right[shown].mean())
    require(share >= _LABELLED_MIN, f"{share:.1%} of the dots are labelled, {_LABELLED_MIN:.0%} expected")
    off_belt = (coded.product > 0).any()
    require(bool(off_belt), "no dot of the dome is on a product")
