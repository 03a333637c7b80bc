"""SVG as text: the elements, path data and axes that every picture is made of; numbers and dates in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

Floats = NDArray[np.float64]

WIDTH = 440.0
"""Width of a plot's view: about as wide as it is shown, so that letters keep their size."""

Box = tuple[float, float, float, float]
"""x, y, width and height of a view."""


def view(body: Iterable[Markup], box: Box, label: str, kind: str, *, stretch: bool = False) -> Markup:
    """Make an inline SVG element of a CSS class.

    Parameters
    ----------
    body
        Elements, already marked up.
    box
        For an image of W × H pixels (−0.5, −0.5, W, H): pixel centres are then whole numbers.
    label
        What the picture shows, for those who cannot see it.
    kind
        CSS class.
    stretch
        Fill whatever room there is, whatever its shape.
    """
    ratio = Markup(' preserveAspectRatio="none"') if stretch else ""
    return Markup('<svg class="{}" viewBox="{}"{} role="img" aria-label="{}">{}</svg>').format(
        kind, " ".join(map(number, box)), ratio, label, Markup("").join(body)
    )


def picture(body: Iterable[Markup], height: float, label: str, width: float = WIDTH) -> Markup:
    """Make a plot: a view from 0 to its width and height."""
    return view(body, (0.0, 0.0, width, height), label, "plot")


def text(x: float, y: float, words: str, kind: str = "", size: float = 0.0, fill: str = "") -> Markup:
    """Make a text element; `words` are escaped. Size and fill are the class's where they are not given."""
    own = Markup(' font-size="{}"').format(number(size)) if size else Markup("")
    own += Markup(' fill="{}"').format(fill) if fill else Markup("")
    return Markup('<text class="{}" x="{}" y="{}"{}>{}</text>').format(kind, number(x), number(y), own, words)


def path(kind: str, data: str, *, fill: str = "", stroke: str = "", title: str = "") -> Markup:
    """Make a path of path data, with words that show when it is pointed at."""
    return _element("path", kind, f'd="{data}"', fill, stroke, title)


def line(x0: float, y0: float, x1: float, y1: float, kind: str) -> Markup:
    """Make a straight line."""
    return path(kind, f"M{number(x0)} {number(y0)}L{number(x1)} {number(y1)}")


def box(
    x: float, y: float, width: float, height: float, kind: str, title: str = "", fill: str = ""
) -> Markup:
    """Make a rectangle, with words that show when it is pointed at."""
    size = f'width="{number(max(width, 0.0))}" height="{number(max(height, 0.0))}"'
    return _element("rect", kind, f'x="{number(x)}" y="{number(y)}" {size}', fill, "", title)


def image(uri: str, box: Box, name: str = "") -> Markup:
    """Make a picture that fills a box; `name` is its id."""
    x, y, width, height = map(number, box)
    place = Markup(' href="{}" x="{}" y="{}" width="{}" height="{}" preserveAspectRatio="none"/>')
    named = Markup(' id="{}"').format(name) if name else ""
    return Markup("<image{}").format(named) + place.format(uri, x, y, width, height)


def dot(x: float, y: float, kind: str, title: str, fill: str, radius: float = 2.6) -> Markup:
    """Make a dot, with words that show when it is pointed at."""
    place = f'cx="{number(x)}" cy="{number(y)}" r="{number(radius)}"'
    return _element("circle", kind, place, fill, "", title)


def shape(points: Sequence[tuple[float, float]], kind: str, fill: str = "", title: str = "") -> Markup:
    """Make a closed shape."""
    data = "M" + "L".join(f"{number(x)} {number(y)}" for x, y in points) + "Z"
    return path(kind, data, fill=fill, title=title)


def diamond(x: float, y: float, arm: float, kind: str, title: str) -> Markup:
    """Make a diamond about a point."""
    return shape([(x, y - arm), (x + arm, y), (x, y + arm), (x - arm, y)], kind, "", title)


def _element(name: str, kind: str, place: str, fill: str, stroke: str, title: str) -> Markup:
    """Make an element; `place` is of numbers alone, all else is escaped."""
    colours = [
        Markup(' {}="{}"').format(key, value) for key, value in (("fill", fill), ("stroke", stroke)) if value
    ]
    given = (
        name,
        Markup(' class="{}"').format(kind) if kind else "",
        Markup("").join(colours),
        Markup(place),
    )
    if not title:
        return Markup("<{}{}{} {}/>").format(*given)
    return Markup("<{}{}{} {}><title>{}</title></{}>").format(*given, title, name)


