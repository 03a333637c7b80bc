"""A long run at a glance: how quantities are distributed and move, what stands out, why rows failed.

Of each row a few numbers are kept, so a million rows take a hundred megabytes; of the page they take nothing.
"""

from __future__ import annotations

import heapq
import math
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry.html.plots import Axis, plain
from roemetry.records import Measurement
from roemetry.records.arrays import Floats
from roemetry.records.units import MM3_PER_CM3
from roemetry_report.words import counted

SHOWN_FROM = 100
"""Rows from which a run is long: fewer are seen in the table."""
_BINS = 40  # of a histogram
_PARTS = 120
"""Parts of a run, one after another, whose medians a trend shows."""
_STANDING_OUT = 3
"""Products named at either end of a distribution."""
_FAR = 4.5
"""Robust standard deviations from the median beyond which a product stands out: of normal ones 7 in 10⁶."""
_MAD_TO_STD = 1.4826  # of a normal distribution
_HEIGHT, _LEFT, _FLOOR = 176.0, 52.0, 140.0  # of a drawing, px: all of it, its axis, its base line


@dataclass(frozen=True, slots=True)
class Quantity:
    """What is drawn of one quantity."""

    name: str
    unit: str
    words: str
    histogram: Markup
    trend: Markup
    outliers: tuple[tuple[str, str], ...]
    """Id and value of products that stand out, the farthest first."""
    outlier_count: int


@dataclass(frozen=True, slots=True)
class Cause:
    """A reason that rows carry."""

    code: str
    text: str
    """As the first row says it."""
    rows: int
    failed: int
    """Of these rows, those that failed for it."""
    example: str
    """Id of the first row."""


class Distributions:
    """Takes rows one by one; `kinds_of` a row are what it can be an example of."""

    def __init__(self) -> None:
        self._values = {name: array("d") for name in _QUANTITIES}
        self._ends: dict[tuple[str, int], list[tuple[float, int, str]]] = {}
        self._rows: Counter[str] = Counter()
        self._failed: Counter[str] = Counter()
        self._first: dict[str, tuple[str, str]] = {}

    def add(self, row: Measurement) -> None:
        """Take a row."""
        for name, (_, read) in _QUANTITIES.items():
            value = read(row) if row.status == "measured" else math.nan
            values = self._values[name]
            values.append(value)
            if math.isfinite(value):
                for sign in (1, -1):
                    ends = self._ends.setdefault((name, sign), [])
                    one = (sign * value, -len(values), row.id)
                    if len(ends) < _STANDING_OUT:
                        heapq.heappush(ends, one)
                    elif one > ends[0]:
                        heapq.heapreplace(ends, one)
        reasons = row.all_reasons
        for code in dict.fromkeys(reason.code for reason in reasons):
            self._rows[code] += 1
        for reason in reasons:
            self._first.setdefault(reason.code, (reason.text, row.id))
        if row.status == "failed" and reasons:
            self._failed[reasons[0].code] += 1

    def quantities(self) -> tuple[Quantity, ...]:
        """Draw each quantity of which there are values that differ."""
        drawn = (self._quantity(name, np.array(values)) for name, values in self._values.items())
        return tuple(one for one in drawn if one is not None)

    def causes(self) -> tuple[Cause, ...]:
        """Give the reasons, those for which most rows failed first."""
        found = [Cause(code, *self._told(code), example=self._first[code][1]) for code in self._rows]
        return tuple(sorted(found, key=lambda cause: (-cause.failed, -cause.rows, cause.code)))

    def _told(self, code: str) -> tuple[str, int, int]:
        return self._first[code][0], self._rows[code], self._failed[code]

    def _quantity(self, name: str, values: Floats) -> Quantity | None:
        known = values[np.isfinite(values)]
        if len(known) < SHOWN_FROM // 2 or np.ptp(known) == 0.0:
            return None
        unit = _QUANTITIES[name][0]
        low, lower, middle, upper, high = np.quantile(known, (0.001, 0.05, 0.5, 0.95, 0.999))
        std = _MAD_TO_STD * float(np.median(np.abs(known - middle)))
        far = _FAR * std if std > 0.0 else math.inf
        ends = [(sign * value, row) for sign in (1, -1) for value, _, row in self._ends[name, sign]]
        named = sorted(
            {one for one in ends if abs(one[0] - middle) > far}, key=lambda one: -abs(one[0] - middle)
        )
        return Quantity(
            name=name,
            unit=unit,
            words=f"median {_told(middle)}, 5 to 95 %: {_told(lower)} to {_told(upper)} {unit}; "
            f"{counted(len(known), 'product')}",
            histogram=_histogram(known, float(low), float(high), name, unit),
            trend=_trend(values, name),
            outliers=tuple((row, _told(value)) for value, row in named),
            outlier_count=int(np.count_nonzero(np.abs(known - middle) > far)),
        )


