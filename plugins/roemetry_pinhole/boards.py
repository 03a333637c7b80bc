"""Boards in images: where their marks are, and which views can be used.

Marks are inner corners of squares (chessboard, ChArUco), found and refined by OpenCV with a window that ends
before the next edge, or centres of dark circles. A circle's centre of gravity is not where its centre is
seen: under perspective and distortion it moves, and is corrected once the pose is nearly known. A view is
used when its marks are enough, far enough apart, sharp, and lie as on the described board; else the reason is
kept by name: blurred, tiny, cut off, mirrored, another board, laser-on and laser-off exchanged.

A pose has up to two images: with the laser off, which shows the marks and how even the print is, and with the
laser on, whose difference to the first shows the stripes.

It assumes a flat board, up to the lens and what warp is described. It fails where the pitch is described
wrongly: marks alone cannot tell a size (`roemetry_pinhole.scale`, `roemetry_pinhole.prints`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Board, CalibrationSet, Frame, Observation, Peaks
from roemetry.records.arrays import Flags, Floats

_BLURRED_PX = 8.0
"""Width of the sharpest edges, px: with more, corners are found off their place or not at all."""
_DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")
"""Tried to tell which board is shown instead of the described one."""
_ENLARGED = 4  # times, for markers that are too small for the detector (6 px and less)
_MARKERS_MIN = 4  # markers in the enlarged image: fewer are found by chance in print and texture
_SQUARES_MIN = 25  # squares in it: a tiny board shows dozens, a room few
_SQUARE_MAX_PX = 12.0  # width of a square, px: wider ones would have been read as markers


NEARER = "hold it nearer, or take a larger one"
SHARPER = "focus, hold the board still, shorten the exposure"
_WHOLE = "hold it wholly inside the image"
_OTHER = "correct `board` in the rig file, or leave the image out"


_ADVICE = "is it there, lit, in front of something that differs from it?"


class BoardNotFoundError(Exception):
    """A board cannot be used; says why. The reason is looked for when it is read: that may take a second."""

    def __init__(self, why: str | Callable[[], str]) -> None:
        super().__init__()
        self._why = why

    def __str__(self) -> str:
        """Give the reason."""
        return self._why if isinstance(self._why, str) else self._why()


def diagnose_charuco(grey: NDArray[np.uint8], board: Board, corners: int) -> str:
    """Say why a ChArUco board shows too few corners."""
    import cv2

    def ids_of(image: NDArray[np.uint8], dictionary: str) -> NDArray[Any]:
        ids = cv2.aruco.ArucoDetector(_dictionary(dictionary)).detectMarkers(image)[1]
        return np.empty(0, np.int64) if ids is None else np.ravel(ids)

    described = str(board.dictionary)
    ids = ids_of(grey, described)
    own = ids.size
    mirrored = ids_of(np.ascontiguousarray(grey[:, ::-1]), described).size
    if mirrored > max(2, 2 * own):  # a few false ones are found in any image
        return (
            "the image is mirrored: the board's markers are found in its mirror image; switch the camera's "
            "mirroring off, or give the image as it was taken"
        )
    tiny = _tiny(grey, described)
    if tiny:
        return tiny
    # another dictionary is only tried where hardly a marker of the described one is seen
    for name in _DICTIONARIES if own < 3 else ():
        found = ids_of(grey, name).size
        if found > max(3, 2 * own) and not name.startswith(described[:8]):
            return f"it is another board: {found} markers of {name} are seen, {own} of {described}; {_OTHER}"
    if own == 0:
        return _blurred(grey) or f"no board is seen; {_ADVICE}"
    if own > 4 and corners < 4:
        count = np.size(charuco_of(board, "new").getIds())
        if ids.max() >= count:
            return (
                f"it is another board: marker {ids.max()} is seen, the one described has 0 to {count - 1}; "
                + _OTHER
            )
        return (
            f"the markers do not stand as on a board of {board.columns} × {board.rows}: is it another one? "
            + _OTHER
        )
    expected = (board.columns - 1) * (board.rows - 1)
    return f"the board is cut off: {corners} of {expected} corners are seen; show more of it"


def _dictionary(name: str) -> Any:
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def diagnose_chessboard(grey: NDArray[np.uint8], board: Board) -> str:
    """Say why no chessboard of the described size was found."""
    import cv2

    expected = sorted((board.columns - 1, board.rows - 1))
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    blurred = _blurred(grey)  # then what is found is a part of the board, not the whole of another one
    if not found or meta is None or blurred:
        return blurred or f"no board is seen; {_ADVICE}"
    size = sorted(meta.shape)
    xy = corners.reshape(-1, 2)
    pitch = float(np.median(np.hypot(*np.diff(xy[: meta.shape[1]], axis=0).T)))
    if _at_border(xy, pitch, grey) and size[0] <= expected[0] and size[1] <= expected[1]:
        return (
            f"the board is cut off: {size[1]} × {size[0]} of {expected[1]} × {expected[0]} corners are seen; "
            + _WHOLE
        )
    return (
        f"it is another board: {size[1]} × {size[0]} inner corners are seen, the one described has "
        f"{expected[1]} × {expected[0]} ({expected[1] + 1} × {expected[0] + 1} squares); {_OTHER}"
    )


def _at_border(xy_px: Floats, pitch_px: float, grey: NDArray[np.uint8]) -> bool:
    room = 1.5 * pitch_px
    return bool((xy_px < room).any() or (xy_px > np.array(grey.shape[::-1]) - room).any())


def diagnose_circles(grey: NDArray[np.uint8], board: Board, circles_px: Floats) -> str:
    """Say why no grid was found among dark circles at (circle, 2)."""
    expected, count = board.columns * board.rows, len(circles_px)
    if count < expected / 4:
        return _blurred(grey) or (
            f"no board is seen ({count} dark circles, {expected} are expected); {_ADVICE}"
        )
    if count >= expected:
        return (
            f"{count} dark circles are seen, no grid of {board.columns} × {board.rows}: is it another board? "
            + _OTHER
        )
    apart = np.hypot(*(circles_px[:, None] - circles_px[None]).transpose(2, 0, 1))
    if _at_border(circles_px, float(np.median(np.sort(apart, axis=1)[:, 1])), grey):
        return f"the board is cut off: {count} of {expected} circles are seen; {_WHOLE}"
    return (
        f"{count} dark circles are seen, {expected} are expected: is it another board, or is a part covered? "
        + _OTHER
    )


def _tiny(grey: NDArray[np.uint8], dictionary: str) -> str:
    """Say that markers are too small to be read, by what an enlarged image shows; "" where they are not."""
    import cv2

    large = cv2.resize(grey, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    corners, _, squares = cv2.aruco.ArucoDetector(_dictionary(dictionary)).detectMarkers(large)

    def width_px(found: Sequence[NDArray[Any]]) -> float:
        return float(np.median([np.hypot(*(one[0, 1] - one[0, 0])) for one in found])) / _ENLARGED

    if len(corners) >= _MARKERS_MIN and width_px(corners) < 14:
        return (
            f"the board is too small: its markers are {width_px(corners):.0f} px wide, 14 px are needed; "
            + NEARER
        )
    if not corners and len(squares) >= _SQUARES_MIN and width_px(squares) < _SQUARE_MAX_PX:
        return (
            f"no board is seen, but {len(squares)} small squares: is it too small, or too far away? {NEARER}"
        )
    return ""


def _smooth_and_slope(grey: NDArray[np.uint8], sigma_px: float) -> tuple[Floats, Floats]:
    """Give the smoothed image, and how steep it is, grey levels per px."""
    import cv2

    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), sigma_px)
    along, down = (cv2.Sobel(smooth, cv2.CV_32F, x, 1 - x, scale=0.125) for x in (1, 0))
    return np.asarray(smooth), np.hypot(along, down)


def _blurred(grey: NDArray[np.uint8]) -> str:
    """Say that nothing in the image is sharp; "" where something is."""
    smooth, slope = _smooth_and_slope(grey, 1.5)
    # the range of grey over the steepest slope is the width of the sharpest edge
    low, high = np.percentile(smooth, [1, 99])
    width = float(high - low) / max(float(np.percentile(slope, 99.5)), 1e-3)
    if width <= _BLURRED_PX:
        return ""
    return (
        f"no board is seen, and nothing is sharp: edges are {width:.0f} px wide; is the image blurred? "
        + SHARPER
    )


_SPACING_MIN_PX = 8.0
"""Distance of neighbouring marks, px: below it the windows that refine a corner hold the next corner's
edges."""
_EDGE_SHARE_MAX = 0.45
"""Width of an edge over the distance of marks: with more, edges of neighbours overlap and shift each
other."""
_CHARUCO_MIN = 12
"""Corners: fewer do not tell a pose of eight numbers (a homography) with something to spare. No change of
heights from 7 to 19."""
_CHARUCO_SPAN_MIN = 0.3
"""Of the board's sides: from a smaller part of it tilt and distance are not told apart."""
_FIT_SHARE_MAX = 0.12
"""Of the distance of marks, for their median distance from a homography: a strong lens bends by 0.05, another
board by 0.3 and more."""
_WINDOW_SHARE = 0.36
"""Half the window that refines a corner of a chessboard, over the distance of corners: scatter falls as it
grows, but with 0.40 heights on held-out views of a small tilted board are 0.07 mm off, here below 0.05."""
_CIRCLE_AREA_MIN_PX = 12.0  # area of a circle, px²: below it, its centre is known to no better than 0.1 px


