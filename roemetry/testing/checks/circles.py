"""What stages made for circles keep: curves, labels, points and cones where the scene has them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, StageError
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment
from roemetry.records.view import STEEP_MAX
from roemetry.stages import Calibrator, Coder, Extractor, Triangulator
from roemetry.testing.cases import calibration_for, calibration_set_for
from roemetry.testing.checks.points import require_it_survives_its_file
from roemetry.testing.patterns import CircleRig, level
from roemetry.testing.scenes import frame_of
from roemetry.testing.verdict import refused, require, within

_FOUND_MIN = 0.95
"""Share of the rows of halves that are found: ends may be left out, and so may what bends within a width."""
_LABELLED_MIN = 0.99
"""Share of drawn places that a coder labels."""
_SHIFT_PX = 0.8  # what an aligner corrects, not what it refuses


def check_circles_are_right(extractor: Extractor[Any]) -> None:
    """Halves of a noise-free image's circles are found where they cross rows, within `tolerance_px`."""
    rig = CircleRig()
    surface = rig.circle_dome(8.0)
    peaks = extractor.extract(frame_of(rig.circle_light(surface)))
    # what is steep is not asked for, and right where it is given
    off = np.abs(peaks.x_px - rig.x_on_rows(surface, steepest=2.0 * STEEP_MAX)[:, peaks.row])
    near = np.where(np.isfinite(off), off, np.inf).min(axis=0)
    within(near, extractor.capabilities.tolerance_px, "errors")
    share = near.size / np.isfinite(rig.x_on_rows(surface)).sum()
    require(share >= _FOUND_MIN, f"{share:.1%} of the places are found, {_FOUND_MIN:.0%} expected")


def check_a_dome_of_circles_is_coded(coder: Coder[Any]) -> None:
    """On a dome at least 99 % of the places are labelled, none wrongly, and the dome is a product."""
    rig = CircleRig()
    for height_mm in (3.0, 10.0, 20.0):
        peaks, stripe = rig.circle_peaks(rig.x_on_rows(rig.circle_dome(height_mm)))
        coded = coder.code(peaks, rig.circle_calibration())
        labelled = coded.peak_stripe >= 0
        wrong = int((labelled & (coded.peak_stripe != stripe)).sum())
        require(wrong == 0, f"{wrong} places carry another half's label")
        share = float(labelled.mean())
        require(share >= _LABELLED_MIN, f"{share:.1%} are labelled, {_LABELLED_MIN:.0%} expected")
        require(bool((coded.product > 0).any()), "no place of the dome is on a product")


def check_a_box_under_circles_is_not_mistaken(coder: Coder[Any]) -> None:
    """A box of 12 mm, whose walls no circle shows, is labelled correctly or not at all."""
    rig = CircleRig()

    def box(xy_mm: Floats) -> Floats:
        return np.where((np.abs(xy_mm[:, 0] + 3.0) < 14.0) & (np.abs(xy_mm[:, 1]) < 9.0), 12.0, 0.0)

    peaks, stripe = rig.circle_peaks(rig.x_on_rows(box))
    coded = coder.code(peaks, rig.circle_calibration())
    wrong = int(((coded.peak_stripe >= 0) & (coded.peak_stripe != stripe)).sum())
    require(wrong == 0, f"{wrong} places carry another half's label")


def check_light_that_is_no_circle_is_refused(coder: Coder[Any]) -> None:
    """Straight lines, and a calibration without cones, are refused by a `StageError`."""
    rig = CircleRig()
    lines = np.broadcast_to(np.linspace(20.0, 300.0, rig.stripes)[:, None], (rig.stripes, rig.rows))
    with refused("straight lines", StageError):
        coder.code(rig.circle_peaks(lines)[0], rig.circle_calibration())
    made = rig.circle_calibration()
    assert made.view is not None
    peaks = rig.circle_peaks(rig.x_on_rows(level))[0]
    with refused("a calibration without cones", StageError):
        coder.code(peaks, replace(made, view=replace(made.view, cones=np.empty((0, 7)))))


