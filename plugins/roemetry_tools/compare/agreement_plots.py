"""The plots of agreement: differences over size, and stated probabilities over the share that was right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry_tools.compare.agreement import Agreement, Beside
from roemetry_tools.compare.grading import Reliability
from roemetry_tools.compare.plots import DOTS_MAX, colour

_WIDTH, _FLOOR, _LEFT = 320.0, 196.0, 46.0
_BESIDE, _BAR = (14.0, 8.5, 3.0), 3.5
"""Where, right of the plot, the bars of intervals stand, and how wide; side by side, since they overlap."""

_WRITING = 11.0

Point = tuple[float, float, str]
"""Size, difference in %, and of which product."""


def over_truth(values: Sequence[Beside]) -> list[Point]:
    """Give a point for each product: its true size, and the relative error."""
    return [(v.true, 100.0 * (v.estimate / v.true - 1.0), v.product) for v in values if v.true > 0]


def over_mean(pairs: Sequence[tuple[Beside, Beside]]) -> list[Point]:
    """Give a point for each product: the mean of both estimates, and their difference as a share of it."""
    points = []
    for one, other in pairs:
        mean = 0.5 * (one.estimate + other.estimate)
        if mean > 0:
            points.append((mean, 100.0 * (one.estimate - other.estimate) / mean, one.product))
    return points


def bland_altman(
    number: int,
    name: str,
    points: Sequence[Point],
    agreement: Agreement,
    size_words: str,
    tolerance_pct: float | None,
) -> Markup:
    """Draw differences over size, their mean, limits of agreement, and the tolerance; intervals beside."""
    ends = [*agreement.low_limit_interval_pct, *agreement.high_limit_interval_pct, *agreement.limits_pct, 0.0]
    ends += [p[1] for p in points] + ([] if tolerance_pct is None else [-tolerance_pct, tolerance_pct])
    known = [value for value in ends if np.isfinite(value)]
    room = 0.06 * (max(known) - min(known)) or 1.0
    up = svg.Axis.over(min(known) - room, max(known) + room, _FLOOR, 8.0)
    across = svg.Axis.over(min(p[0] for p in points), max(p[0] for p in points), _LEFT + 8.0, _WIDTH - 70.0)
    right = _WIDTH - 64.0
    parts = []
    if tolerance_pct is not None:
        band = up(-tolerance_pct) - up(tolerance_pct)
        parts.append(svg.box(_LEFT, up(tolerance_pct), right - _LEFT, band, "tolerance", "the tolerance"))
    for value, written in up.ticks(5):
        kind = "zero" if abs(value) < 1e-12 else "grid"
        parts += [
            svg.line(_LEFT, up(value), right, up(value), kind),
            svg.text(_LEFT - 5.0, up(value) + 4.0, written, "end"),
        ]
    for value, written in across.ticks(3):
        parts.append(svg.text(across(value), _FLOOR + 15.0, written))
    paint = colour(number)
    low, high = agreement.limits_pct
    drawn = [
        (value, interval, kind)
        for value, interval, kind in (
            (high, agreement.high_limit_interval_pct, "equal"),
            (agreement.mean_pct, agreement.mean_interval_pct, "median"),
            (low, agreement.low_limit_interval_pct, "equal"),
        )
        if np.isfinite(value)
    ]
    written_at = _apart([up(value) + 4.0 for value, _, _ in drawn])
    for (value, interval, kind), at, beside in zip(drawn, written_at, _BESIDE, strict=False):
        parts.append(svg.line(_LEFT, up(value), right, up(value), kind))
        if np.isfinite(interval.low):
            words = f"{svg.plain(interval.low, 2, True)} to {svg.plain(interval.high, 2, True)} %"
            tall = up(interval.low) - up(interval.high)
            parts.append(svg.box(right + beside, up(interval.high), _BAR, tall, "interval", words, paint))
        parts.append(svg.text(right + 21.0, at, svg.plain(value, 1, True), "start"))
    for size, difference, product in _some(points):
        title = f"{product}: {svg.plain(difference, 2, True)} %"
        parts.append(svg.dot(across(size), up(difference), "point", title, paint))
    parts += [
        svg.text((_LEFT + right) / 2, _FLOOR + 31.0, size_words),
        svg.text(_LEFT, _FLOOR + 31.0, "%", "end"),
    ]
    label = (
        f"{name}: mean difference {svg.plain(agreement.mean_pct, 2, True)} %, limits of agreement "
        f"{svg.plain(low, 2, True)} to {svg.plain(high, 2, True)} %, {agreement.n} products"
    )
    return svg.picture(parts, _FLOOR + 38.0, label, width=_WIDTH)


def _apart(places: Sequence[float]) -> list[float]:
    """Move writing that stands in falling order of value, so that no line covers the one above."""
    moved: list[float] = []
    for place in places:
        moved.append(max(place, moved[-1] + _WRITING) if moved else place)
    return moved


def reliability(number: int, name: str, found: Reliability) -> Markup:
    """Draw the share that was right over the stated probability; on the line they are equal."""
    across, up = svg.Axis(0.0, 1.0, _LEFT, _WIDTH - 60.0), svg.Axis(0.0, 1.0, _FLOOR, 8.0)
    parts = []
    for value, written in ((0.0, "0"), (0.25, "0.25"), (0.5, "0.5"), (0.75, "0.75"), (1.0, "1")):
        parts += [
            svg.line(across(value), up(0.0), across(value), up(1.0), "grid"),
            svg.text(across(value), _FLOOR + 15.0, written),
            svg.line(across(0.0), up(value), across(1.0), up(value), "grid"),
            svg.text(_LEFT - 5.0, up(value) + 4.0, written, "end"),
        ]
    parts.append(svg.line(across(0.0), up(0.0), across(1.0), up(1.0), "equal"))
    most = max(one.n for one in found.bins)
    for one in found.bins:
        x, low, high = across(one.stated), up(one.right_interval.low), up(one.right_interval.high)
        title = (
            f"{one.n} products stated {svg.plain(one.stated, 3)}, right {svg.plain(one.right, 3)} "
            f"({svg.plain(one.right_interval.low, 3)} to {svg.plain(one.right_interval.high, 3)})"
        )
        radius = 2.5 + 4.5 * (one.n / most) ** 0.5
        parts += [
            svg.line(x, low, x, high, "whisker"),
            svg.dot(x, up(one.right), "point", title, colour(number), radius),
        ]
    parts += [
        svg.text((across(0.0) + across(1.0)) / 2, _FLOOR + 31.0, "stated probability"),
        svg.text(_LEFT + 5.0, 20.0, "share right", "start"),
    ]
    bins = "; ".join(f"stated {svg.plain(b.stated, 2)}, right {svg.plain(b.right, 2)}" for b in found.bins)
    return svg.picture(parts, _FLOOR + 38.0, f"{name}: {bins}", width=_WIDTH)


def _some(points: Sequence[Point]) -> Sequence[Point]:
    """Take at most `DOTS_MAX` points, evenly by rank of their difference, so that the far ones stay."""
    if len(points) <= DOTS_MAX:
        return points
    ranked = sorted(points, key=lambda point: point[1])
    chosen = np.linspace(0, len(ranked) - 1, DOTS_MAX).round().astype(int)
    return [ranked[place] for place in chosen.tolist()]