@dataclass(frozen=True, eq=False, slots=True)
class BoardMarks:
    """Marks of a board found in one image."""

    board_mm: Floats
    """(mark, 3) on the board: origin at the outer corner of the first square (of a grid: half a pitch off the
    first circle), x along the columns, y along the rows, z away from the camera."""
    xy_px: Floats
    """(mark, 2) in the image."""
    layout: str
    """Of a ChArUco board the layout that fits, ``new`` or ``old``; else ""."""
    edge_px: float
    spacing_px: float
    """edge_px, spacing_px: width of its edges in the image, range of grey levels over the steepest slope, and
    median distance of neighbouring marks, px."""
    radius_mm: float = 0.0
    """Of a grid's circles, estimated from their area in the image; 0 for other boards."""


def find_marks(frame: Frame, board: Board) -> BoardMarks:
    """Find a board.

    Raises
    ------
    BoardNotFoundError
        It cannot be used, with the reason: not there, blurred, tiny, cut off, mirrored, another board.
    """
    import cv2

    grey = np.ascontiguousarray(frame.pixels)
    # OpenCV's detectors take 8 bits
    if grey.dtype != np.uint8 or frame.bit_depth != 8:
        grey = np.rint(grey * (255.0 / frame.white)).clip(0, 255).astype(np.uint8)
    layout, radius_mm = "", 0.0
    if board.kind == "charuco":
        board_mm, xy_px, layout = _charuco(grey, board)
    elif board.kind == "chessboard":
        board_mm, xy_px = _chessboard(grey, board)
    else:
        board_mm, xy_px, radius_mm = _circles(grey, board)
    spacing_px = _spacing(board_mm, xy_px, board.pitch_mm)
    # found on a square grid; rows may have another pitch
    board_mm[:, 1] *= (board.row_pitch_mm or board.pitch_mm) / board.pitch_mm
    edge_px = _edge_width(grey, xy_px, spacing_px)
    if spacing_px < _SPACING_MIN_PX:
        raise BoardNotFoundError(
            f"the board is too small: its corners are {spacing_px:.1f} px apart, "
            f"{_SPACING_MIN_PX:g} px are needed; {NEARER}"
        )
    if edge_px > _EDGE_SHARE_MAX * spacing_px:
        raise BoardNotFoundError(
            f"the board is blurred: its edges are {edge_px:.1f} px wide, its corners {spacing_px:.1f} px "
            f"apart; {SHARPER}"
        )
    # a board is flat: a homography fits, but for the lens
    matrix = cv2.findHomography(board_mm[:, :2].copy(), xy_px, 0)[0]
    if matrix is None:
        raise BoardNotFoundError(
            "the board is seen edge on: its corners lie on a line; turn it towards the camera"
        )
    seen = np.column_stack([board_mm[:, :2], np.ones(len(board_mm))]) @ matrix.T
    off_px = float(np.median(np.hypot(*(seen[:, :2] / seen[:, 2:] - xy_px).T)))
    if off_px > _FIT_SHARE_MAX * spacing_px:
        raise BoardNotFoundError(
            f"the corners do not lie as on a board of {board.columns} × {board.rows}: "
            f"they are {off_px:.1f} px off; is it another board? Correct `board`, or leave the image out"
        )
    return BoardMarks(board_mm, xy_px, layout, edge_px, spacing_px, radius_mm)


