"""Boards in images: found or refused by name; several in one adjustment; boards that are not flat."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.simulated_points import Shown, SimulatedRig, noisy, shown
from roemetry.calibrating.evidence import findings_page
from roemetry.errors import CalibrationError
from roemetry.records import Board, CalibrationSet, Frame
from roemetry.testing import LinearRig
from roemetry_pinhole.boards import BoardNotFoundError, charuco_of, find_marks
from roemetry_pinhole.bundle import Measured
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.geometry import (
    CAMERA,
    ON_BELT,
    WARP_COEFFICIENTS,
    BoardWarp,
    Geometry,
    corner_residuals,
    corner_rows,
    distort,
    stripe_residuals,
    stripe_rows,
    unknowns_of,
)
from roemetry_pinhole.pinhole_plane import points_of
from roemetry_pinhole.verdict import cross_validate, lifted, stripe_offsets
from tests.plugins.pinhole.solids_seen import assert_derivatives

CHARUCO = Board(
    "c", "charuco", columns=9, rows=6, pitch_mm=8.0, marker_mm=6.0, dictionary="DICT_4X4_250", layout="auto"
)
CHESS = Board("b", "chessboard", columns=9, rows=6, pitch_mm=8.0)
CIRCLES = Board("g", "circle-grid", columns=8, rows=6, pitch_mm=8.0)
SQUARE = 100
"""Pixels of the print a pitch: the image's are a quarter of it."""


