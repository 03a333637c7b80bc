"""What every calibrator and triangulator keeps: a known rig comes back, points lie where the scene is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import CalibrationError, StageError
from roemetry.records import Profiles
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.stages import Calibrator, Triangulator
from roemetry.testing.cases import calibration_for, calibration_set_for
from roemetry.testing.scenes import SEED, LinearRig
from roemetry.testing.verdict import difference, refused, require, within


def check_rest_lines_come_back(calibrator: Calibrator[Any]) -> None:
    """Every stripe's rest line is recovered within the declared `tolerance_px`, on every row."""
    rig = LinearRig()
    calibration = calibrator.calibrate(calibration_set_for(calibrator, rig))
    off = np.abs(calibration.rest_line_px(np.arange(rig.rows, dtype=np.float64)) - rig.rest_px())
    within(off, calibrator.capabilities.tolerance_px, "rest lines are off by")


def check_displacements_come_back_with_their_sign(calibrator: Calibrator[Any]) -> None:
    """Every stripe's px per mm is recovered within the `relative_tolerance`, with the right sign."""
    for rig in (LinearRig(), LinearRig().mirrored()):
        found = calibrator.calibrate(calibration_set_for(calibrator, rig)).displacement_px_per_mm
        off = np.abs(found / rig.px_per_mm - 1.0).max()
        limit = calibrator.capabilities.relative_tolerance
        require(off <= limit, f"displacements per mm are off by up to {off:.2%}, {limit:.2%} are declared")


def check_the_covariance_can_be_drawn_from(calibrator: Calibrator[Any]) -> None:
    """The covariance is symmetric and positive semidefinite, and draws from it give finite parameters."""
    calibration = calibrator.calibrate(calibration_set_for(calibrator, LinearRig()))
    covariance = calibration.covariance
    require(bool(np.isfinite(covariance).all()), "the covariance is not finite")
    require(np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0), "the covariance is not symmetric")
    lowest, highest = np.linalg.eigvalsh(covariance)[[0, -1]]
    require(lowest >= -1e-9 * highest, f"the covariance has the eigenvalue {lowest:.3g}")
    drawn = calibration.redraw(np.random.default_rng(SEED)).parameters
    require(all(bool(np.isfinite(a).all()) for a in drawn.values()), "drawn parameters are not finite")


def check_it_survives_its_file(calibrator: Calibrator[Any]) -> None:
    """The calibration can be written to a file and read again unchanged."""
    require_it_survives_its_file(calibrator.calibrate(calibration_set_for(calibrator, LinearRig())))


def require_it_survives_its_file(calibration: Calibration) -> None:
    """Require that a calibration, written to a file and read again, has not changed."""
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        calibration.save(path)
        found = difference(calibration.to_dict(), type(calibration).load(path).to_dict())
    require(found is None, f"read again, {found}")


def check_no_image_is_refused(calibrator: Calibrator[Any]) -> None:
    """Without observations, a `CalibrationError` says what is missing."""
    observed = replace(calibration_set_for(calibrator, LinearRig()), observations=())
    with refused("a set without observations", CalibrationError):
        calibrator.calibrate(observed)


def check_a_wrong_number_of_stripes_is_refused(calibrator: Calibrator[Any]) -> None:
    """Images that show another number of stripes than the rig has are refused by a `CalibrationError`."""
    observed = calibration_set_for(calibrator, LinearRig())
    with refused("seven stripes where nine are expected", CalibrationError):
        calibrator.calibrate(replace(observed, stripe_count=9))


def check_points_are_where_the_scene_is(triangulator: Triangulator[Any]) -> None:
    """Exact stripes under an exact calibration give every point within the declared `height_tolerance_mm`."""
    _near(triangulator, LinearRig(), LinearRig().dome())


def check_a_mirrored_rig_measures_alike(triangulator: Triangulator[Any]) -> None:
    """With the laser on the other side, points are in the right place, and heights stay positive."""
    rig = LinearRig().mirrored()
    _near(triangulator, rig, rig.dome())


def check_a_plane_stays_plane(triangulator: Triangulator[Any]) -> None:
    """The points of a tilted plane lie on one plane within the declared `height_tolerance_mm`."""
    rig = LinearRig()
    foot = rig.xyz_mm(rig.belt())
    lean = rig.mm_per_px * rig.px_per_mm
    heights = (6.0 + 0.05 * foot[..., 0] + 0.08 * foot[..., 1]) / (1.0 - 0.05 * lean)
    points = _profiles(triangulator, rig, heights).xyz_mm.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    require(points.shape[0] == heights.size, f"{points.shape[0]} points of {heights.size} stripe points")
    middle = points - points.mean(axis=0)
    normal = np.linalg.svd(middle, full_matrices=False)[2][2]
    limit = triangulator.capabilities.height_tolerance_mm
    within(np.abs(middle @ normal), limit, "points are off the plane by", "mm")


def check_the_belt_is_at_zero(triangulator: Triangulator[Any]) -> None:
    """A stripe on the bare belt has the height 0 within the declared `height_tolerance_mm`."""
    rig = LinearRig()
    z_mm = _profiles(triangulator, rig, rig.belt()).xyz_mm[..., 2]
    limit = triangulator.capabilities.height_tolerance_mm
    require(bool((np.abs(z_mm) <= limit).all()), f"the belt's heights reach {np.abs(z_mm).max():.3g} mm")


