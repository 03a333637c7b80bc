"""A flat board as a page to print at true scale: its pattern, a ruler to check the printer, SVG or PDF.

Shapes are in millimetres, x to the right and y down from the page's top-left corner, before anybody decides
on a file format. ChArUco markers stand where OpenCV puts them.

`make_target` goes from a target's description to the file that is printed or milled.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Literal

import numpy as np

from roemetry.config.target_file import BoardFile, TargetFile, read_target
from roemetry.errors import ConfigurationError
from roemetry.io.files import make_folder, write_bytes, write_whole
from roemetry.targets.solids import solid_triangles, stl_of


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A black rectangle; x, y is its top-left corner, mm."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float


@dataclass(frozen=True, slots=True)
class Disc:
    """A black disc; x, y is its centre, mm."""

    x_mm: float
    y_mm: float
    radius_mm: float


@dataclass(frozen=True, slots=True)
class Words:
    """A line of text; x, y is the left end of its base line, mm."""

    x_mm: float
    y_mm: float
    size_mm: float
    text: str


Shape = Rectangle | Disc | Words


@dataclass(frozen=True, slots=True)
class Sheet:
    """One page: its size, and what is black on it; x to the right, y down, from the top-left corner."""

    title: str
    width_mm: float
    height_mm: float
    shapes: tuple[Shape, ...]


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


PAGES_MM = {
    "a4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
"""Upright page sizes; the smallest ISO one that holds the board is the default."""

_MARGIN_MM = 12.0  # that any printer leaves
_FOOT_MM = 24.0  # room for ruler and description
_RULER_MAX_MM = 200.0  # long enough to measure the print to 0.1 % with a steel rule


def lay_out(board: BoardFile, identity: str, page: str | None) -> Sheet:
    """Put a board on a page.

    Parameters
    ----------
    board
        What to draw.
    identity
        Short hash of the description; it is printed, so that a sheet can be told from another version's.
    page
        Name of a page size; None takes the smallest ISO size that holds the board.

    Raises
    ------
    ConfigurationError
        There is no such page, or the board does not fit on it.
    """
    width_mm, height_mm = board_size_mm(board)
    page_width, page_height = _page(board, page)
    left, top = (page_width - width_mm) / 2.0, (page_height - _FOOT_MM - height_mm) / 2.0
    shapes = [_moved(shape, left, top) for shape in board_shapes(board)]
    foot = page_height - _FOOT_MM
    shapes += _ruler(_MARGIN_MM, foot + 2.0, min(_RULER_MAX_MM, page_width - 2 * _MARGIN_MM))
    shapes += [
        Words(_MARGIN_MM, foot + 14.0, 3.0, _described(board, identity)),
        Words(
            _MARGIN_MM,
            foot + 18.5,
            3.0,
            "Print at 100 %, without fitting to the page. Measure the board, and correct the target's file.",
        ),
    ]
    return Sheet(board.name, page_width, page_height, tuple(shapes))


def _page(board: BoardFile, page: str | None) -> tuple[float, float]:
    """Give the page's width and height, lying or upright as the board wants it."""
    width_mm, height_mm = board_size_mm(board)
    needed = width_mm + 2 * _MARGIN_MM, height_mm + _MARGIN_MM + _FOOT_MM
    if page is not None and page not in PAGES_MM:
        raise ConfigurationError(f"there is no page size `{page}`", hint=f"there are {', '.join(PAGES_MM)}")
    names = [name for name in PAGES_MM if name != "letter"] if page is None else [page]
    for name in names:
        for size in (PAGES_MM[name], PAGES_MM[name][::-1]):
            if needed[0] <= size[0] and needed[1] <= size[1]:
                return size
    raise ConfigurationError(
        f"`{board.name}` needs a page of {needed[0]:.0f} mm × {needed[1]:.0f} mm with its margins, "
        f"{names[-1]} is {PAGES_MM[names[-1]][0]:g} mm × {PAGES_MM[names[-1]][1]:g} mm",
        hint="a larger --page, or a smaller pitch_mm",
    )


def _moved(shape: Shape, right_mm: float, down_mm: float) -> Shape:
    x, y = shape.x_mm + right_mm, shape.y_mm + down_mm
    match shape:
        case Rectangle():
            return Rectangle(x, y, shape.width_mm, shape.height_mm)
        case Disc():
            return Disc(x, y, shape.radius_mm)
        case Words():
            return Words(x, y, shape.size_mm, shape.text)