def _charuco(grey: NDArray[np.uint8], board: Board) -> tuple[Floats, Floats, str]:
    import cv2

    expected = (board.columns - 1) * (board.rows - 1)
    best: tuple[int, Any, Any, str] = (0, None, None, "")
    pattern = charuco_of(board, "new")
    for layout in ("new", "old") if board.layout == "auto" else (board.layout,):
        tried = charuco_of(board, layout)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(tried).detectBoard(grey)
        if ids is not None and len(ids) > best[0]:
            best, pattern = (len(ids), corners, ids, layout), tried
        if best[0] > 0.7 * expected:
            break  # another layout does not show that many
    count, corners, ids, layout = best
    if count < _CHARUCO_MIN:
        raise BoardNotFoundError(lambda: diagnose_charuco(grey, board, count))
    places = np.asarray(pattern.getChessboardCorners(), np.float64)[np.ravel(ids)]
    places[:, 2] = 0.0
    spanned = np.ptp(places[:, :2], axis=0) / (board.pitch_mm * np.array([board.columns, board.rows]))
    if spanned.min() < _CHARUCO_SPAN_MIN:
        raise BoardNotFoundError(
            f"the board is cut off: {count} of {expected} corners are seen; show more of it"
        )
    xy = np.asarray(corners, np.float32).reshape(-1, 1, 2)
    spacing = _spacing(places, xy[:, 0, :].astype(np.float64), board.pitch_mm)
    # markers stand near the corners: their edges must stay outside the window
    room = 0.5 * (1.0 - float(board.marker_mm or 0.0) / board.pitch_mm)
    return places, _refined(grey, xy, spacing, share=0.85 * room), layout