def polyline(x: Floats, y: Floats) -> str:
    """Path data of an open line through points, rounded to 0.01; a single point becomes a dot."""
    return dots(x, y) if len(x) == 1 else _chain(x, y, "")


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


def _shapes(x: Floats, y: Floats, outline: str) -> str:
    return "".join(f"M{number(float(u))} {number(float(v))}{outline}" for u, v in zip(x, y, strict=True))


def number(value: float) -> str:
    """Write a number as short as SVG allows, rounded to 0.01."""
    return _hundredths(round(value * 100))


@lru_cache(maxsize=16384)
def _hundredths(value: int) -> str:
    whole, part = divmod(abs(value), 100)
    written = str(whole) if part == 0 else f"{whole or ''}.{part:02d}".rstrip("0")
    return f"-{written}" if value < 0 else written


@dataclass(frozen=True, slots=True)
class Axis:
    """A straight scale from values to places, with round ticks."""

    low: float
    high: float
    start: float
    end: float

    @classmethod
    def over(cls, low: float, high: float, start: float, end: float) -> Axis:
        """Make a scale that holds low and high, with a little room where both are the same."""
        if high - low < 1e-12:
            low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
        return cls(low, high, start, end)

    def __call__(self, value: float) -> float:
        """Give the place of a value; what lies beyond an end is put there."""
        share = (min(max(value, self.low), self.high) - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)

    def ticks(self, count: int = 5) -> list[tuple[float, str]]:
        """Give round values within, each as it is written."""
        raw = (self.high - self.low) / count
        unit = 10.0 ** math.floor(math.log10(raw))
        times = next(m for m in (1, 2, 2.5, 5, 10) if m * unit >= raw * 0.999)
        step = times * unit
        digits = max(0, (times == 2.5) - math.floor(math.log10(step) + 1e-9))
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [(i * step, plain(i * step, digits)) for i in range(first, last + 1)]

    def upright(
        self, top: float, floor: float, words: str = "", count: int = 5, width: float = WIDTH
    ) -> list[Markup]:
        """Draw an axis across: an upright line at each tick, its value below, and what it is of."""
        parts = []
        for value, written in self.ticks(count):
            x = self(value)
            if x > self.start:
                parts.append(line(x, top, x, floor, "zero" if abs(value) < 1e-12 else "grid"))
            # a value about a tick near the picture's edge would leave it
            half = 3.5 * len(written)
            parts.append(text(min(max(x, half), width - half), floor + 14.0, written))
        if words:
            parts.append(text((self.start + self.end) / 2, floor + 30.0, words))
        return parts

    def level(self, left: float, right: float, count: int = 5) -> list[Markup]:
        """Draw an axis upwards: a level line at each tick, its value at the left."""
        parts = []
        for value, written in self.ticks(count):
            parts.append(
                line(left, self(value), right, self(value), "zero" if abs(value) < 1e-12 else "grid")
            )
            parts.append(text(left - 5.0, self(value) + 4.0, written, "end"))
        return parts


def in_words(name: str) -> str:
    """Write a figure's name for people: ``length_mm`` is "length (mm)"."""
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return f"{name.removesuffix(ending).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


_UNITS = {"_per_mm": "1/mm", "_px": "px", "_mm3": "mm³", "_mm2": "mm²", "_mm": "mm", "_g": "g", "_deg": "°"}


def plain(value: float | None, digits: int = 1, sign: bool = False) -> str:
    """Write a number for people; what is not known is a dash."""
    if value is None or not math.isfinite(value):
        return "–"
    written = f"{value:+,.{digits}f}" if sign else f"{value:,.{digits}f}"
    if not any(letter in "123456789" for letter in written):
        written = written.lstrip("+-")
    return written.replace("-", "−").replace(",", "\u202f")


def share(value: float | None, digits: int = 2) -> str:
    """Write a share of 100 %, so that only nothing reads as 0 and only all reads as 100."""
    if value is None or not math.isfinite(value):
        return "–"
    least = 10.0**-digits
    if 0.0 < value < 0.5 * least:
        return f"<{plain(least, digits)}"
    if 100.0 - 0.5 * least < value < 100.0:
        return f">{plain(100.0 - least, digits)}"
    return plain(value, digits)


def when(text: object) -> str:
    """Write an ISO 8601 time for people; anything else stays as it is."""
    if not text:
        return ""
    try:
        moment = datetime.fromisoformat(str(text))
    except ValueError:
        return str(text)
    zone = f" {moment.tzname()}" if moment.tzinfo else ""
    return f"{moment.day} {moment:%B %Y, %H:%M}{zone}"
