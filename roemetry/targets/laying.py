"""A board on a page: in the middle, with a ruler to check the printer and words that say what it is."""

from __future__ import annotations

from collections.abc import Iterator

from roemetry.config.target_file import BoardFile
from roemetry.errors import ConfigurationError
from roemetry.targets.boards import board_shapes, board_size_mm
from roemetry.targets.sheet import Disc, Rectangle, Shape, Sheet, Words

PAGES_MM = {
    "a4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
"""Upright page sizes; the smallest ISO one that holds the board is the default."""

_MARGIN_MM = 12.0
_FOOT_MM = 24.0
_RULER_MAX_MM = 200.0


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