def printed(board: Board, layout: str = "new") -> np.ndarray:
    if board.kind == "charuco":
        size = (board.columns * SQUARE, board.rows * SQUARE)
        return charuco_of(board, layout).generateImage(size, marginSize=0)
    rows, columns = np.mgrid[: board.rows * SQUARE, : board.columns * SQUARE]
    if board.kind == "chessboard":
        return np.where((rows // SQUARE + columns // SQUARE) % 2 == 0, 0, 255).astype(np.uint8)
    off = np.hypot(rows % SQUARE - (SQUARE - 1) / 2, columns % SQUARE - (SQUARE - 1) / 2)
    return np.where(off < 0.25 * SQUARE, 0, 255).astype(np.uint8)


def seen(
    board: Board, *, scale: float = 0.45, shift=(0.0, 0.0), layout: str = "new"
) -> tuple[Frame, np.ndarray]:
    """A tilted view of a board, and the matrix from pitches on the board to pixels."""
    picture = cv2.copyMakeBorder(printed(board, layout), 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    place = np.array([[1.0, 0.06, 0.0], [-0.04, 1.02, 0.0], [6e-5, -4e-5, 1.0]])
    half = np.array([picture.shape[1] / 2.0, picture.shape[0] / 2.0])
    centre = np.array([[1.0, 0.0, -half[0]], [0.0, 1.0, -half[1]], [0.0, 0.0, 1.0]])
    fit = np.array([[scale, 0.0, 320.0 + shift[0]], [0.0, scale, 240.0 + shift[1]], [0.0, 0.0, 1.0]])
    matrix = fit @ place @ centre
    fine = np.diag([4.0, 4.0, 1.0]) @ np.array([[1, 0, 0.375], [0, 1, 0.375], [0, 0, 1.0]]) @ matrix
    big = cv2.warpPerspective(picture, fine, (2560, 1920), flags=cv2.INTER_LINEAR, borderValue=110)
    image = cv2.GaussianBlur(cv2.resize(big, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    from_pitch = np.array([[SQUARE, 0.0, 59.5], [0.0, SQUARE, 59.5], [0.0, 0.0, 1.0]])
    return Frame(image, role="plain", name="view"), matrix @ from_pitch


@pytest.mark.parametrize("board", [CHARUCO, CHESS, CIRCLES], ids=lambda board: board.kind)
@pytest.mark.parametrize("turn", [0, 1])
def test_marks_are_where_they_are(board: Board, turn: int) -> None:
    frame, matrix = seen(board)
    if turn:
        frame = Frame(np.ascontiguousarray(np.rot90(frame.pixels)), role="plain")
        matrix = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 639.0], [0.0, 0.0, 1.0]]) @ matrix
    marks = find_marks(frame, board)
    at = np.column_stack([marks.board_mm[:, :2] / board.pitch_mm, np.ones(len(marks.board_mm))]) @ matrix.T
    off = np.hypot(*(at[:, :2] / at[:, 2:] - marks.xy_px).T)
    expected = 48 if board.kind == "circle-grid" else 40
    assert len(off) == expected
    if board.kind == "charuco":
        assert off.max() < 0.2, "px"
    else:  # these look the same turned by 180°, or may begin at any corner: distances tell
        size = np.linalg.norm(marks.board_mm[:, None] - marks.board_mm, axis=2)
        homography, _ = cv2.findHomography(marks.board_mm[:, :2], marks.xy_px)
        back = np.column_stack([marks.board_mm[:, :2], np.ones(len(off))]) @ homography.T
        assert np.hypot(*(back[:, :2] / back[:, 2:] - marks.xy_px).T).max() < 0.2, "px"
        assert np.linalg.det(homography) / homography[2, 2] ** 3 > 0, "right-handed, seen from the front"
        assert size.max() == pytest.approx(8.0 * np.hypot(7, 4 if board.kind == "chessboard" else 5))


def test_corners_of_a_noisy_chessboard_scatter_little(rng: np.random.Generator) -> None:
    """A window with more of the edges, up to those of the next corners, averages more noise."""
    frame, matrix = seen(CHESS, scale=0.2)
    off = []
    for _ in range(10):
        noisy = np.clip(frame.pixels + rng.normal(0.0, 8.0, frame.size), 0, 255).astype(np.uint8)
        marks = find_marks(Frame(noisy, role="plain"), CHESS)
        exact = cv2.perspectiveTransform(marks.board_mm[None, :, :2] / CHESS.pitch_mm, matrix)[0]
        turned = cv2.perspectiveTransform(
            np.array([CHESS.columns, CHESS.rows]) - marks.board_mm[None, :, :2] / CHESS.pitch_mm, matrix
        )[0]
        off += [min((marks.xy_px - one for one in (exact, turned)), key=lambda each: np.abs(each).max())]
    assert np.sqrt((np.concatenate(off) ** 2).sum(axis=1).mean()) < 0.067, "px"


@pytest.mark.parametrize("layout", ["new", "old"])
def test_the_layout_of_a_charuco_board_is_found_out(layout: str) -> None:
    frame, _ = seen(CHARUCO, layout=layout)
    marks = find_marks(frame, CHARUCO)
    assert (marks.layout, len(marks.xy_px)) == (layout, 40)


def test_a_charuco_board_may_hang_over_the_edge() -> None:
    frame, _ = seen(CHARUCO, shift=(-170.0, 0.0))
    assert 12 <= len(find_marks(frame, CHARUCO).xy_px) < 40


def spoilt(board: Board, fault: str) -> Frame:
    frame, _ = seen(board)
    pixels = frame.pixels
    if fault == "blurred":
        pixels = cv2.GaussianBlur(pixels, (0, 0), 14.0)
    elif fault == "tiny":
        pixels = seen(board, scale=0.14 if board.kind == "charuco" else 0.065)[0].pixels
    elif fault == "mirrored":
        pixels = np.ascontiguousarray(pixels[:, ::-1])
    elif fault == "cut off":
        pixels = seen(board, shift=(-330.0 if board.kind == "charuco" else -150.0, 0.0))[0].pixels
    elif fault == "nothing":
        pixels = np.full_like(pixels, 90)
    return Frame(pixels, role="plain", name=fault)


@pytest.mark.parametrize(
    ("board", "fault", "says"),
    [
        (CHARUCO, "blurred", "blurred"),
        (CHARUCO, "mirrored", "mirrored"),
        (CHARUCO, "cut off", "cut off"),
        (CHARUCO, "nothing", "no board is seen"),
        (CHESS, "blurred", "blurred"),
        (CHESS, "cut off", "cut off|another board"),
        (CHESS, "nothing", "no board is seen"),
        (CHARUCO, "tiny", r"too small: its markers are \d+ px wide"),
        (CHESS, "tiny", "too small"),
        (CIRCLES, "tiny", "too small"),
        (CIRCLES, "cut off", "cut off|another board"),
        (CIRCLES, "nothing", "no board is seen"),
    ],
)
def test_a_board_that_cannot_be_used_is_named(board: Board, fault: str, says: str) -> None:
    with pytest.raises(BoardNotFoundError, match=says):
        find_marks(spoilt(board, fault), board)


@pytest.mark.parametrize(
    ("board", "other"),
    [
        (CHARUCO, Board("c", "charuco", 9, 6, 8.0, 6.0, "DICT_5X5_250")),
        (CHESS, Board("b", "chessboard", 8, 6, 8.0)),
        (CHESS, Board("b", "chessboard", 11, 8, 8.0)),
        (CIRCLES, Board("g", "circle-grid", 6, 5, 8.0)),
        (CHARUCO, Board("c", "charuco", 12, 9, 8.0, 6.0, "DICT_4X4_250")),
    ],
)
def test_another_board_is_told(board: Board, other: Board) -> None:
    frame, _ = seen(other)
    with pytest.raises(BoardNotFoundError, match="another board"):
        find_marks(frame, board)


def test_sixteen_bits_are_as_good() -> None:
    frame, _ = seen(CHESS)
    deep = Frame(frame.pixels.astype(np.uint16) * 16, role="plain", bit_depth=12)
    assert np.abs(find_marks(deep, CHESS).xy_px - find_marks(frame, CHESS).xy_px).max() < 0.05, "px"


def shared_out(observed: CalibrationSet, factor: float) -> CalibrationSet:
    """Every second pose shows another board, whose pitch is described wrongly by a factor."""
    poses = list(dict.fromkeys(one.pose for one in observed.observations if one.shows == "board"))
    others = set(poses[1::2])
    first = observed.board
    assert first is not None
    second = replace(first, name="second", pitch_mm=factor * first.pitch_mm)
    moved = tuple(replace(one, board=int(one.pose in others)) for one in observed.observations)
    return replace(observed, observations=moved, more_boards=(second,))


@pytest.mark.thorough
def test_two_boards_that_agree_give_what_one_does(observed: CalibrationSet) -> None:
    found = PinholeCalibrator().calibrate(shared_out(observed, 1.0))
    ratio, std = found.residuals["board_2_ratio"], found.residuals["board_2_ratio_std"]
    assert abs(ratio - 1.0) < 3.0 * std < 0.02
    alone = PinholeCalibrator().calibrate(observed)
    stripe, row = np.repeat(np.arange(7), 3), np.tile([40.0, 100.0, 160.0], 7)
    x_px = LinearRig().rest_px()[stripe, row.astype(int)] + 20.0
    heights = [points_of(one.parameters, stripe, x_px, row)[:, 2] for one in (found, alone)]
    assert heights[0] == pytest.approx(heights[1], abs=0.05)  # mm
    assert any("one board alone" in note for note in alone.notes)
    assert not any("one board alone" in note for note in found.notes)


@pytest.mark.parametrize(
    "factor", [0.98, *(pytest.param(factor, marks=pytest.mark.thorough) for factor in (1.02, 1.1))]
)
def test_two_boards_that_disagree_are_refused_with_the_ratio(observed: CalibrationSet, factor: float) -> None:
    with pytest.raises(CalibrationError, match=rf"the pitch of the board second is {1.0 / factor:.3}"):
        PinholeCalibrator().calibrate(shared_out(observed, factor))


def test_a_second_board_gives_the_scale_of_a_first_whose_print_is_not_trusted(
    observed: CalibrationSet,
) -> None:
    wrong = shared_out(observed, 1.0)
    board = observed.board
    assert board is not None
    wrong = replace(wrong, board=replace(board, pitch_mm=1.03 * board.pitch_mm))
    found = PinholeCalibrator(PinholeCalibratorOptions(scale="free")).calibrate(wrong)
    assert found.residuals["pitch_ratio"] == pytest.approx(
        1.0 / 1.03, abs=3.0 * found.residuals["pitch_ratio_std"]
    )


def test_a_stretched_print_is_told_and_can_be_described(observed: CalibrationSet) -> None:
    board = observed.board
    assert board is not None
    wrong = replace(observed, board=replace(board, row_pitch_mm=1.01 * board.pitch_mm))
    try:
        said = " ".join(PinholeCalibrator().calibrate(wrong).notes)
    except CalibrationError as error:
        said = error.message
    # all boards lie alike in these images, so that the camera takes the stretch
    differs = re.search(r"fx and fy differ by ([\d.]+)%", said)
    assert differs is not None
    assert float(differs[1]) == pytest.approx(1.0, abs=0.15)
    assert "print of a board stretched" in said
    assert replace(board, row_pitch_mm=2.0).size_mm[1] == 2.0 * board.rows


def test_each_image_is_shown_with_the_reason_also_where_nothing_comes_of_it(observed: CalibrationSet) -> None:
    laser = next(n for n, one in enumerate(observed.observations) if one.shows == "board" and len(one.peaks))
    nothing = next(one.peaks for one in observed.observations if one.frame.role == "plain")
    dark = replace(observed.observations[laser], peaks=nothing)
    spoiled = replace(
        observed, observations=(*observed.observations[:laser], dark, *observed.observations[laser + 1 :])
    )
    calibrator = PinholeCalibrator()
    calibrator.calibrate(spoiled)
    found = calibrator.findings(spoiled)
    assert [one.observation for one in found] == list(spoiled.observations)
    assert "no stripe is seen" in found[laser].why
    used = [one for one in found if not one.why]
    assert len(used) == len(found) - 1
    assert all(len(one.corners_px) or len(one.points_px) for one in used)
    board = Board("another", "chessboard", columns=20, rows=15, pitch_mm=5.0)
    refused = replace(observed, board=board)
    with pytest.raises(CalibrationError) as refusal:
        calibrator.calibrate(refused)
    page = findings_page(calibrator.findings(refused), "rig", str(refusal.value))
    assert page.count("data:image/jpeg") == len(refused.observations)
    assert "There is no calibration" in page
    assert "it is another board" in page


RIG = SimulatedRig(1600.0, 350.0, tilt_deg=(6.0, -4.0), lens=(-0.2, 0.1, 0.0, 0.0, 0.0), stripes=5, poses=10)
FREE = np.arange(CAMERA) < 9


def bowed(exact: Shown, bow_mm: float) -> Shown:
    """What a board shows that is bent like a roof tile, with a twist; marks projected by hand."""
    extent = exact.corners.board_mm[:, :2].max(axis=0)
    warp = BoardWarp.none(*extent)
    coefficients = np.zeros(WARP_COEFFICIENTS)
    coefficients[[0, 1, 5]] = bow_mm, -0.4 * bow_mm, 0.2 * bow_mm  # x², xy, and xy² of the third order
    warp = warp.moved(coefficients)
    geometry = replace(exact.geometry, warp=warp)
    x, y = (exact.corners.board_mm[:, :2] - 0.5 * extent).T / (0.5 * extent.max())
    print_mm = exact.corners.board_mm.copy()
    print_mm[:, 2] = bow_mm * (x**2 - 0.4 * x * y + 0.2 * x * y**2)
    pose = exact.corners.pose
    at = (geometry.rotation[pose] @ print_mm[:, :, None])[:, :, 0] + geometry.shift[pose]
    xy = distort(at[:, :2] / at[:, 2:], geometry.camera[4:]).xy * geometry.camera[:2] + geometry.camera[2:4]
    points = exact.points
    for _ in range(4):
        points = replace(points, x_px=points.x_px - stripe_residuals(geometry, points))
    return replace(exact, geometry=geometry, corners=replace(exact.corners, xy_px=xy), points=points)


def measured(seen: Shown, start: Geometry, *, warp: bool) -> Measured:
    free = unknowns_of(start, free_camera=FREE, planes=True, belt=True, travel=False, warp=warp)
    return Measured(start, free, seen.corners, seen.points, seen.contacts, 0.03)


def test_marks_and_stripes_lie_on_the_bent_print(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.8)
    assert np.abs(corner_residuals(exact.geometry, exact.corners)).max() < 1e-9, "px"
    # where ray and plane of light meet, the print is
    on = exact.points.pose != ON_BELT
    pose = exact.points.pose[on]
    at = lifted(exact.geometry, exact.points)[on] - exact.geometry.shift[pose]
    board = (at[:, None, :] @ exact.geometry.rotation[pose])[:, 0]
    off = board[:, 2] - exact.geometry.warp.height_mm(board[:, :2])
    assert np.abs(off).max() < 1e-6, "mm"
    assert np.ptp(board[:, 2]) > 0.3, "mm"


def test_derivatives_are_those_of_the_equations(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.8)
    every = measured(exact, exact.geometry, warp=True).unknowns
    for rows, seen in ((corner_rows, exact.corners), (stripe_rows, exact.points)):
        assert_derivatives(rows, exact.geometry, every, seen, dict.fromkeys(every.warp, 1e-3), 2e-3)


def test_the_shape_is_found_and_planes_are_right_again(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.5)
    seen = noisy(exact, rng, 0.05, 0.1, 0.03)
    flat = replace(exact.geometry, warp=None)
    start = replace(exact.geometry, warp=exact.geometry.warp.moved(-exact.geometry.warp.coefficients_mm))
    found = measured(seen, start, warp=True).adjusted()
    assert found.corner_std_px == pytest.approx(0.05, rel=0.15)
    off = found.geometry.planes - exact.geometry.planes
    at = found.unknowns.planes
    covariance = found.covariance[at[:, :, None], at[:, None, :]]
    square = np.einsum("si,sij,sj->s", off, np.linalg.inv(covariance), off).mean() / 3.0
    assert square < 2.5
    assert found.geometry.warp.range_mm() == pytest.approx(exact.geometry.warp.range_mm(), abs=0.03), "mm"
    taken_for_flat = measured(seen, flat, warp=False).adjusted()
    assert taken_for_flat.corner_std_px > 1.5 * found.corner_std_px


def test_held_out_views_know_the_shape(rng) -> None:
    exact = bowed(shown(RIG, rng), 0.5)
    seen = noisy(exact, rng, 0.05, 0.1, 0.03)
    every = measured(seen, exact.geometry, warp=True)
    found = every.adjusted().geometry
    held = cross_validate(every, found)
    assert np.sqrt((held.mark_px**2).mean()) == pytest.approx(0.05, rel=0.2), "px"
    assert abs(held.height_mm.mean()) < 0.02, "mm"
    assert np.sqrt((stripe_offsets(found, seen.points)[0] ** 2).mean()) < 0.02, "mm"
