"""Bad images among good ones, and sets spoilt in one way each, are named or refused by the calibrator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry import make_stage
from roemetry.calibrating import calibrate
from roemetry.config.rig import Rig
from roemetry.errors import CalibrationError
from roemetry.records import Block, Board, CalibrationSet
from roemetry.records.calibration import Calibration
from roemetry.records.view import write_camera
from roemetry.testing import LinearRig
from roemetry.testing.patterns import DotRig
from roemetry_pinhole.boards import Seen
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.conformance import dots_observed_of
from roemetry_pinhole.initial_intrinsics import initial_camera
from roemetry_pinhole.numbering import PoseLines, number_stripes
from roemetry_pinhole.pinhole_plane import lines_at_height
from roemetry_pinhole.scale import check_scale
from tests.plugins.pinhole.board_set import (
    CHARUCO,
    CHESS,
    FOCAL_PX,
    NEAR_MM,
    STRIPES,
    lit,
    load,
    plain,
    planes,
    pose,
    save,
    written,
)  # fmt: skip


def made(path: Path) -> Calibration:
    return calibrate(Rig.load(path))


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Calibration:
    """Of the chessboard's good images alone."""
    return made(written(tmp_path_factory.mktemp("clean")))


def bad(board: Board, folder: Path, rng) -> dict[str, tuple[str, str]]:
    """Write pairs of images that no calibration may use; give by name why, and what is to be done."""

    def pair(number: int, off: np.ndarray, on: np.ndarray) -> None:
        save(folder / f"off_{number}.png", off, rng)
        save(folder / f"on_{number}.png", on, rng)

    every = range(STRIPES)
    rotation, shift = pose(9)
    off = 0.5 * plain(board, rotation, shift)
    on = lit(off, 0.5, rotation, shift, every)
    pair(20, *(cv2.GaussianBlur(image, (0, 0), 9.0) for image in (off, on)))
    half = 0.5 * board.pitch_mm * np.array([board.columns, board.rows, 0.0])
    away = 5.0 if board is CHESS else 2.6
    far = 0.5 * plain(board, rotation, np.array([0.0, 0.0, away * NEAR_MM]) - rotation @ half)
    pair(21, far, far + 1.0)
    aside = shift + np.array([-45.0 if board is CHESS else -75.0, 0.0, 0.0])
    cut = 0.5 * plain(board, rotation, aside)
    pair(22, cut, lit(cut, 0.5, rotation, aside, every))
    other = replace(board, columns=8, rows=5) if board is CHESS else replace(board, dictionary="DICT_5X5_50")
    wrong = 0.5 * plain(other, rotation, shift)
    pair(23, wrong, lit(wrong, 0.5, rotation, shift, every))
    pair(24, off[:, ::-1], on[:, ::-1])
    turn, way = pose(6)
    way = way + np.array([1.0, -1.0, 2.0])
    one_side = 0.5 * plain(board, turn, way)
    if (
        board is CHARUCO
    ):  # a chessboard mirrored is a chessboard elsewhere: two poses, as of a board that moved
        pair(25, one_side[:, ::-1], lit(one_side, 0.5, turn, way, every))
    mirrored = ("is mirrored", "mirroring off") if board is CHARUCO else ("on none of the planes", "again")
    found = {
        "off_20": ("blurred", "focus"),
        "on_20": ("blurred", "focus"),
        "off_21": ("too small", "hold it nearer"),
        "off_22": ("cut off", "show more" if board is CHARUCO else "wholly inside"),
        "off_23": ("another board", "correct `board`"),
        "off_24" if board is CHARUCO else "on_24": mirrored,
    }
    return found | ({"off_25": mirrored} if board is CHARUCO else {})


