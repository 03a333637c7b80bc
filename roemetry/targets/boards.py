"""The pattern of a flat board, in millimetres from its top-left corner."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from roemetry.config.target_file import BoardFile
from roemetry.errors import ConfigurationError
from roemetry.targets.sheet import Disc, Rectangle, Shape

_DISC_SHARE = 0.5
"""A circle's diameter over the distance from circle to circle."""


def board_size_mm(board: BoardFile) -> tuple[float, float]:
    """Width and height of the pattern."""
    return board.columns * board.pitch_mm, board.rows * board.pitch_mm


def board_shapes(board: BoardFile) -> tuple[Shape, ...]:
    """Draw a board's pattern; raise ConfigurationError for markers that OpenCV does not have."""
    if board.kind == "circle-grid":
        return tuple(_circles(board))
    if board.kind == "chessboard":
        return tuple(_squares(board, dark_corner=True))
    return tuple(_charuco(board))


def _circles(board: BoardFile) -> Iterator[Shape]:
    for row in range(board.rows):
        for column in range(board.columns):
            yield Disc(
                (column + 0.5) * board.pitch_mm,
                (row + 0.5) * board.pitch_mm,
                0.5 * _DISC_SHARE * board.pitch_mm,
            )


def _squares(board: BoardFile, *, dark_corner: bool) -> Iterator[Shape]:
    """Dark squares; `dark_corner` says whether the one at the top left is."""
    side = board.pitch_mm
    for row in range(board.rows):
        for column in range(board.columns):
            if ((row + column) % 2 == 0) == dark_corner:
                yield Rectangle(column * side, row * side, side, side)


def _charuco(board: BoardFile) -> Iterator[Shape]:
    """Squares and markers where OpenCV puts them; `auto` prints the new layout."""
    import cv2

    number = getattr(cv2.aruco, str(board.dictionary), None)
    if not isinstance(number, int) or not str(board.dictionary).startswith("DICT_"):
        known = ", ".join(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        raise ConfigurationError(
            f"`{board.name}`: there is no dictionary {board.dictionary}", hint=f"OpenCV has {known}"
        )
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    needed = board.columns * board.rows // 2
    if needed > len(dictionary.bytesList):
        raise ConfigurationError(
            f"`{board.name}`: it takes {needed} markers, {board.dictionary} has {len(dictionary.bytesList)}",
            hint="a larger dictionary of the same family, such as DICT_4X4_1000, or fewer squares",
        )
    made = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.pitch_mm, float(board.marker_mm or 0.0), dictionary
    )
    made.setLegacyPattern(board.layout == "old")
    corners = np.asarray(made.getObjPoints())[:, :, :2].min(axis=1)
    first = corners[0] // board.pitch_mm
    yield from _squares(board, dark_corner=bool(first.sum() % 2))
    bits = dictionary.markerSize + 2
    module_mm = float(board.marker_mm or 0.0) / bits
    for corner, marker in zip(corners, np.asarray(made.getIds()).ravel(), strict=True):
        image = dictionary.generateImageMarker(int(marker), bits, borderBits=1)
        dark = np.asarray(image) == 0
        yield from _bars(dark, corner, module_mm, upright=False)
        # Bars across the others: without them a hair of white shows where two rows of modules meet.
        yield from _bars(dark.T, corner, module_mm, upright=True)


def _bars(dark: np.ndarray, corner: np.ndarray, module_mm: float, *, upright: bool) -> Iterator[Shape]:
    """A bar for each run of dark modules in a marker's rows, or (transposed) in its columns."""
    x, y = float(corner[0]), float(corner[1])
    for index, line in enumerate(dark):
        for begin, end in _runs(line):
            along, across, long = begin * module_mm, index * module_mm, (end - begin) * module_mm
            if upright:
                yield Rectangle(x + across, y + along, module_mm, long)
            else:
                yield Rectangle(x + along, y + across, long, module_mm)


def _runs(dark: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and one past the last of each run of dark modules."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], dark, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