def check_points_lie_on_their_slices_plane(triangulator: Triangulator[Any]) -> None:
    """Every point lies on the plane its slice names, within the declared `height_tolerance_mm`."""
    rig = LinearRig()
    profiles = _profiles(triangulator, rig, rig.dome())
    off_mm = np.abs(np.einsum("spk,sk->sp", profiles.xyz_mm, profiles.plane[:, :3]) - profiles.plane[:, 3:])
    limit = triangulator.capabilities.height_tolerance_mm
    require(
        np.nanmax(off_mm) <= limit, f"points are up to {np.nanmax(off_mm):.3g} mm off their slice's plane"
    )


def check_nothing_seen_gives_no_point(triangulator: Triangulator[Any]) -> None:
    """Where the map is NaN the point is NaN, in all three coordinates, and only there."""
    rig = LinearRig()
    heights = rig.dome()
    heights[3, 90:110] = np.nan
    heights[5] = np.nan
    profiles = _profiles(triangulator, rig, heights)
    finite = np.isfinite(profiles.xyz_mm)
    require(
        bool((finite.all(axis=2) == finite.any(axis=2)).all()), "points with some coordinates NaN, some not"
    )
    found, wanted = int(finite.all(axis=2).sum()), int(np.isfinite(heights).sum())
    require(found == wanted, f"{found} points from {wanted} stripe points")
    require(not (profiles.seen & ~finite.all(axis=2)).any(), "points that are NaN are marked as seen")


def check_labels_are_carried_over(triangulator: Triangulator[Any]) -> None:
    """`product` and `seen` stay with their points."""
    rig = LinearRig()
    heights = rig.dome()
    profiles = _profiles(triangulator, rig, heights)
    for what, found, wanted in (
        ("product", int((profiles.product > 0).sum()), int((heights > 0.0).sum())),
        ("belt", int((profiles.product == 0).sum()), int((heights == 0.0).sum())),
        ("seen", int(profiles.seen.sum()), heights.size),
    ):
        require(found == wanted, f"{found} points are {what}, {wanted} were")


def check_uncertainty_is_positive_or_not_stated(triangulator: Triangulator[Any]) -> None:
    """Each `height_std_mm` is positive or 0, or NaN where not modelled, wherever the laser stands."""
    for rig in (LinearRig(), LinearRig().mirrored()):
        std = _profiles(triangulator, rig, rig.dome()).height_std_mm
        require(not (std < 0.0).any(), "height_std_mm is negative")


def check_another_number_of_stripes_is_refused(triangulator: Triangulator[Any]) -> None:
    """A map with another number of stripes than the calibration is refused by a `StageError`."""
    rig, other = LinearRig(), LinearRig(stripes=5)
    with refused("a map of 5 stripes with a calibration of 7", StageError):
        triangulator.triangulate(other.stripe_map(other.dome()), calibration_for(triangulator, rig))


def check_another_image_size_is_refused(triangulator: Triangulator[Any]) -> None:
    """A map with another number of rows than the calibration's images is refused by a `StageError`."""
    rig, other = LinearRig(), LinearRig(rows=100)
    with refused("a map of 100 rows with a calibration of 200", StageError):
        triangulator.triangulate(other.stripe_map(other.dome()), calibration_for(triangulator, rig))


def check_a_moved_camera_measures_alike(triangulator: Triangulator[Any]) -> None:
    """With a calibration corrected for a motion, heights stay within 0.05 mm; or correcting is refused."""
    rig = LinearRig()
    calibration = calibration_for(triangulator, rig)
    shift = Alignment(np.array([_SHIFT_PX, 0.0, 0.0, 0.0]), np.zeros((4, 4)))
    try:
        moved = triangulator.moved(calibration, shift)
    except StageError:
        return
    rows = np.arange(rig.rows, dtype=np.float64)
    off_px = moved.rest_line_px(rows) - calibration.rest_line_px(rows) - _SHIFT_PX
    require(
        bool((np.abs(off_px) <= 0.05).all()), f"rest lines are {np.abs(off_px).max():.2g} px off the shift"
    )
    seen = rig.stripe_map(rig.dome())
    profiles = triangulator.triangulate(
        replace(seen, x_px=seen.x_px + _SHIFT_PX, rest_px=moved.rest_line_px(rows)), moved
    )
    before = triangulator.triangulate(seen, calibration)
    off_mm = float(np.nanmax(np.abs(profiles.xyz_mm[..., 2] - before.xyz_mm[..., 2])))
    require(off_mm <= 0.05, f"heights are up to {off_mm:.2g} mm off those of the camera at rest")


_SHIFT_PX = 0.8  # what an aligner corrects, not what it refuses


def _profiles(triangulator: Triangulator[Any], rig: LinearRig, heights: Floats) -> Profiles:
    return triangulator.triangulate(rig.stripe_map(heights), calibration_for(triangulator, rig))


def _near(triangulator: Triangulator[Any], rig: LinearRig, heights: Floats) -> None:
    profiles = _profiles(triangulator, rig, heights)
    truth = rig.xyz_mm(heights)[profiles.stripe]
    # Points of a slice may stand in any order: each is found by its row.
    at = np.rint(profiles.row_px).astype(np.int64)
    off_mm = np.linalg.norm(profiles.xyz_mm - np.take_along_axis(truth, at[:, :, None], axis=1), axis=2)
    within(off_mm, triangulator.capabilities.height_tolerance_mm, "points are off by", "mm")
