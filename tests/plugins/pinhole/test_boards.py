"""Boards in images: found where they are, and refused by name where they cannot be used."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from roemetry.records import Board, Frame
from roemetry_pinhole.boards import BoardNotFoundError, charuco_of, find_marks

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
