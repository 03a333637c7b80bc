"""What the residuals forbid: sets of simulated points, each spoilt in one way, refused by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_points import Shown, SimulatedRig, noisy, shown
from roemetry.errors import CalibrationError
from roemetry.records import Board
from roemetry_pinhole.boards import BoardMarks, BoardView, Seen
from roemetry_pinhole.bundle import Measured
from roemetry_pinhole.geometry import CAMERA, unknowns_of
from roemetry_pinhole.initial_intrinsics import InitialCamera
from roemetry_pinhole.joint_adjustment import JointAdjustment
from roemetry_pinhole.verdict import judged

RIG = SimulatedRig(1600.0, 350.0, tilt_deg=(6.0, -4.0), lens=(-0.2, 0.1, 0.0, 0.0, 0.0), stripes=5, poses=10)


def joint_of(seen: Shown, outlier_share: float = 0.0) -> JointAdjustment:
    free = unknowns_of(seen.geometry, free_camera=np.arange(CAMERA) < 9, planes=True, belt=True, travel=False)
    measured = Measured(seen.geometry, free, seen.corners, seen.points, seen.contacts, 0.03)
    board = Board(
        "b", "chessboard", 11, 8, pitch_mm=seen.corners.board_mm[1, 0] - seen.corners.board_mm[0, 0]
    )
    views = []
    for pose in range(len(seen.geometry.shift)):
        mine = seen.corners.pose == pose
        marks = BoardMarks(seen.corners.board_mm[mine], seen.corners.xy_px[mine], "", 2.0, 40.0)
        views.append(BoardView(f"pose {pose}", marks, None, None, on_belt=False, count=np.nan, board=board))
    first = InitialCamera(seen.geometry.camera, views, seen.geometry.rotation, seen.geometry.shift)
    pose = np.arange(len(views))
    adjusted = measured.adjusted()
    return JointAdjustment(
        board, RIG.image_size, Seen(), first, pose, 0.0, outlier_share, None, measured, adjusted, moves=False
    )


def few_errors(rng: np.random.Generator, rig: SimulatedRig = RIG) -> Shown:
    return noisy(shown(rig, rng), rng, 0.05, 0.1, 0.02)


def with_marks(seen: Shown, off_px: np.ndarray) -> Shown:
    return replace(seen, corners=replace(seen.corners, xy_px=seen.corners.xy_px + off_px))


def with_peaks(seen: Shown, off_px: np.ndarray) -> Shown:
    return replace(seen, points=replace(seen.points, x_px=seen.points.x_px + off_px))


def refused(seen: Shown, says: str) -> None:
    with pytest.raises(CalibrationError, match=says) as caught:
        judged(joint_of(seen))
    assert caught.value.hint


def test_what_is_right_is_let_through(rng) -> None:
    verdict = judged(joint_of(few_errors(rng)))
    assert verdict.residuals["corners_systematic_px"] < 0.02, "px"
    assert verdict.residuals["corners_rms_px"] == pytest.approx(0.05 * np.sqrt(2.0), rel=0.1), "px"
    # 350 mm away at 1600 px focal length; a point's way to its plane is shorter than its way along the row
    mm = verdict.residuals["stripes_rms_px"] * 350.0 / 1600.0
    assert 0.5 * mm < verdict.residuals["stripes_rms_mm"] < 1.1 * mm


def test_a_plane_nearly_through_the_camera_is_named(rng) -> None:
    """One stripe, the laser beside the lens: half a degree from the line of sight."""
    seen = few_errors(rng, replace(RIG, stripes=1, angle_deg=0.5, tilt_deg=(0.0, 0.0)))
    refused(seen, r"plane of stripe 1 passes the camera's centre by \d\.\d mm only")


def test_residuals_that_neighbours_share_are_refused_or_told(rng) -> None:
    """Ripples no lens model knows, 400 px long: 1.2 px high, and 0.3 px."""
    seen = few_errors(rng)
    x, y = seen.corners.xy_px.T
    ripple = np.column_stack([np.sin(x / 64.0), np.cos(y / 64.0)])
    refused(
        with_marks(seen, 1.2 * ripple), "residuals are not noise: neighbouring board corners are off together"
    )
    assert any("not noise alone" in note for note in judged(joint_of(with_marks(seen, 0.3 * ripple))).notes)
    assert not any("not noise" in note for note in judged(joint_of(seen)).notes)


@pytest.mark.parametrize(
    ("stripes", "wrong", "says"),
    [
        (5, [3], "stripe 3 does not lie in one plane"),
        (2, [1, 2], "does not lie in one plane|do not fit"),
        (1, [1], "does not lie in one plane|do not fit"),
    ],
)
def test_stripes_that_are_in_no_plane_are_refused(rng, stripes: int, wrong: list[int], says: str) -> None:
    """A reflection is taken for a stripe: on each board it is somewhere else. One among five is named."""
    seen = few_errors(rng, replace(RIG, stripes=stripes))
    away = rng.uniform(-6.0, 6.0, (RIG.poses + 1, stripes)) * np.isin(np.arange(stripes) + 1, wrong)
    refused(with_peaks(seen, away[seen.points.pose, seen.points.stripe]), says)


def test_what_is_not_one_rigid_rig_is_refused(rng) -> None:
    """The camera is pushed between the images, and within them: marks, then stripe peaks."""
    seen = few_errors(rng)
    pushed = rng.random(seen.corners.pose.size) < 0.35
    refused(with_marks(seen, pushed[:, None] * rng.normal(0.0, 12.0, (pushed.size, 2))), "corners do not fit")
    moved = rng.random(seen.points.pose.size) < 0.4
    refused(with_peaks(seen, moved * rng.normal(0.0, 20.0, moved.size)), "stripe peaks do not fit")


def test_peaks_left_out_beforehand_count_as_left_out(rng) -> None:
    seen = few_errors(rng)
    assert judged(joint_of(seen, outlier_share=0.2)).residuals["stripes_left_out"] == pytest.approx(
        0.2, abs=0.02
    )
    with pytest.raises(CalibrationError, match="40% of the stripe peaks do not fit"):
        judged(joint_of(seen, outlier_share=0.4))
