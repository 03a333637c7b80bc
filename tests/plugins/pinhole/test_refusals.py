"""The calibrator refuses by name: sets made from the kit's rig, spoilt in one way each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import CalibrationError
from roemetry.records import Block, CalibrationSet
from roemetry.testing import LinearRig
from roemetry_pinhole.boards import board_views
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.conformance import observed_of
from roemetry_pinhole.numbering import PoseLines, number_stripes


@pytest.fixture(scope="module")
def observed() -> CalibrationSet:
    return observed_of(LinearRig())


def kept(observed: CalibrationSet, keep) -> CalibrationSet:
    return replace(observed, observations=tuple(one for one in observed.observations if keep(one)))


def refused(observed: CalibrationSet, says: str) -> CalibrationError:
    with pytest.raises(CalibrationError, match=says) as caught:
        PinholeCalibrator().calibrate(observed)
    assert caught.value.hint
    return caught.value


def test_no_board_described(observed) -> None:
    refused(replace(observed, board=None), "no board is described")


def test_no_image_of_the_board(observed) -> None:
    refused(kept(observed, lambda one: one.shows == "belt"), "no image of the board")


def test_too_few_poses(observed) -> None:
    refused(kept(observed, lambda one: one.shows == "belt" or one.pose < "pose 3"), "in 3 of 3 poses; 4 are")


def test_poses_without_variety(observed) -> None:
    """The same pose under four names."""
    same = [one for one in observed.observations if one.pose == "pose 1"]
    belt = [one for one in observed.observations if one.shows == "belt"]
    copies = [replace(one, pose=f"copy {n}") for n in range(5) for one in same]
    refused(replace(observed, observations=(*belt, *copies)), "no variety")


def test_nothing_shows_the_belt(observed) -> None:
    refused(kept(observed, lambda one: one.shows != "belt"), "where the belt is")


def test_a_block_that_contradicts_the_board(observed) -> None:
    """A block of 10 mm that is said to be 10.4: the stripes of the level at 10 mm tell."""
    made = PinholeCalibrator().calibrate(observed)
    from roemetry_pinhole.frames import lines_at_height

    rig = LinearRig()
    rows = np.arange(rig.rows, dtype=np.float64)
    top = lines_at_height(made.parameters, rows, 10.0)
    x_px = np.where((rows > 60) & (rows < 140), top, lines_at_height(made.parameters, rows, 0.0))
    belt = next(one for one in observed.observations if one.shows == "belt")
    image = replace(belt, shows="block", peaks=rig.peaks(x_px, scatter_px=0.03).peaks)
    both = replace(observed, observations=(*observed.observations, image))
    block = Block("block", 100.0, 30.0, 10.0, tolerance_mm=0.01)
    fine = PinholeCalibrator().calibrate(replace(both, block=block))
    assert fine.residuals["block_height_ratio"] == pytest.approx(1.0, abs=0.003)
    error = refused(replace(both, block=replace(block, height_mm=10.4)), "contradict each other")
    assert "0.96" in error.message


def test_a_laser_off_image_given_as_laser_on_is_named(observed) -> None:
    def darkened(one):
        if one.pose == "pose 2" and one.frame.role == "laser":
            plain = next(o for o in observed.observations if o.pose == "pose 2" and o.frame.role == "plain")
            return replace(one, frame=replace(plain.frame, role="laser", name="not lit"))
        return one

    seen = board_views(
        replace(observed, observations=tuple(map(darkened, observed.observations))), observed.board
    )
    assert "laser off" in seen.left_out["not lit"]


def test_exchanged_images_are_named(observed) -> None:
    def exchanged(one):
        if one.pose != "pose 2":
            return one
        role = {"plain": "laser", "laser": "plain"}[one.frame.role]
        return replace(one, frame=replace(one.frame, role=role, name=f"called {role}"))

    seen = board_views(
        replace(observed, observations=tuple(map(exchanged, observed.observations))), observed.board
    )
    assert "exchanged" in seen.left_out["called laser"]


def test_a_blurred_view_is_left_out_by_name(observed) -> None:
    import cv2

    def blurred(one):
        if one.pose == "pose 3" and one.frame.role == "plain":
            pixels = cv2.GaussianBlur(one.frame.pixels, (0, 0), 9.0)
            return replace(one, frame=replace(one.frame, pixels=pixels))
        return one

    spoilt = replace(observed, observations=tuple(map(blurred, observed.observations)))
    seen = board_views(spoilt, observed.board)
    assert "pose 3 plain" in seen.left_out


def fan(stripes: int, poses: int, rng) -> list[PoseLines]:
    """Exact lines of a fan of planes on boards that show any part of it."""
    normal = np.column_stack([np.ones(stripes), np.full(stripes, 0.02), np.linspace(0.3, 0.6, stripes)])
    planes = normal / (normal @ [150.0, 0.0, 20.0])[:, None]
    found = []
    for number in range(poses):
        tilt = rng.uniform(-0.4, 0.4, 2)
        board = np.array([*tilt, 1.0]) / (280.0 + 20.0 * rng.uniform())
        y = np.array([-30.0, 30.0])
        ends = []
        for plane in planes:
            matrix = np.stack([plane, board])[:, [0, 2]]
            right = 1.0 - np.outer(np.stack([plane, board])[:, 1], y)
            xz = np.linalg.solve(matrix, right)
            ends.append(np.column_stack([xz[0], y, xz[1]]))
        first = int(rng.integers(0, 3))
        last = stripes - int(rng.integers(0, 3))
        found.append(PoseLines(f"pose {number} from {first}", np.array(ends)[first:last]))
    return found


def test_stripes_are_numbered_though_no_board_shows_them_all(rng) -> None:
    poses = [pose for pose in fan(9, 12, rng) if pose.count < 9]
    numbered = number_stripes(poses, 9)
    for pose, stripe in zip(poses, numbered.stripe, strict=True):
        first = int(pose.name.rsplit(" ", 1)[1])
        assert stripe.tolist() == list(range(first, first + pose.count)), pose.name


def test_a_stripe_on_one_board_alone_is_named(rng) -> None:
    poses = fan(6, 6, rng)
    cut = [PoseLines(pose.name, pose.ends_mm) for pose in poses]
    short = [
        PoseLines(pose.name, pose.ends_mm[: 5 - int(pose.name.rsplit(" ", 1)[1])]) if number else pose
        for number, pose in enumerate(cut)
    ]
    with pytest.raises(CalibrationError, match=r"stripe \d lies on|no numbering"):
        number_stripes(short, 6)


def test_a_known_camera_is_taken_as_it_is(observed, tmp_path) -> None:
    from roemetry.camera_file import write_camera

    made = PinholeCalibrator().calibrate(observed)
    path = tmp_path / "camera.yaml"
    assert made.view is not None
    write_camera(path, made.view)
    again = PinholeCalibrator(PinholeCalibratorOptions(camera=path)).calibrate(observed)
    assert (again.parameters["focal_px"] == made.parameters["focal_px"]).all()
    assert np.abs(again.displacement_px_per_mm / made.displacement_px_per_mm - 1.0).max() < 0.002
    assert np.abs(again.covariance[:12, :12]).max() == 0.0


def spoilt(pose: PoseLines, rng) -> tuple[PoseLines, np.ndarray]:
    """A pose with a stripe lost in its middle and a false line between two others; and the right numbers."""
    first = int(pose.name.rsplit(" ", 1)[1])
    ends, number = pose.ends_mm, first + np.arange(pose.count)
    lost = int(rng.integers(1, pose.count - 1))
    ends, number = np.delete(ends, lost, axis=0), np.delete(number, lost)
    at = int(rng.integers(1, len(ends)))
    share = rng.uniform(0.35, 0.65, (2, 1))
    false = share * ends[at - 1] + (1.0 - share) * ends[at]
    return PoseLines(pose.name, np.insert(ends, at, false, axis=0)), np.insert(number, at, -1)


def test_lost_and_false_lines_in_every_pose_change_no_number(rng) -> None:
    """As many lines as stripes on most boards, and none of these boards shows them all."""
    made = [spoilt(pose, rng) for pose in fan(9, 10, rng)]
    numbered = number_stripes([pose for pose, _ in made], 9)
    assert not numbered.left_out
    for (pose, right), found in zip(made, numbered.stripe, strict=True):
        wrong = (found >= 0) & (found != right)
        assert not wrong.any(), pose.name
        assert ((found >= 0) == (right >= 0)).mean() > 0.85, pose.name


def test_the_empty_belt_numbers_what_boards_show_in_part(rng) -> None:
    """Stripe 1 lies on no board: the belt's lines tell which one it is."""
    poses = fan(7, 8, rng)
    cut = [
        PoseLines(pose.name, pose.ends_mm[max(1 - int(pose.name.rsplit(" ", 1)[1]), 0) :]) for pose in poses
    ]
    whole = next(pose for pose in fan(7, 40, rng) if pose.count == 7)
    with pytest.raises(
        CalibrationError, match="stripe 1 is seen on the empty belt and on fewer than two boards"
    ):
        number_stripes(cut, 7, whole)
