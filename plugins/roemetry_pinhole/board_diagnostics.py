"""Why a board cannot be used: looked into where none was found, so that the user knows what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Board
from roemetry.records.arrays import Floats

_BLURRED_PX = 8.0
_DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")
_ENLARGED = 4
_MARKERS_MIN = 4
_SQUARES_MIN = 25
_SQUARE_MAX_PX = 12.0


NEARER = "hold it nearer, or take a larger one"
SHARPER = "focus, hold the board still, shorten the exposure"
_WHOLE = "hold it wholly inside the image"
_OTHER = "correct `board` in the rig file, or leave the image out"
_ADVICE = "; is it there, lit, in front of something that differs from it?"
_NONE = "no board is seen" + _ADVICE


class BoardNotFoundError(Exception):
    """A board cannot be used; says why."""


def why_no_charuco(grey: NDArray[np.uint8], board: Board, corners: int) -> str:
    """Say why a ChArUco board shows too few corners."""
    expected = (board.columns - 1) * (board.rows - 1)
    own = _markers(grey, str(board.dictionary))
    mirrored = _markers(np.ascontiguousarray(grey[:, ::-1]), str(board.dictionary))
    if mirrored > max(2, 2 * own):  # a few false ones are found in any image
        return (
            "the image is mirrored: the board's markers are found in its mirror image; switch the camera's "
            "mirroring off, or give the image as it was taken"
        )
    tiny = _tiny(grey, str(board.dictionary))
    if tiny:
        return tiny
    if own < 3:
        for name in _DICTIONARIES:
            found = _markers(grey, name)
            if found > max(3, 2 * own) and not name.startswith(str(board.dictionary)[:8]):
                return (
                    f"it is another board: {found} markers of {name} are seen, {own} of {board.dictionary}; "
                    + _OTHER
                )
    if own == 0:
        return _blurred(grey) or _NONE
    if own > 4 and corners < 4:
        ids = np.ravel(_ids(grey, str(board.dictionary)))
        count = len(board_ids(board))
        if ids.size and ids.max() >= count:
            return (
                f"it is another board: marker {ids.max()} is seen, the one described has 0 to {count - 1}; "
                + _OTHER
            )
        return (
            f"the markers do not stand as on a board of {board.columns} × {board.rows}: is it another one? "
            + _OTHER
        )
    return f"the board is cut off: {corners} of {expected} corners are seen; show more of it"


def why_no_chessboard(grey: NDArray[np.uint8], board: Board) -> str:
    """Say why no chessboard of the described size was found."""
    import cv2

    expected = sorted((board.columns - 1, board.rows - 1))
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    blurred = _blurred(grey)  # then what is found is a part of the board, not the whole of another one
    if not found or meta is None or blurred:
        return blurred or _NONE
    size = sorted(meta.shape)
    xy = corners.reshape(-1, 2)
    pitch = float(np.median(np.hypot(*np.diff(xy[: meta.shape[1]], axis=0).T)))
    low, high = xy.min(axis=0), xy.max(axis=0)
    at_border = (low < 1.5 * pitch).any() or (high > np.array(grey.shape[::-1]) - 1.5 * pitch).any()
    if at_border and size[0] <= expected[0] and size[1] <= expected[1]:
        return (
            f"the board is cut off: {size[1]} × {size[0]} of {expected[1]} × {expected[0]} corners are seen; "
            + _WHOLE
        )
    return (
        f"it is another board: {size[1]} × {size[0]} inner corners are seen, the one described has "
        f"{expected[1]} × {expected[0]}; {_OTHER}"
    )


def why_no_circles(grey: NDArray[np.uint8], board: Board, circles_px: Floats) -> str:
    """Say why no grid was found among dark circles at (circle, 2)."""
    expected, count = board.columns * board.rows, len(circles_px)
    if count < expected / 4:
        return _blurred(grey) or f"no board is seen ({count} dark circles, {expected} are expected)" + _ADVICE
    if count >= expected:
        return (
            f"{count} dark circles are seen, no grid of {board.columns} × {board.rows}: is it another board? "
            + _OTHER
        )
    apart = np.hypot(*(circles_px[:, None] - circles_px[None]).transpose(2, 0, 1))
    pitch = float(np.median(np.sort(apart, axis=1)[:, 1]))
    low, high = circles_px.min(axis=0), circles_px.max(axis=0)
    if (low < 1.5 * pitch).any() or (high > np.array(grey.shape[::-1]) - 1.5 * pitch).any():
        return f"the board is cut off: {count} of {expected} circles are seen; {_WHOLE}"
    return (
        f"{count} dark circles are seen, {expected} are expected: is it another board, or is a part covered? "
        + _OTHER
    )


def board_ids(board: Board) -> NDArray[Any]:
    """Give the ids of a ChArUco board's markers."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(board.dictionary)))
    marker_mm = float(board.marker_mm or 0.0)
    made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_mm, marker_mm, dictionary)
    return np.ravel(made.getIds())


def _markers(grey: NDArray[np.uint8], dictionary: str) -> int:
    return int(_ids(grey, dictionary).size)


def _ids(grey: NDArray[np.uint8], dictionary: str) -> NDArray[Any]:
    import cv2

    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)))
    ids = detector.detectMarkers(grey)[1]
    return np.empty(0, np.int64) if ids is None else np.ravel(ids)


def _tiny(grey: NDArray[np.uint8], dictionary: str) -> str:
    """Say that markers are too small to be read, by what an enlarged image shows; "" where they are not."""
    import cv2

    large = cv2.resize(grey, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)))
    corners, _, squares = detector.detectMarkers(large)

    def width_px(found: Sequence[NDArray[Any]]) -> float:
        return float(np.median([np.hypot(*(one[0, 1] - one[0, 0])) for one in found])) / _ENLARGED

    if len(corners) >= _MARKERS_MIN:
        width = width_px(corners)
        return (
            f"the board is tiny: its markers are {width:.0f} px wide, 14 px are needed; {NEARER}"
            if width < 14
            else ""
        )
    if not corners and len(squares) >= _SQUARES_MIN and width_px(squares) < _SQUARE_MAX_PX:
        return (
            f"no board is seen, but {len(squares)} small squares: is the board tiny, too far away? {NEARER}"
        )
    return ""


def _blurred(grey: NDArray[np.uint8]) -> str:
    """Say that nothing in the image is sharp; "" where something is."""
    import cv2

    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.5)
    slope = np.hypot(
        cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
    )
    low, high = np.percentile(smooth, [1, 99])
    width = float(high - low) / max(float(np.percentile(slope, 99.5)), 1e-3)
    if width > _BLURRED_PX:
        return (
            f"no board is seen, and nothing is sharp: edges are {width:.0f} px wide; is the image blurred? "
            + SHARPER
        )
    return ""