def _ruler(x: float, y: float, length_mm: float) -> Iterator[Shape]:
    """A ruler with a tick each millimetre; the ticks' left edges are the marks."""
    length = int(length_mm // 10) * 10
    yield Rectangle(x, y, length + 0.2, 0.2)
    for mark in range(length + 1):
        tall = 5.0 if mark % 10 == 0 else 3.5 if mark % 5 == 0 else 2.0
        yield Rectangle(x + mark, y, 0.2, tall)
        if mark % 10 == 0:
            yield Words(x + mark + 0.6, y + 5.0, 2.2, str(mark) if mark else "0 mm")


def _described(board: BoardFile, identity: str) -> str:
    size = f"{board.columns} × {board.rows}, pitch {board.pitch_mm:g} mm"
    if board.kind == "charuco":
        layout = "old" if board.layout == "old" else "new"
        size += f", marker {board.marker_mm:g} mm, {board.dictionary}, {layout} layout"
    return f"{board.name}: {board.kind} {size}. id {identity}"


_MM_PER_POINT = 25.4 / 72.0


def svg_of(sheet: Sheet) -> str:
    """Write a sheet as SVG; one unit is one millimetre."""
    size = f'width="{sheet.width_mm:g}mm" height="{sheet.height_mm:g}mm"'
    view = f'viewBox="0 0 {sheet.width_mm:g} {sheet.height_mm:g}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {view}>',
        f"<title>{escape(sheet.title)}</title>",
        '<rect width="100%" height="100%" fill="white"/>',
        '<g fill="black" shape-rendering="geometricPrecision" font-family="Helvetica, Arial, sans-serif">',
    ]
    for shape in sheet.shapes:
        x, y = f"{shape.x_mm:.6g}", f"{shape.y_mm:.6g}"
        match shape:
            case Rectangle():
                side = f'width="{shape.width_mm:.6g}" height="{shape.height_mm:.6g}"'
                parts.append(f'<rect x="{x}" y="{y}" {side}/>')
            case Disc():
                parts.append(f'<circle cx="{x}" cy="{y}" r="{shape.radius_mm:.6g}"/>')
            case Words():
                parts.append(
                    f'<text x="{x}" y="{y}" font-size="{shape.size_mm:g}">{escape(shape.text)}</text>'
                )
    return "\n".join([*parts, "</g>", "</svg>", ""])


def pdf_of(sheet: Sheet) -> bytes:
    """Write a sheet as PDF; raise ConfigurationError where reportlab is not installed."""
    try:
        from reportlab.pdfgen.canvas import Canvas
    except ImportError as error:
        raise ConfigurationError(
            "PDF needs reportlab, which is not installed",
            hint='pip install "roemetry[targets]", or take --format svg',
        ) from error
    file = io.BytesIO()
    size = sheet.width_mm / _MM_PER_POINT, sheet.height_mm / _MM_PER_POINT
    # invariant: no date and no random id in the file, so that the same target gives the same bytes.
    canvas = Canvas(file, pagesize=size, invariant=1)
    canvas.setTitle(sheet.title)
    canvas.setViewerPreference("PrintScaling", "None")
    canvas.scale(1.0 / _MM_PER_POINT, 1.0 / _MM_PER_POINT)
    for shape in sheet.shapes:
        up = sheet.height_mm - shape.y_mm
        match shape:
            case Rectangle():
                width, height = shape.width_mm, shape.height_mm
                canvas.rect(shape.x_mm, up - height, width, height, stroke=0, fill=1)
            case Disc():
                canvas.circle(shape.x_mm, up, shape.radius_mm, stroke=0, fill=1)
            case Words():
                canvas.setFont("Helvetica", shape.size_mm)
                canvas.drawString(shape.x_mm, up, shape.text)
    canvas.showPage()
    canvas.save()
    return file.getvalue()


SheetFormat = Literal["svg", "pdf"]


@dataclass(frozen=True, slots=True)
class Made:
    """What was made of a target."""

    target: TargetFile
    """Its description."""
    identity: str
    """Short hash of it, as printed on a sheet."""
    file: Path
    """The sheet, or the solid."""
    size_mm: tuple[float, ...]
    """Of the page, or of the solid's box."""


def make_target(
    path: Path, folder: Path, *, sheet_format: SheetFormat = "svg", page: str | None = None
) -> Made:
    """Write a flat board as a sheet at true scale, a solid one as STL.

    Parameters
    ----------
    path
        The description.
    folder
        Where to write; created if needed.
    sheet_format
        Of a flat board.
    page
        Page size of a flat board; None takes the smallest ISO size that holds it.

    Raises
    ------
    ConfigurationError
        The description is at fault, or what was asked for does not go with it.
    OutputError
        The folder cannot be written.
    """
    target = read_target(path)
    identity = hashlib.sha256(json.dumps(target.model_dump(), sort_keys=True).encode()).hexdigest()[:8]
    make_folder(folder)
    if isinstance(target, BoardFile):
        sheet = lay_out(target, identity, page)
        file = folder / f"{target.name}.{sheet_format}"
        if sheet_format == "pdf":
            write_bytes(file, pdf_of(sheet))
        else:
            write_whole(file, svg_of(sheet))
        return Made(target, identity, file, (sheet.width_mm, sheet.height_mm))
    if page is not None:
        raise ConfigurationError(f"`{target.name}` is a solid: it has no page", hint="leave --page out")
    triangles = solid_triangles(target)
    file = folder / f"{target.name}.stl"
    write_bytes(file, stl_of(triangles, target.name))
    size = triangles.max(axis=(0, 1)) - triangles.min(axis=(0, 1))
    return Made(target, identity, file, tuple(float(side) for side in size))