def charuco_of(board: Board, layout: str) -> Any:
    """Give OpenCV's ChArUco board of a layout, ``new`` or ``old``."""
    import cv2

    size, marker_mm = (board.columns, board.rows), float(board.marker_mm or 0.0)
    made = cv2.aruco.CharucoBoard(size, board.pitch_mm, marker_mm, _dictionary(str(board.dictionary)))
    made.setLegacyPattern(layout == "old")
    return made


def _chessboard(grey: NDArray[np.uint8], board: Board) -> tuple[Floats, Floats]:
    import cv2

    size = (board.columns - 1, board.rows - 1)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not found:
        found, corners = cv2.findChessboardCorners(
            grey, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        )
        if not found:
            raise BoardNotFoundError(lambda: diagnose_chessboard(grey, board))
    corners = np.asarray(corners, np.float32).reshape(size[1], size[0], 2)
    apart = [np.linalg.norm(np.diff(corners, axis=axis), axis=2) for axis in (0, 1)]
    # over a window that holds more of the edges than the detector's own it scatters less
    xy = _refined(grey, corners.reshape(-1, 1, 2), min(float(np.median(one)) for one in apart), _WINDOW_SHARE)
    return _grid(xy.reshape(corners.shape), board.pitch_mm, 1.0)


def _circles(grey: NDArray[np.uint8], board: Board) -> tuple[Floats, Floats, float]:
    import cv2 as typed_cv2

    cv2: Any = typed_cv2  # its type stubs lack the blob detector
    size = (board.columns, board.rows)
    options = cv2.SimpleBlobDetector_Params()
    options.minArea, options.maxArea = _CIRCLE_AREA_MIN_PX, grey.size / (4.0 * board.columns * board.rows)
    options.filterByInertia, options.minInertiaRatio = True, 0.1
    options.minConvexity, options.minDistBetweenBlobs = 0.9, 4.0
    options.minThreshold, options.maxThreshold, options.thresholdStep = 20.0, 230.0, 10.0
    detector = cv2.SimpleBlobDetector_create(options)
    found = False
    for flags in (cv2.CALIB_CB_SYMMETRIC_GRID, cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING):
        if not found:
            found, centres = cv2.findCirclesGrid(grey, size, flags=flags, blobDetector=detector)
    if not found:
        circles = np.array([one.pt for one in detector.detect(grey)], np.float64).reshape(-1, 2)
        raise BoardNotFoundError(lambda: diagnose_circles(grey, board, circles))
    xy = np.asarray(centres, np.float64).reshape(size[1], size[0], 2)
    board_mm, places = _grid(xy, board.pitch_mm, 0.5)
    centres, area_px = _centred(grey, places, _spacing(board_mm, places, board.pitch_mm))
    matrix = cv2.findHomography(board_mm[:, :2], centres, 0)[0]
    homogeneous = np.column_stack([board_mm[:, :2], np.ones(len(board_mm))]) @ matrix.T
    # area of the image of a unit of the board, at each mark
    scale = np.abs(np.linalg.det(matrix) / homogeneous[:, 2] ** 3)
    return board_mm, centres, float(np.sqrt(np.nanmedian(area_px / scale) / np.pi))