@pytest.mark.parametrize(
    "board",
    [pytest.param(CHESS, id="chessboard", marks=pytest.mark.thorough), pytest.param(CHARUCO, id="charuco")],
)
def test_bad_images_are_named_and_change_nothing(board: Board, clean, rng, tmp_path: Path) -> None:
    """Blurred, tiny, cut off, another board, mirrored; or one half of a pair mirrored."""
    path = written(tmp_path, board)
    clean = clean if board is CHESS else made(path)
    expected = bad(board, tmp_path, rng)
    found = made(path)
    for name, (why, advice) in expected.items():
        notes = [note for note in found.notes if note.startswith(f"not used: {name}.png: ")]
        assert len(notes) == 1, name
        assert why in notes[0]
        assert advice in notes[0]
    assert found.residuals["poses"] == 8
    for name, values in clean.parameters.items():
        np.testing.assert_allclose(found.parameters[name], values, rtol=1e-12, atol=1e-15, err_msg=name)


def test_wrong_laser_images_are_named(clean, rng, tmp_path: Path) -> None:
    """A laser-off image given as laser-on; the two of a pair exchanged."""
    path = written(tmp_path)
    for number, exchanged in ((20, False), (21, True)):
        rotation, shift = pose(number % 8)
        shift = shift + np.array([2.0, 1.0, 3.0])
        off = 0.5 * plain(CHESS, rotation, shift)
        on = lit(off, 0.5, rotation, shift, range(STRIPES)) if exchanged else off
        save(tmp_path / f"off_{number}.png", on if exchanged else off, rng)
        save(tmp_path / f"on_{number}.png", off, rng)
    found = made(path)
    notes = "\n".join(found.notes)
    assert "on_20.png: no stripe is seen beside off_20.png: is it an image with the laser off?" in notes
    assert "on_21.png: it is darker than off_21.png: are the images" in notes
    assert found.residuals["poses"] == 9, "stripes across the print spoil the marks of the exchanged one"
    assert "off_21.png: its corners are off by" in notes
    std = np.sqrt(np.diag(clean.covariance))[12:-3].reshape(-1, 3)
    assert (np.abs(found.parameters["planes_per_mm"] - clean.parameters["planes_per_mm"]) < 4.0 * std).all()


def test_images_of_mixed_size_are_refused_by_name(rng, tmp_path: Path) -> None:
    path = written(tmp_path, poses=4)
    save(tmp_path / "on_2.png", load(tmp_path / "on_2.png")[:-4], rng)
    with pytest.raises(
        CalibrationError, match=r"on_2\.png is 400 × 296 pixels, belt\.png is 400 × 300"
    ) as caught:
        made(path)
    assert "one camera" in (caught.value.hint or "")


def test_a_board_described_wrongly_is_what_is_to_be_mended(tmp_path: Path) -> None:
    """Corners counted where squares are asked for: every image says so, and no pose more would help."""
    path = written(tmp_path, poses=5)
    other = {"columns": CHESS.columns + 1, "rows": CHESS.rows + 1}
    rig = Rig.load(path, sets=[f"board.{key}={value}" for key, value in other.items()])
    seen = f"{CHESS.columns - 1} × {CHESS.rows - 1} inner corners are seen"
    with pytest.raises(CalibrationError, match=f"it is another board: {seen}") as caught:
        calibrate(rig)
    assert "begin with the reason given for" in (caught.value.hint or "")


def test_of_one_image_the_hint_speaks_as_of_one() -> None:
    seen = Seen(left_out={"on_1.png": "it is blurred"})
    with pytest.raises(CalibrationError) as caught:
        initial_camera(seen, (300, 400), "five", None, 1)
    assert caught.value.hint == "begin with the reason given for the image"


def test_poses_in_which_dots_show_another_board_are_counted() -> None:
    observed = dots_observed_of(DotRig())
    assert observed.board is not None
    other = replace(observed.board, columns=observed.board.columns + 1)
    calibrator = make_stage("calibrator", "pinhole-dots")
    with pytest.raises(CalibrationError, match=r"the board is seen in 0 of [1-9]"):
        calibrator.calibrate(replace(observed, board=other))


