"""The calibrator refuses by name: sets made from the kit's rig, spoilt in one way each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry.errors import CalibrationError
from roemetry.records import Block, CalibrationSet
from roemetry.records.view import write_camera
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.numbering import PoseLines, number_stripes
from roemetry_pinhole.pinhole_plane import lines_at_height
from roemetry_pinhole.scale import check_scale


def kept(observed: CalibrationSet, keep) -> CalibrationSet:
    return replace(observed, observations=tuple(one for one in observed.observations if keep(one)))


def refused(observed: CalibrationSet, says: str) -> CalibrationError:
    with pytest.raises(CalibrationError, match=says) as caught:
        PinholeCalibrator().calibrate(observed)
    assert caught.value.hint
    return caught.value


@pytest.mark.parametrize(
    ("changes", "keep", "says"),
    [
        ({"board": None}, lambda one: True, "no board is described"),
        ({}, lambda one: one.shows == "belt", "no image of the board"),
        ({}, lambda one: one.shows == "belt" or one.pose < "pose 3", "in 3 of 3 poses; 4 are"),
        ({}, lambda one: one.shows != "belt", "where the belt is"),
    ],
)
def test_what_is_missing_is_named(observed, changes, keep, says: str) -> None:
    refused(replace(kept(observed, keep), **changes), says)


def test_poses_without_variety(observed) -> None:
    """The same pose under four names."""
    same = [one for one in observed.observations if one.pose == "pose 1"]
    belt = [one for one in observed.observations if one.shows == "belt"]
    copies = [replace(one, pose=f"copy {n}") for n in range(5) for one in same]
    refused(replace(observed, observations=(*belt, *copies)), "no variety")


def test_a_block_that_contradicts_the_board(observed, calibrated) -> None:
    """A block of 10 mm that is said to be 10.4: the stripes of the level at 10 mm tell."""
    rig = LinearRig()
    rows = np.arange(rig.rows, dtype=np.float64)
    top = lines_at_height(calibrated.parameters, rows, 10.0)
    x_px = np.where((rows > 60) & (rows < 140), top, lines_at_height(calibrated.parameters, rows, 0.0))
    belt = next(one for one in observed.observations if one.shows == "belt")
    image = replace(belt, shows="block", peaks=rig.peaks(x_px, scatter_px=0.03).peaks)
    both = replace(observed, observations=(*observed.observations, image))
    block = Block("block", 100.0, 30.0, 10.0, tolerance_mm=0.01)
    fine = check_scale(calibrated, replace(both, block=block))["residuals"]
    assert fine["block_height_ratio"] == pytest.approx(1.0, abs=0.003)
    error = refused(replace(both, block=replace(block, height_mm=10.4)), "contradict each other")
    assert "0.96" in error.message


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


def test_a_known_camera_is_taken_as_it_is(observed, calibrated, tmp_path) -> None:
    path = tmp_path / "camera.yaml"
    assert calibrated.view is not None
    write_camera(path, calibrated.view)
    again = PinholeCalibrator(PinholeCalibratorOptions(camera=path)).calibrate(observed)
    assert (again.parameters["focal_px"] == calibrated.parameters["focal_px"]).all()
    assert np.abs(again.displacement_px_per_mm / calibrated.displacement_px_per_mm - 1.0).max() < 0.002
    assert np.abs(again.covariance[:12, :12]).max() == 0.0


def spoilt(pose: PoseLines, rng, *, lost: int, false: int, broken: int) -> tuple[PoseLines, np.ndarray]:
    """A pose with lines lost, false ones between others, lines in two pieces; and the right numbers."""
    first = int(pose.name.rsplit(" ", 1)[1])
    keep = np.sort(rng.permutation(pose.count)[lost:])
    ends, number, peaks = pose.ends_mm[keep], first + keep, np.full(keep.size, 300)
    for _ in range(broken):
        at, share = int(rng.integers(len(ends))), rng.uniform(0.3, 0.7)
        middle = ends[at, 0] + share * (ends[at, 1] - ends[at, 0])
        ends = np.insert(ends, at, [ends[at, 0], middle], axis=0)
        ends[at + 1, 0] = middle
        number, peaks = np.insert(number, at, number[at]), np.insert(peaks, at, 100)
    for _ in range(false):
        at, share = int(rng.integers(1, len(ends))), rng.uniform(0.3, 0.7, (2, 1))
        ends = np.insert(ends, at, share * ends[at - 1] + (1.0 - share) * ends[at], axis=0)
        number, peaks = np.insert(number, at, -1), np.insert(peaks, at, 100)
    return PoseLines(pose.name, ends, peaks), number


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    lost=st.lists(st.integers(0, 2), min_size=10, max_size=10),
    false=st.lists(st.integers(0, 2), min_size=10, max_size=10),
    broken=st.lists(st.integers(0, 1), min_size=10, max_size=10),
)
def test_lines_lost_false_or_broken_in_any_pose_change_no_number(seed, lost, false, broken) -> None:
    """As many lines as stripes on some boards, and no board need show them all.

    A false line in a pose may lie in a plane by chance, so single ones may be numbered; a stripe may not get
    another stripe's number. What is refused is refused with a reason that is so.
    """
    rng = np.random.default_rng(seed)
    made = [
        spoilt(pose, rng, lost=lost[n], false=false[n], broken=broken[n])
        for n, pose in enumerate(fan(9, 10, rng))
    ]
    shown_on = np.array([sum((right == stripe).any() for _, right in made) for stripe in range(9)])
    try:
        numbered = number_stripes([pose for pose, _ in made], 9)
    except CalibrationError as refusal:
        assert shown_on.min() < 3, f"each stripe lies on three boards or more, but: {refusal}"
        return
    assert not numbered.left_out
    for (pose, right), found in zip(made, numbered.stripe, strict=True):
        told = (found >= 0) & (right >= 0)
        assert (found[told] == right[told]).all(), pose.name
        missed = np.setdiff1d(right[right >= 0], right[told])
        assert missed.size <= 2, pose.name


def test_exchanged_laser_images_are_named_as_such(rng) -> None:
    """Each pose shows the lines of the next one: every stripe is seen on every board, and in no plane."""
    poses = [pose for pose in fan(9, 30, rng) if pose.count == 9][:3] + fan(9, 9, rng)
    boards = [np.linalg.lstsq(p.ends_mm.reshape(-1, 3), np.ones(2 * p.count), rcond=None)[0] for p in poses]
    wrong = []
    for pose, board in zip(poses, boards[1:] + boards[:1], strict=True):
        ends = pose.ends_mm / (pose.ends_mm @ board)[:, :, None]
        wrong.append(PoseLines(pose.name, ends))
    with pytest.raises(CalibrationError, match="contradict each other|no numbering of 9"):
        number_stripes(wrong, 9)


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


@pytest.mark.parametrize("moved", [1, 4])
def test_poses_of_one_stripe_that_contradict_each_other_are_counted(moved: int) -> None:
    """With one stripe a line off the plane is no hidden stripe: what is left out must not be forgotten."""
    poses = []
    for number in range(9):
        away, lean = 300.0 + 7.0 * number, 0.02 * (number % 4 - 1.5)
        z_mm = np.array([away, away + 60.0 * lean])
        off_mm = 25.0 * (1 + number) * (-1) ** number if number < moved else 0.0
        ends = np.column_stack([0.3 * z_mm - 90.0 + off_mm, np.array([-30.0, 30.0]), z_mm])
        poses.append(PoseLines(f"pose {number}", ends[None], np.array([200])))
    if moved > 1:
        with pytest.raises(CalibrationError, match=f"the stripes of {moved} of 9"):
            number_stripes(poses, 1)
    else:
        assert list(number_stripes(poses, 1).left_out) == ["pose 0"]