def _grid(xy: Floats, pitch_mm: float, first: float) -> tuple[Floats, Floats]:
    """Give places on the board and in the image, of marks (row, column, 2) in either order of the columns."""
    # rows follow columns clockwise in the image, whose y points down
    along, down = xy[0, -1] - xy[0, 0], xy[-1, 0] - xy[0, 0]
    xy = xy if along[0] * down[1] - along[1] * down[0] > 0 else xy[:, ::-1]
    row, column = np.indices(xy.shape[:2])
    places = np.stack([column + first, row + first, np.zeros(row.shape)], axis=2) * pitch_mm
    return places.reshape(-1, 3), xy.reshape(-1, 2)


def _refined(grey: NDArray[np.uint8], corners: Any, spacing_px: float, share: float) -> Floats:
    import cv2

    half = int(np.clip(int(share * spacing_px), 2, 15))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = np.ascontiguousarray(corners, np.float32)
    refined = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), stop)
    return np.asarray(refined, np.float64).reshape(-1, 2)


def _centred(grey: NDArray[np.uint8], xy: Floats, spacing_px: float) -> tuple[Floats, Floats]:
    """Centre of gravity and area of each dark circle; pixels count by how dark they are."""
    half = int(np.clip(round(0.48 * spacing_px), 3, 200))
    rows, columns = grey.shape
    found, area = xy.copy(), np.full(len(xy), np.nan)
    for mark, (x, y) in enumerate(xy):
        left, top = round(x) - half, round(y) - half
        if left < 0 or top < 0 or left + 2 * half >= columns or top + 2 * half >= rows:
            continue
        patch = grey[top : top + 2 * half + 1, left : left + 2 * half + 1].astype(np.float64)
        dark, light = np.percentile(patch, [5, 85])
        # from dark to light, clipped at a tenth of either: noise outside counts nothing
        weight = np.clip((light - 0.1 * (light - dark) - patch) / (0.8 * (light - dark) + 1e-9), 0.0, 1.0)
        v, u = np.indices(patch.shape)
        # within a circle, so that neighbours in the window's corners do not pull
        weight *= np.hypot(u - half, v - half) <= half
        area[mark] = weight.sum()
        found[mark] = left + (weight * u).sum() / area[mark], top + (weight * v).sum() / area[mark]
    # a centre that moved far followed something else
    near = np.hypot(*(found - xy).T) < 0.1 * spacing_px
    return np.where(near[:, None], found, xy), np.where(near, area, np.nan)


def _spacing(board_mm: Floats, xy_px: Floats, pitch_mm: float) -> float:
    """Median distance, px, of marks that are one pitch apart."""
    way = np.abs(board_mm[:, None, :2] - board_mm[None, :, :2]).sum(axis=2)
    one, other = np.nonzero(np.abs(way - pitch_mm) < 0.01 * pitch_mm)
    return float(np.median(np.hypot(*(xy_px[one] - xy_px[other]).T))) if one.size else 0.0


def _edge_width(grey: NDArray[np.uint8], xy_px: Floats, spacing_px: float) -> float:
    """Median over the marks of the range of grey levels around them over the steepest slope there, px."""
    smooth, slope = _smooth_and_slope(grey, 0.7)
    half = max(int(0.5 * spacing_px), 2)
    widths = []
    for x, y in np.rint(xy_px).astype(int):
        window = np.s_[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]
        low, high = np.percentile(smooth[window], [3, 97])
        widths.append(float(high - low) / max(float(slope[window].max()), 1e-3))
    return float(np.median(widths))