def test_a_stripe_that_is_seen_in_one_pose_only_is_named(tmp_path: Path) -> None:
    shows = {number: range(STRIPES - 1) for number in range(8) if number != 4}
    path = written(tmp_path, stripes=shows)
    with pytest.raises(CalibrationError, match=r"stripe 5 lies on one board alone \(on_4\.png\)") as caught:
        made(path)
    assert "add poses" in (caught.value.hint or "")


@pytest.mark.thorough
def test_a_rig_that_is_mirrored_as_a_whole_measures_the_same_heights(clean, tmp_path: Path) -> None:
    """A chessboard mirrored is itself: all images mirrored show a rig with the laser on the other side."""
    path, right = written(tmp_path), clean
    for image in tmp_path.glob("*.png"):
        save(image, load(image)[:, ::-1], np.random.default_rng(0))
    left = made(path)
    assert left.displacement_px_per_mm[::-1] == pytest.approx(-right.displacement_px_per_mm, rel=2e-3)
    assert left.rest_px[::-1, 0] == pytest.approx(399.0 - right.rest_px[:, 0], abs=0.05)
    assert left.view.camera_mm[2] == pytest.approx(right.view.camera_mm[2], rel=2e-3)


def test_one_mirrored_view_of_a_symmetrical_board_without_stripes_shifts_nothing(
    clean, rng, tmp_path
) -> None:
    """Marks of a chessboard do not tell, but they are those of a legal view: within what is stated."""
    path = written(tmp_path)
    rotation, shift = pose(9)
    shift = shift + np.array([1.0, 1.0, 3.0])
    save(tmp_path / "off_20.png", 0.5 * plain(CHESS, rotation, shift)[:, ::-1], rng)
    found = made(path)
    assert found.residuals["poses"] == 9
    std = np.sqrt(np.diag(clean.covariance))
    for name, first, last in (("focal_px", 0, 2), ("principal_px", 2, 4)):
        assert (np.abs(found.parameters[name] - clean.parameters[name]) < 4.0 * std[first:last]).all(), name


COUNT = 31


@pytest.mark.thorough
def test_thirty_one_planes_are_told_apart_and_measure(tmp_path: Path) -> None:
    """Stripes 7 px apart, eight poses: heights of exact peaks."""
    made = calibrate(Rig.load(written(tmp_path, count=COUNT)))
    assert made.stripe_count == COUNT
    assert not any("not used" in note for note in made.notes)
    off = []
    for height in (0.0, 10.0, 20.0):
        level = np.array([0.0, 0.0, 1.0 / (NEAR_MM - height)])
        for stripe, plane in enumerate(planes(count=COUNT)):
            for row in (60.0, 150.0, 240.0):
                a, b, c = plane - level
                x_px = 199.5 - FOCAL_PX * (b * (row - 149.5) / FOCAL_PX + c) / a
                if 0.0 < x_px < 399.0:
                    off.append(made.view.lift(np.array([x_px, row]), stripe)[2] - height)
    assert np.abs(off).max() < 0.05, "mm"
    assert np.sqrt(np.mean(np.square(off))) < 0.02, "mm"


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
    for (lines, right), found in zip(made, numbered.stripe, strict=True):
        told = (found >= 0) & (right >= 0)
        assert (found[told] == right[told]).all(), lines.name
        missed = np.setdiff1d(right[right >= 0], right[told])
        assert missed.size <= 2, pose.name


def test_exchanged_laser_images_are_named_as_such(rng) -> None:
    """Each pose shows the lines of the next one: every stripe is seen on every board, and in no plane."""
    poses = [pose for pose in fan(9, 30, rng) if pose.count == 9][:3] + fan(9, 9, rng)
    boards = [np.linalg.lstsq(p.ends_mm.reshape(-1, 3), np.ones(2 * p.count), rcond=None)[0] for p in poses]
    wrong = []
    for lines, board in zip(poses, boards[1:] + boards[:1], strict=True):
        ends = lines.ends_mm / (lines.ends_mm @ board)[:, :, None]
        wrong.append(PoseLines(lines.name, ends))
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
