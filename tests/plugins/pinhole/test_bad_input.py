"""Whole calibrations from image files with bad ones among them: each is named, none is averaged in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry import make_stage
from roemetry.calibrating import calibrate
from roemetry.config.rig import Rig
from roemetry.errors import CalibrationError
from roemetry.records import Board
from roemetry.records.calibration import Calibration
from roemetry.testing.patterns import DotRig
from roemetry_pinhole.boards import Seen
from roemetry_pinhole.conformance import dots_observed_of
from roemetry_pinhole.initial_intrinsics import initial_camera
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
