"""The few SVG elements that the plots are made of."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from markupsafe import Markup

WIDTH = 440.0
"""Width of a plot's view: about as wide as it is shown, so that letters keep their size."""


def picture(body: Iterable[Markup], height: float, label: str, width: float = WIDTH) -> Markup:
    """Make an inline SVG element; `label` says what it shows to those who cannot see it."""
    return Markup('<svg class="plot" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
        number(width), number(height), label, Markup("").join(body)
    )


def text(x: float, y: float, words: str, kind: str = "") -> Markup:
    """Make a text element; `words` are escaped."""
    return Markup('<text class="{}" x="{}" y="{}">{}</text>').format(kind, number(x), number(y), words)


def line(x0: float, y0: float, x1: float, y1: float, kind: str) -> Markup:
    """Make a straight line."""
    ends = (number(value) for value in (x0, y0, x1, y1))
    return Markup('<path class="{}" d="M{} {}L{} {}"/>').format(kind, *ends)


def box(
    x: float, y: float, width: float, height: float, kind: str, title: str = "", fill: str = ""
) -> Markup:
    """Make a rectangle, with words that show when it is pointed at."""
    named = Markup("<title>{}</title>").format(title) if title else Markup("")
    colour = Markup(' fill="{}"').format(fill) if fill else Markup("")
    return Markup('<rect class="{}"{} x="{}" y="{}" width="{}" height="{}">{}</rect>').format(
        kind, colour, number(x), number(y), number(max(width, 0.0)), number(height), named
    )


def dot(x: float, y: float, kind: str, title: str, fill: str, radius: float = 2.6) -> Markup:
    """Make a dot, with words that show when it is pointed at."""
    return Markup('<circle class="{}" fill="{}" cx="{}" cy="{}" r="{}"><title>{}</title></circle>').format(
        kind, fill, number(x), number(y), number(radius), title
    )


def shape(points: Sequence[tuple[float, float]], kind: str, fill: str = "", title: str = "") -> Markup:
    """Make a closed shape."""
    path = "M" + "L".join(f"{number(x)} {number(y)}" for x, y in points) + "Z"
    colour = Markup(' fill="{}"').format(fill) if fill else Markup("")
    named = Markup("<title>{}</title>").format(title) if title else Markup("")
    return Markup('<path class="{}"{} d="{}">{}</path>').format(kind, colour, path, named)


def number(value: float) -> str:
    """Write a number as short as SVG allows, rounded to 0.01."""
    return f"{value:.2f}".rstrip("0").rstrip(".") if abs(value) >= 0.005 else "0"


@dataclass(frozen=True, slots=True)
class Axis:
    """A straight scale from values to places, with round ticks."""

    low: float
    high: float
    start: float
    end: float

    @classmethod
    def over(cls, low: float, high: float, start: float, end: float) -> Axis:
        """Make a scale that holds low and high, with a little room."""
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
