"""How records show themselves: one line in a console, a table or a picture in a notebook.

A record may hold megabytes of arrays, and records hold records. So an array is shown by type and shape, a
record within a record by its name, and a line ends after `_LINE_MAX` characters.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

_LINE_MAX = 200
"""Characters of a record's line."""
_TEXT_MAX = 60
"""Characters of a text within it."""
_CELLS_MAX = 24
"""Points along each side of a picture of a surface."""
_DOT_ROWS = 2
"""Every second row's peaks are drawn: at one dot a row, neighbouring dots hide the stripe."""


class Shown:
    """A record that shows itself: short in a console, as a table in a notebook."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Give one line: the fields' values, arrays by type and shape."""
        inside = ", ".join(f"{name}={value}" for name, value in short_fields(self))
        line = f"{type(self).__name__}({inside})"
        return line if len(line) <= _LINE_MAX else line[: _LINE_MAX - 2] + "…)"

    def _repr_html_(self) -> str:
        """Give the fields as a table, for notebooks."""
        return table(type(self).__name__, short_fields(self))


def short_fields(record: Any) -> list[tuple[str, str]]:
    """Give the names of a record's fields, and short texts of what they hold."""
    return [(one.name, short(getattr(record, one.name))) for one in fields(record) if one.repr]


def short(value: Any) -> str:
    """Give a short text of a value: arrays by type and shape, records by name, many things by number."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape}"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str):
        return repr(value if len(value) <= _TEXT_MAX else value[:_TEXT_MAX] + "…")
    if isinstance(value, Mapping):
        return f"{{{', '.join(map(str, value))}}}" if len(value) <= 4 else f"{{{len(value)} entries}}"
    if isinstance(value, tuple | list):
        if any(is_dataclass(one) or len(value) > 6 for one in value):
            return f"({len(value)} × {type(value[0]).__name__})"
        return f"({', '.join(short(one) for one in value)})"
    if is_dataclass(value) and not isinstance(value, type):
        if hasattr(value, "value") and hasattr(value, "std"):
            return estimate(value)
        return f"{type(value).__name__}(…)"
    return str(value)


def estimate(found: Any, unit: str = "", scale: float = 1.0) -> str:
    """Give an `Estimate` in words: value ± standard uncertainty, as far as they are stated."""
    if found is None or math.isnan(found.value):
        return "not stated"
    plus = "" if math.isnan(found.std) else f" ± {scale * found.std:.2g}"
    return f"{scale * found.value:.5g}{plus}{' ' + unit if unit else ''}"


def table(title: str, rows: Iterable[tuple[str, str]], picture: str = "") -> str:
    """Give an HTML table of names and texts under a title; `picture` stands above it."""
    lines = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
        f"<td style='text-align:left'>{html.escape(text)}</td></tr>"
        for name, text in rows
    )
    return f"<div><strong>{html.escape(title)}</strong>{picture}<table>{lines}</table></div>"


def picture_of_surface(xyz_mm: Any) -> str:
    """Give a surface over the belt, seen from the front and above, as an HTML element.

    Parameters
    ----------
    xyz_mm : ndarray, shape (station, point, 3)
        As `Surface.xyz_mm`; cells with NaN are left out.
    """
    xyz = thinned(xyz_mm)
    right, up = np.array([0.88, -0.47, 0.0]), np.array([0.26, 0.49, 0.83])
    near = np.cross(right, up)
    cells = [
        np.array([xyz[i, k], xyz[i, k + 1], xyz[i + 1, k + 1], xyz[i + 1, k]])
        for i in range(xyz.shape[0] - 1)
        for k in range(xyz.shape[1] - 1)
    ]
    cells = sorted((cell for cell in cells if np.isfinite(cell).all()), key=lambda cell: (cell @ near).sum())
    if not cells:
        return ""
    flat = np.array([np.column_stack([cell @ right, -(cell @ up)]) for cell in cells])
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    tops = np.array([cell[:, 2].mean() for cell in cells]) / max(float(np.nanmax(xyz[..., 2])), 1e-9)
    shapes = "".join(
        f"<path d='M{'L'.join(f'{x:.1f} {y:.1f}' for x, y in shape.tolist())}Z' "
        f"fill='hsl({215 - 160 * top:.0f} 45% {30 + 45 * top:.0f}%)' stroke='#0003' stroke-width='.15'/>"
        for shape, top in zip(flat, tops.clip(0.0, 1.0), strict=True)
    )
    box = " ".join(f"{value:.1f}" for value in (*low, *(high - low)))
    return f"<br><svg role='img' aria-label='surface' width='420' viewBox='{box}'>{shapes}</svg>"


def thinned(xyz_mm: Any) -> Any:
    """Leave of points, mm, (slice, point, 3), what a small picture needs: few, and of where there are any."""
    seen = np.isfinite(xyz_mm).all(axis=2)
    chosen = []
    for axis in (1, 0):
        some = np.flatnonzero(seen.any(axis=axis))
        first, last = (int(some[0]), int(some[-1])) if some.size else (0, -1)
        count = min(last - first + 1, _CELLS_MAX)
        chosen.append(np.unique(np.linspace(first, last, count).astype(int)))
    return xyz_mm[np.ix_(*chosen)]


def picture_of_stripes(pixels: Any, row: Any, x_px: Any, stripe: Any) -> str:
    """Give an image with its peaks in the colours of their stripes, as an HTML element.

    Parameters
    ----------
    pixels : ndarray of uint8 or uint16, shape (rows, columns)
        The frame that was searched.
    row, x_px, stripe : ndarray, shape (peak,)
        Image row, column in px, and stripe of each peak; negative stripes (none, several) are white.
    """
    import cv2

    grey = np.asarray(pixels, np.float64)
    lifted = (255.0 * np.sqrt(grey / max(float(grey.max()), 1.0))).astype(np.uint8)
    colour = cv2.cvtColor(lifted, cv2.COLOR_GRAY2BGR)
    hues = np.array([[[45 * one, 255, 255] for one in range(4)]], np.uint8)
    palette = cv2.cvtColor(hues, cv2.COLOR_HSV2BGR)[0]
    drawn = np.asarray(row) % _DOT_ROWS == 0
    at = np.clip(np.rint(np.asarray(x_px)[drawn]).astype(int), 0, colour.shape[1] - 1)
    of = np.asarray(stripe)[drawn]
    colour[np.asarray(row)[drawn], at] = np.where((of < 0)[:, None], 255, palette[of % 4])
    data = base64.b64encode(cv2.imencode(".png", colour)[1].tobytes()).decode()
    return f"<br><img alt='stripes found' src='data:image/png;base64,{data}'>"
