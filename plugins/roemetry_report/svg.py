"""Short path data for SVG pictures in image coordinates."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from markupsafe import Markup

from roemetry.records.arrays import Floats

Box = tuple[float, float, float, float]
"""x, y, width and height of a view."""


def picture(body: Iterable[Markup], *, box: Box, label: str, kind: str, stretch: bool = False) -> Markup:
    """Make an inline SVG element.

    Parameters
    ----------
    body
        Elements, already marked up.
    box
        x, y, width, height of the view. For an image of W × H pixels it is (−0.5, −0.5, W, H), so that
        pixel centres are whole numbers.
    label
        What the picture shows, for those who cannot see it.
    kind
        CSS class.
    stretch
        Fill whatever room there is, whatever its shape.
    """
    view = " ".join(number(value) for value in box)
    ratio = Markup(' preserveAspectRatio="none"') if stretch else ""
    return Markup('<svg class="{}" viewBox="{}"{} role="img" aria-label="{}">{}</svg>').format(
        kind, view, ratio, label, Markup("").join(body)
    )


def text(x: float, y: float, words: str, kind: str) -> Markup:
    """Make a text element of a CSS class; `words` are escaped."""
    return Markup('<text class="{}" x="{}" y="{}">{}</text>').format(kind, number(x), number(y), words)


def line(x: Floats, y: Floats) -> str:
    """Path data of an open line through points, rounded to 0.01; a single point becomes a dot."""
    if len(x) == 1:
        return dots(x, y)
    return _chain(x, y, "")


def dots(x: Floats, y: Floats) -> str:
    """Path data of a dot at each point (lines of no length: stroke them with round caps)."""
    return _chain(x, y, "h0")


def crosses(x: Floats, y: Floats, arm: float) -> str:
    """Path data of an upright cross about each point."""
    two, mid = number(2 * arm), number(-arm)
    return _shapes(x, y, f"m{mid} 0h{two}m{mid} {mid}v{two}")


def diamonds(x: Floats, y: Floats, arm: float) -> str:
    """Path data of a closed diamond about each point."""
    a, m = number(arm), number(-arm)
    return _shapes(x, y, f"m{m} 0l{a} {m} {a} {a} {m} {a}z")


def number(value: float) -> str:
    """Write a number as short as SVG allows, rounded to 0.01."""
    return _hundredths(round(value * 100))


@lru_cache(maxsize=16384)
def _hundredths(value: int) -> str:
    whole, part = divmod(abs(value), 100)
    text = str(whole) if part == 0 else f"{whole or ''}.{part:02d}".rstrip("0")
    return f"-{text}" if value < 0 else text


def _chain(x: Floats, y: Floats, after: str) -> str:
    """Points one after the other, each relative to the one before; hundredths add up without rounding."""
    if len(x) == 0:
        return ""
    points = np.rint(np.column_stack([x, y]) * 100.0).astype(np.int64)
    steps = np.diff(points, axis=0).tolist()
    start = f"M{_hundredths(int(points[0, 0]))} {_hundredths(int(points[0, 1]))}{after}"
    if after:
        rest = "".join(f"m{_hundredths(dx)} {_hundredths(dy)}{after}" for dx, dy in steps)
    else:
        rest = "l" + " ".join(f"{_hundredths(dx)} {_hundredths(dy)}" for dx, dy in steps)
    return (start + rest).replace(" -", "-")


def _shapes(x: Floats, y: Floats, shape: str) -> str:
    """Draw a shape about each point, beginning with a move to the point itself."""
    return "".join(f"M{number(float(u))} {number(float(v))}{shape}" for u, v in zip(x, y, strict=True))