def check_circles_are_where_the_scene_is(triangulator: Triangulator[Any]) -> None:
    """Exact places give every point on the surface within `height_tolerance_mm`; unseen ones give none."""
    rig = CircleRig()
    surface = rig.circle_dome(10.0)
    x_px = rig.x_on_rows(surface)
    x_px[3] = np.nan
    profiles = triangulator.triangulate(rig.circle_map(x_px), calibration_for(triangulator, rig))
    xyz = profiles.xyz_mm[np.isfinite(x_px)]
    off = np.abs(xyz[:, 2] - surface(xyz[:, :2]))
    within(off, triangulator.capabilities.height_tolerance_mm, "heights are off by", "mm")
    require(bool(np.isnan(profiles.xyz_mm[~np.isfinite(x_px)]).all()), "points where nothing is seen")
    require(not (profiles.height_std_mm < 0.0).any(), "height_std_mm is negative")


def check_other_circles_are_refused(triangulator: Triangulator[Any]) -> None:
    """Another number of halves and another image are refused by a `StageError`."""
    rig = CircleRig()
    calibration = calibration_for(triangulator, rig)
    for what, other in (("eight halves", CircleRig(stripes=8)), ("210 rows", CircleRig(rows=210))):
        with refused(what, StageError):
            triangulator.triangulate(other.circle_map(other.x_on_rows(level)), calibration)


def check_a_moved_camera_gives_the_same_circles(triangulator: Triangulator[Any]) -> None:
    """A calibration corrected for a small motion has the belt's circles where the image shows them."""
    rig = CircleRig()
    calibration = calibration_for(triangulator, rig)
    if type(triangulator).moved is Triangulator.moved:
        return
    motion = Alignment(np.array([_SHIFT_PX, 0.0, 0.0, 0.0]), np.diag([1e-4, 0.0, 0.0, 0.0]))
    moved = triangulator.moved(calibration, motion)
    rows = np.arange(rig.rows, dtype=np.float64)
    shift = (moved.rest_line_px(rows) - calibration.rest_line_px(rows))[:, rig.rows // 2]
    off = float(np.abs(shift - _SHIFT_PX).max())
    require(off <= 0.05, f"the belt's circles are up to {off:.2g} px beside where the camera shows them")
    wider = float(np.trace(moved.covariance) - np.trace(calibration.covariance))
    require(wider > 0.0, "the motion's uncertainty is not in the calibration's covariance")


def check_cones_come_back(calibrator: Calibrator[Any]) -> None:
    """Cones meet the belt where circles are seen, and move with height as the rig's; the file is complete."""
    rig = CircleRig()
    calibration = calibrator.calibrate(calibration_set_for(calibrator, rig))
    view = calibration.view
    require(view is not None and len(view.cones) == rig.stripes, "there are no cones")
    # a half's last rows are told by its slope, which the found camera sees a row beside
    rows, true = np.arange(rig.rows, dtype=np.float64), rig.x_on_rows(level, steepest=0.8 * STEEP_MAX)
    off = float(np.nanmax(np.abs(calibration.rest_line_px(rows) - true)))
    within(off, calibrator.capabilities.tolerance_px, "circles lie beside the true ones by")
    middle = rig.x_on_rows(lambda xy: np.full(len(xy), 10.0))[:, rig.rows // 2]
    assert view is not None
    row = np.full(rig.stripes, rig.rows // 2)
    lifted = view.lift(np.column_stack([middle, row]), np.arange(rig.stripes))[:, 2]
    wrong = abs(float(np.median(lifted)) / 10.0 - 1.0)
    share = calibrator.capabilities.relative_tolerance
    require(wrong <= share, f"10 mm are off by {wrong:.2%}, {share:.2%} are declared")
    require_it_survives_its_file(calibration)


def check_a_wrong_number_of_circles_is_refused(calibrator: Calibrator[Any]) -> None:
    """A wrong number of circles, and a set without images, are refused by a `CalibrationError`."""
    observed = calibration_set_for(calibrator, CircleRig())
    for what, other in (
        ("four circles where five are seen", replace(observed, stripe_count=8)),
        ("six circles where five are seen", replace(observed, stripe_count=12)),
        ("a set without observations", replace(observed, observations=())),
    ):
        with refused(what, CalibrationError):
            calibrator.calibrate(other)