_LIT_GREY = 0.06
"""Of white: what the laser must add or take to count as a change; noise of two images is 0.01 to 0.02."""
_UNEVEN_NOISE = 0.02
"""Of white: differences of grey that noise alone makes within a stripe's width. Heights change by 0.4 µm at
0.012 and at 0.032."""
_LIT_SHARE_MIN = 2e-4  # of the image: one stripe of 2 px along a tenth of the rows is as much
_OTHER_LIGHT_SHARE = 0.25
"""Of the image: where more is darker, the two were taken in different light and cannot be compared."""


@dataclass(frozen=True, eq=False, slots=True)
class BoardView:
    """The board in one pose."""

    name: str
    marks: BoardMarks
    """name, marks: of the image in which its marks were found, and these."""
    laser: Observation | None
    plain: Observation | None
    """laser, plain: the images with the laser on, with its peaks, and off; None where none can be used."""
    on_belt: bool
    """Whether the board lies on the belt."""
    count: float
    """Encoder count; NaN where not known."""
    board: Board
    number: int = 0
    """board, number: the board as described, and its number among those of the set."""
    pose: str = ""
    """The pose, by the number in its images' names."""
    raw_px: Floats | None = None
    """(mark, 2) of circles: their centres of gravity, where those of `marks` have been corrected."""


@dataclass(eq=False, slots=True)
class Seen:
    """All poses that can be used, and by image why others cannot."""

    views: list[BoardView] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    """What else is to be said of them."""


def board_views(observed: CalibrationSet, seen: Seen) -> None:
    """Find the boards in every pose; in the laser-off image if there is one and it serves."""
    for shows in ("board", "board_on_belt"):
        poses: dict[tuple[int, str], dict[str, Observation]] = {}
        for observation in observed.showing(shows):
            poses.setdefault((observation.board, observation.pose), {})[observation.frame.role] = observation
        for (number, name), pose in poses.items():
            board, on_belt = observed.boards[number], shows == "board_on_belt"
            # the image with the laser off first: no stripe crosses a mark in it
            plain, laser = pose.get("plain"), pose.get("laser")
            found = _marks([one for one in (plain, laser) if one is not None], board, seen)
            if found is None:
                continue
            frame, marks = found
            of_pose: dict[str, Any] = {"board": board, "number": number, "pose": name, "on_belt": on_belt}
            if laser is not None and plain is not None:
                fault = _lit(plain, laser)
                elsewhere = None if fault else _elsewhere(plain, laser, board, marks)
                if fault:
                    seen.left_out[laser.frame.name] = fault
                    laser = None
                elif elsewhere is not None:
                    shown = laser.frame.name
                    seen.notes.append(
                        f"the board moved by {_apart_px(marks, elsewhere):.1f} px between {plain.frame.name} "
                        f"and {shown}, whose names have the same number: taken for two poses"
                    )
                    seen.views.append(BoardView(shown, elsewhere, laser, None, count=np.nan, **of_pose))
                    laser = None
            count = plain.frame.encoder_count if plain is not None else np.nan
            seen.views.append(BoardView(frame, marks, laser, plain, count=count, **of_pose))
    _one_layout(seen)


