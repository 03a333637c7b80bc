"""Image files of a rig with a chessboard or a ChArUco board in many poses, for whole calibrations."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np

from roemetry.io.yaml_source import dump
from roemetry.records import Board
from roemetry_pinhole.boards import charuco_of
from roemetry_pinhole.geometry import turned

SIZE = (300, 400)
FOCAL_PX, NEAR_MM = 900.0, 300.0
STRIPES = 5
CHESS = Board("chess", "chessboard", columns=9, rows=6, pitch_mm=9.0, tolerance_mm=0.01, flatness_mm=0.01)
CHARUCO = Board(
    "charuco", "charuco", columns=9, rows=6, pitch_mm=9.0, marker_mm=6.8, dictionary="DICT_4X4_50",
    tolerance_mm=0.01, flatness_mm=0.01,
)  # fmt: skip
_SQUARE = 24
_SAMPLES = 3


def planes(lean: float = 0.5, count: int = STRIPES) -> np.ndarray:
    """(stripe, 3) p·X = 1 of a fan, camera frame; `lean` mm aside for each mm up."""
    x = np.linspace(-36.0, 36.0, count)
    leans = lean + 0.002 * x
    normal = np.column_stack([np.ones(count), np.full(count, 0.01), leans])
    return normal / (x + leans * NEAR_MM)[:, None]


def pose(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and shift to the camera's frame from the board's."""
    tilt = np.radians(22.0 + 4.0 * (number % 3))
    way = 2.0 * np.pi * number / 5.0
    rotation = turned(tilt * np.array([[np.cos(way), np.sin(way), 0.0]]))[0]
    middle = np.array(
        [8.0 * ((number % 3) - 1.0), 6.0 * ((number % 2) - 0.5), NEAR_MM - 8.0 - 3.0 * (number % 5)]
    )
    half = 0.5 * CHESS.pitch_mm * np.array([CHESS.columns, CHESS.rows, 0.0])
    return rotation, middle - rotation @ half


def plain(board: Board, rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The board under plain light."""
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    column = (np.arange(SIZE[1])[:, None] + offsets).ravel()
    row = (np.arange(SIZE[0])[:, None] + offsets).ravel()
    place = _places(*np.meshgrid(column, row), rotation, shift) / board.pitch_mm
    print_ = _printed(board)
    at = np.floor((place + 0.6) * _SQUARE).astype(int)
    inside = ((at >= 0) & (at < np.array(print_.shape)[::-1])).all(axis=-1)
    at[~inside] = 0
    light = np.where(inside, print_[at[..., 1], at[..., 0]], 70.0)
    light = light.reshape(SIZE[0], _SAMPLES, SIZE[1], _SAMPLES).mean(axis=(1, 3))
    return np.asarray(cv2.GaussianBlur(light, (0, 0), 0.6))


def lit(
    image: np.ndarray, lean: float, rotation: np.ndarray | None, shift: np.ndarray | None, stripes: range,
    count: int = STRIPES,
) -> np.ndarray:  # fmt: skip
    """The image with stripes on the board (on the belt where there is none) added."""
    found = image.copy()
    normal = np.array([0.0, 0.0, 1.0]) if rotation is None else rotation[:, 2]
    distance = NEAR_MM if shift is None else float(normal @ shift)
    y = (np.arange(SIZE[0]) - 149.5) / FOCAL_PX
    for stripe in stripes:
        line = distance * planes(lean, count)[stripe] - normal
        x_px = 199.5 - FOCAL_PX * (line[1] * y + line[2]) / line[0]
        glow = np.exp(-0.5 * ((np.arange(SIZE[1]) - x_px[:, None]) / 1.5) ** 2)
        if rotation is not None and shift is not None:
            place = _places(x_px, np.arange(SIZE[0], dtype=float), rotation, shift)
            size = CHESS.pitch_mm * np.array([CHESS.columns, CHESS.rows])
            glow[~((place > 0.0) & (place < size)).all(axis=1)] = 0.0
        found += 120.0 * glow
    return found


def written(
    folder: Path,
    board: Board = CHESS,
    *,
    poses: int = 8,
    lean: float = 0.5,
    stripes: dict[int, range] | None = None,
    count: int = STRIPES,
) -> Path:
    """Write belt, plain and laser images of the poses and a rig file; give its path.

    `stripes` says of a pose which stripes fall on its board; all, where it says nothing.
    """
    rng = np.random.default_rng(3)
    all_ = range(count)
    save(folder / "belt.png", lit(np.full(SIZE, 10.0), lean, None, None, all_, count), rng)
    for number in range(poses):
        rotation, shift = pose(number)
        image = _posed(board, number)
        save(folder / f"off_{number}.png", image, rng)
        falls = (stripes or {}).get(number, all_)
        save(folder / f"on_{number}.png", lit(image, lean, rotation, shift, falls, count), rng)
    described = {name: getattr(board, name) for name in board.__slots__ if getattr(board, name) is not None}
    data = {
        "roemetry_rig": 1,
        "name": "boards",
        "stripes": count,
        "board": described,
        "images": {"belt": ["belt.png"], "board": ["off_*.png"], "board_laser": ["on_*.png"]},
        "extractor": "centre-of-gravity",
        "calibrator": {"use": "pinhole-plane", "options": {"lens": "none"}},
    }
    path = folder / "rig.yaml"
    path.write_text(dump(data), encoding="utf-8")
    return path


@cache
def _posed(board: Board, number: int) -> np.ndarray:
    return 0.5 * plain(board, *pose(number))


def save(path: Path, image: np.ndarray, rng: np.random.Generator) -> None:
    """Write with a little noise, 8 bit."""
    noisy = image + rng.normal(0.0, 0.8, image.shape)
    cv2.imwrite(str(path), np.rint(noisy).clip(0, 255).astype(np.uint8))


def load(path: Path) -> np.ndarray:
    """Read an image."""
    found = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return found.astype(np.float64)


def _places(x_px: np.ndarray, row_px: np.ndarray, rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(…, 2) where pixels lie on the board, mm."""
    ray = np.stack([(x_px - 199.5) / FOCAL_PX, (row_px - 149.5) / FOCAL_PX, np.ones_like(x_px)], axis=-1)
    normal = rotation[:, 2]
    at = ray * ((normal @ shift) / (ray @ normal))[..., None]
    return np.asarray((at - shift) @ rotation[:, :2])


def _printed(board: Board) -> np.ndarray:
    """The print, `_SQUARE` pixels a square, with a white margin of 0.6 squares."""
    margin = int(0.6 * _SQUARE)
    if board.kind == "charuco":
        size = (board.columns * _SQUARE, board.rows * _SQUARE)
        picture = charuco_of(board, "new").generateImage(size, marginSize=0).astype(float)
    else:
        row, column = np.mgrid[: board.rows * _SQUARE, : board.columns * _SQUARE] // _SQUARE
        picture = np.where((row + column) % 2 == 0, 0.0, 255.0)
    light = 30.0 + picture * (170.0 / 255.0)
    return np.pad(light, margin, constant_values=200.0)