def kinds_of(row: Measurement) -> tuple[str, ...]:
    """Give what a row is an example of: its verdicts, and what is said of it."""
    if row.status == "failed":
        return tuple(f"failed: {reason.code}" for reason in row.all_reasons[:1]) or ("failed",)
    if row.status == "empty":
        return ("empty",)
    kinds = [] if row.grade is None else [f"grade {row.grade.label}"]
    kinds += [] if row.decision is None else [f"decision {row.decision.label}"]
    return (*kinds, *dict.fromkeys(f"reason {reason.code}" for reason in row.all_reasons))


def _volume(row: Measurement) -> float:
    if row.volume is None:
        return math.nan
    found = row.volume.true_mm3 or row.volume.visible_mm3
    return found.value / MM3_PER_CM3


_QUANTITIES: Mapping[str, tuple[str, Callable[[Measurement], float]]] = {
    "volume": ("cm³", _volume),
    "weight": ("g", lambda row: math.nan if row.weight is None else row.weight.mass_g.value),
    "largest height": ("mm", lambda row: row.height_max_mm.value),
    "volume seen": ("%", lambda row: math.nan if row.volume is None else 100.0 * row.volume.shares.seen),
    "largest displacement": (
        "px",
        lambda row: math.nan if row.coding is None else abs(row.coding.displacement_max_px),
    ),
    "ambiguous peaks": ("", lambda row: math.nan if row.coding is None else float(row.coding.ambiguous)),
}


def _told(value: float) -> str:
    return plain(value, max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0)


def _histogram(known: Floats, low: float, high: float, name: str, unit: str) -> Markup:
    """Draw how many products lie where; what lies beyond the ends stands in the last bars."""
    across = Axis.over(low, high, _LEFT, svg.WIDTH - 8.0)
    counts, edges = np.histogram(np.clip(known, across.low, across.high), _BINS, (across.low, across.high))
    up = Axis(0.0, float(counts.max()), _FLOOR, 12.0)
    body = [*up.level(_LEFT, svg.WIDTH - 8.0, 3), *across.upright(12.0, _FLOOR, f"{name} {unit}".strip())]
    for count, begin, end in zip(counts.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        left, right, top = across(begin), across(end), up(count)
        if count:
            title = f"{_told(begin)} to {_told(end)} {unit}: {counted(count, 'product')}"
            body.append(svg.box(left + 0.5, top, right - left - 1.0, _FLOOR - top, "bar", title, "#2f6f9f"))
    return svg.picture(body, _HEIGHT, f"Histogram of {name}")


def _trend(values: Floats, name: str) -> Markup:
    """Draw the median and the middle 90 % of each part of the run, in its order."""
    parts = [part[np.isfinite(part)] for part in np.array_split(values, min(_PARTS, len(values) // 10))]
    width = len(values) / len(parts)
    told = [((n + 0.5) * width, np.quantile(p, (0.05, 0.5, 0.95))) for n, p in enumerate(parts) if len(p)]
    x, bands = np.array([at for at, _ in told]), np.array([band for _, band in told])
    across = Axis.over(0.0, float(len(values)), _LEFT, svg.WIDTH - 8.0)
    up = Axis.over(float(bands.min()), float(bands.max()), _FLOOR, 12.0)
    at = [across(one) for one in x.tolist()]
    lower, middle, upper = (np.array([up(one) for one in ends]) for ends in bands.T.tolist())
    around = [*zip(at, lower.tolist(), strict=True), *zip(at[::-1], upper[::-1].tolist(), strict=True)]
    body = [
        *up.level(_LEFT, svg.WIDTH - 8.0, 4),
        *across.upright(12.0, _FLOOR, "row of the run"),
        svg.shape(around, "", "#2f6f9f33"),
        svg.path("", svg.polyline(np.array(at), middle), fill="none", stroke="#174a70"),
    ]
    return svg.picture(
        body, _HEIGHT, f"Trend of {name}: median and middle 90 % of {len(parts)} parts of the run"
    )