def on_board(xy: Floats, rotation: Floats, shift: Floats) -> Floats:
    """Give (ray, 2) where rays through (ray, 2) places at distance 1 meet the board, mm on the board."""
    ray = np.column_stack([xy, np.ones(len(xy))])
    normal = rotation[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ray * ((normal @ shift) / (ray @ normal))[:, None]
    return np.asarray((at - shift) @ rotation[:, :2])


def on_even_print(peaks: Peaks, plain: Frame, contrast_max: float) -> Flags:
    """Say which peaks lie where the print is even over the stripe's width: at its edges stripes seem shifted.

    Judged by the image with the laser off, along the row.
    """
    columns = plain.size[1]
    half = int(np.clip(np.ceil(0.6 * np.nanmedian(peaks.width_px)), 1, 25)) if len(peaks) else 1
    # half the stripe's width, and a little more, to either side
    at = np.clip(np.rint(peaks.x_px).astype(np.int64)[:, None] + np.arange(-half, half + 1), 0, columns - 1)
    around = plain.pixels[peaks.row[:, None], at].astype(np.float64)
    low, high = around.min(axis=1), around.max(axis=1)
    # Michelson's contrast, and what noise makes of dark print
    return np.asarray((high - low) <= contrast_max * (high + low) + _UNEVEN_NOISE * plain.white)


def _marks(images: list[Observation], board: Board, seen: Seen) -> tuple[str, BoardMarks] | None:
    for image in images:
        try:
            return image.frame.name, find_marks(image.frame, board)
        except BoardNotFoundError as error:
            seen.left_out[image.frame.name] = str(error)
    return None


_SAME_POSE_PX = 1.0
"""Marks of one pose that are nearer than this in its two images are at the same place: a stripe over a mark
moves it by some tenths of a pixel, and a hand that holds a board by several."""


def _elsewhere(plain: Observation, laser: Observation, board: Board, marks: BoardMarks) -> BoardMarks | None:
    """Give the marks in a pose's laser image where the board is not where its laser-off image shows it."""
    if plain_is_under(plain.frame, laser.frame, marks):
        return None  # and the search of a board that stripes cross, which takes longest, is not needed
    try:
        found = find_marks(laser.frame, board)
    except BoardNotFoundError:
        return None
    return found if _apart_px(marks, found) > _SAME_POSE_PX else None


def plain_is_under(plain: Frame, laser: Frame, marks: BoardMarks) -> bool:
    """Say whether nothing on the board is darker with the laser on than with it off.

    A laser only adds light. A board that has moved by 1 px is darker along half of its print's edges: on
    edge/spacing of its pixels, by up to its contrast over the edges' width.
    """
    half = 0.5 * marks.spacing_px
    low = np.maximum(np.floor(marks.xy_px.min(axis=0) - half), 0.0).astype(np.int64)
    high = np.ceil(marks.xy_px.max(axis=0) + half).astype(np.int64) + 1
    there = (slice(low[1], high[1]), slice(low[0], high[0]))
    off, on = plain.pixels[there].astype(np.float32), laser.pixels[there].astype(np.float32)
    dark, light = np.percentile(off, [10, 90])
    darker = (off - on > 0.5 * (light - dark) / max(marks.edge_px, 1.0)).mean()
    return bool(darker < 0.1 / marks.spacing_px)


def _apart_px(one: BoardMarks, other: BoardMarks) -> float:
    """Give the median distance of marks that both images show, px; NaN where there are none."""
    at = {tuple(place): px for place, px in zip(np.round(other.board_mm, 3), other.xy_px, strict=True)}
    places = [tuple(place) for place in np.round(one.board_mm, 3)]
    off = [np.hypot(*(px - at[key])) for key, px in zip(places, one.xy_px, strict=True) if key in at]
    return float(np.median(off)) if off else float("nan")


def _lit(plain: Observation, laser: Observation) -> str:
    """Say what is wrong with a pair: the laser is on in neither, or in the one that should be without."""
    step = _LIT_GREY * laser.frame.white
    difference = laser.frame.pixels.astype(np.float32) - plain.frame.pixels
    brighter = float((difference > step).mean())
    darker = float((difference < -step).mean())
    if darker > _OTHER_LIGHT_SHARE:
        return ""  # taken in plain light: the pair cannot be compared
    if darker > 4.0 * brighter and darker > _LIT_SHARE_MIN:
        return (
            f"it is darker than {plain.frame.name}: are the images with the laser on and off exchanged? Name "
            "each where it belongs"
        )
    if brighter < _LIT_SHARE_MIN:
        return (
            f"no stripe is seen beside {plain.frame.name}: is it an image with the laser off? Take the pose "
            "again"
        )
    return ""


def _one_layout(seen: Seen) -> None:
    """Leave out images in which another ChArUco layout fits than in most."""
    layouts: dict[int, list[str]] = {}
    for view in seen.views:
        layouts.setdefault(view.number, []).append(view.marks.layout)
    most = {number: max(set(found), key=found.count) for number, found in layouts.items()}
    for view in (one for one in seen.views if one.marks.layout != most[one.number]):
        own, usual = view.marks.layout, most[view.number]
        seen.left_out[view.name] = f"its layout is the {own} one, that of most is {usual}"
    seen.views = [view for view in seen.views if view.marks.layout == most[view.number]]
