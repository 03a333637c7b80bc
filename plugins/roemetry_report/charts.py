"""Small charts as SVG: slice areas, the shares of a volume, heights along the stripes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry.html.plots import Axis, plain
from roemetry.records import Profiles, Shares, StripeMap, Volume
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette
from roemetry_report.panels import broken_line
from roemetry_report.words import percent

_WIDTH, _HEIGHT = 520.0, 264.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 8.0, 30.0, 50.0
"""View and margins of the chart of slices, in units of its SVG; the margins hold the tick labels."""


def slice_chart(volume: Volume, word: str = "stripe") -> Markup | None:
    """Draw the slices as bars: as high as the slice's area, as wide as the spacing it was held over.

    So a bar's face is that slice's share of the volume. None where the estimator summed no slices. `word` is
    what a slice is made of: a stripe, or a line of a scan.
    """
    order = np.argsort(volume.slice_stripe, kind="stable")
    area, spacing = volume.slice_area_mm2[order], volume.slice_spacing_mm[order]
    if not np.isfinite(area).any():
        return None
    wide = np.where(np.isfinite(spacing) & (spacing > 0), spacing, 0.0)
    total = float(wide.sum())
    if total <= 0:
        wide, total = np.ones_like(wide), float(wide.size)
    ticks = ticks_to(float(np.nanmax(area)))
    across = (_WIDTH - _LEFT - _RIGHT) / total
    up = Axis(0.0, ticks[-1], _HEIGHT - _BOTTOM, _TOP)
    floor, decimals = up.start, _places(ticks)
    parts = [
        part for tick in ticks for part in _rule(_LEFT, _WIDTH - _RIGHT, up(tick), plain(tick, decimals))
    ]
    x = _LEFT
    usual = total * across / wide.size
    every = 1 if usual >= 17 else math.ceil(34 / usual)  # narrower bars leave no room for all figures
    slices = zip(volume.slice_stripe[order].tolist(), area, spacing, wide, strict=True)
    for k, (stripe, a, s, w) in enumerate(slices):
        width, top = float(w) * across, up(float(np.nan_to_num(a)))
        name = f"{word.capitalize()} {stripe + 1}"
        title = f"{name}: {plain(float(a), 1)} mm², held over {plain(float(s), 2)} mm"
        colour = palette.stripe_colour_on_paper(stripe)
        parts.append(svg.box(x + 0.75, top, max(width - 1.5, 0.5), floor - top, "bar", title, colour))
        middle = x + width / 2
        if width >= 17:
            parts.append(svg.text(middle, top - 4, plain(float(a), 0), "value"))
        if width >= 17 or (every > 1 and k % every == every // 2):
            parts += [
                svg.text(middle, floor + 14, str(stripe + 1), "tick strong"),
                svg.text(middle, floor + 27, plain(float(s), 1), "tick"),
            ]
        x += width
    parts += [
        svg.text(_LEFT - 6, floor + 14, word, "tick end"),
        svg.text(_LEFT - 6, floor + 27, "mm", "tick end"),
        svg.text(_LEFT, 9, "area, mm²", "tick start"),
        svg.text((_LEFT + _WIDTH - _RIGHT) / 2, _HEIGHT - 5, "spacing (width of the bar), mm", "tick"),
    ]
    label = f"Bar chart of the areas of {len(area)} slices over their spacing; the figures are in the table"
    return svg.view(parts, (0, 0, _WIDTH, _HEIGHT), label, "chart")


def share_bar(shares: Shares) -> Markup | None:
    """Draw a stacked bar: seen full, interpolated hatched, assumed empty. None where they are not known."""
    parts = (shares.seen, shares.interpolated, shares.assumed)
    if not all(math.isfinite(part) and part >= 0 for part in parts) or sum(parts) <= 0:
        return None
    x, body = 0.0, []
    for part, kind in zip(parts, ("seen", "interpolated", "assumed"), strict=True):
        width = 100 * part / sum(parts)
        if width > 0:
            body.append(svg.box(x, 0.0, width, 10.0, kind))
        x += width
    label = f"seen {percent(parts[0])}, interpolated {percent(parts[1])}, assumed {percent(parts[2])}"
    return svg.view(body, (0, 0, 100, 10), label, "shares", stretch=True)


def ticks_to(top: float, count: int = 4) -> list[float]:
    """Give round numbers from 0 to just beyond `top`."""
    if not math.isfinite(top) or top <= 0:
        return [0.0, 1.0]
    raw = top / count
    unit = 10.0 ** math.floor(math.log10(raw))
    step = next(m * unit for m in (1, 2, 2.5, 5, 10) if m * unit >= raw * 0.999)
    return [step * i for i in range(math.ceil(top / step - 1e-9) + 1)]


def _places(ticks: list[float]) -> int:
    return max(0, -math.floor(math.log10(ticks[1]))) if ticks[1] < 1 else int(ticks[1] % 1 > 0)


def _rule(left: float, right: float, y: float, words: str, kind: str = "rule") -> tuple[Markup, Markup]:
    return svg.line(left, y, right, y, kind), svg.text(left - 5, y + 3.5, words, "tick end")


_SMALL_WIDTH, _SMALL_HEIGHT = 220.0, 112.0
_SMALL_LEFT, _SMALL_RIGHT, _SMALL_TOP, _SMALL_BOTTOM = 33.0, 6.0, 8.0, 16.0
"""The same of a chart of heights along one stripe, many of which stand side by side."""
_POINTS_MAX = 2400
"""Of all small charts together: thinned out beyond, or a section would grow past a quarter of a megabyte."""


@dataclass(frozen=True, slots=True)
class SmallChart:
    """One of the small multiples."""

    title: str
    drawing: Markup


@dataclass(frozen=True, slots=True)
class _Slice:
    stripe: int
    along: Floats
    up: Floats
    seen: Flags
    over: str = ""
    """What the abscissa is, where it is not that of the others."""


def height_charts(profiles: Profiles, product: int) -> tuple[SmallChart, ...]:
    """Draw Z over Y, mm, for each slice that carries the product, over X for a line across; on one scale."""
    xyz = np.where((profiles.product == product)[..., None], profiles.xyz_mm, np.nan)
    axes = [_axis(one) for one in xyz]
    slices = [
        _Slice(int(stripe), one[:, axis], one[:, 2], seen, ", over X" if axis == 0 else "")
        for stripe, one, axis, seen in zip(profiles.stripe, xyz, axes, profiles.seen, strict=True)
    ]
    return _multiples(slices, "height over the belt along the stripe, mm")


def _axis(xyz_mm: Floats) -> int:
    """Give 1 for Y, or 0 for X where a slice reaches farther along it."""
    known = xyz_mm[np.isfinite(xyz_mm).all(axis=1), :2]
    wide, tall = np.ptp(known, axis=0) if len(known) else (0.0, 0.0)
    return 0 if wide > tall else 1


def displacement_charts(stripes: StripeMap, product: int) -> tuple[SmallChart, ...]:
    """Draw the displacement from the rest line over the image row, px, for each stripe on the product."""
    rows = np.arange(stripes.rows, dtype=np.float64)
    shift = np.where(stripes.product == product, stripes.x_px - stripes.rest_px, np.nan)
    slices = [_Slice(index, rows, shift[index], stripes.seen[index]) for index in range(len(shift))]
    return _multiples(slices, "displacement from the rest line along the image rows, px")


def _multiples(slices: list[_Slice], what: str) -> tuple[SmallChart, ...]:
    slices = [s for s in slices if np.isfinite(s.up + s.along).any()]
    if not slices:
        return ()
    known = [np.isfinite(s.up + s.along) for s in slices]
    up = np.concatenate([s.up[k] for s, k in zip(slices, known, strict=True)])
    along = np.concatenate([s.along[k] for s, k in zip(slices, known, strict=True)])
    step = max(1, -(-up.size // _POINTS_MAX))
    below = -ticks_to(-float(up.min()), 2)[-1] if up.min() < -0.02 * np.ptp(up) and up.min() < 0 else 0.0
    above = ticks_to(float(up.max()), 2)[-1] if up.max() > 0 else 0.0
    across = Axis.over(float(along.min()), float(along.max()), _SMALL_LEFT, _SMALL_WIDTH - _SMALL_RIGHT)
    upwards = Axis.over(below, above, _SMALL_HEIGHT - _SMALL_BOTTOM, _SMALL_TOP)
    return tuple(
        SmallChart(f"Stripe {s.stripe + 1}{s.over}", _drawing(s, k, across, upwards, step, what))
        for s, k in zip(slices, known, strict=True)
    )


def _drawing(given: _Slice, known: Flags, across: Axis, upwards: Axis, step: int, what: str) -> Markup:
    parts: list[Markup] = []
    for level in sorted({upwards.low, 0.0, (upwards.low + upwards.high) / 2, upwards.high}):
        if level and abs(upwards(level) - upwards(0.0)) < 12.0:
            continue  # its value would cover that of 0
        words = plain(level, 0 if level == int(level) else 1)
        kind = "rule zero" if level == 0 else "rule"
        parts += _rule(_SMALL_LEFT, _SMALL_WIDTH - _SMALL_RIGHT, upwards(level), words, kind)
    for value, end in ((across.low, "start"), (across.high, "end")):
        parts.append(svg.text(across(value), _SMALL_HEIGHT - 4, plain(value, 0), f"tick {end}"))
    colour = palette.stripe_colour_on_paper(given.stripe)
    x, y = _placed(across, given.along), _placed(upwards, given.up)
    for mask, kind, join in ((known & given.seen, "seen", False), (known & ~given.seen, "bridged", True)):
        if data := broken_line(x, y, mask, step, join=join):
            parts.append(svg.path(kind, data, stroke=colour))
    top = float(given.up[known][np.abs(given.up[known]).argmax()])
    span = f"from {plain(across.low, 0)} to {plain(across.high, 0)}, largest {plain(top, 1)}"
    label = f"Stripe {given.stripe + 1}: {what}; {span}"
    return svg.view(parts, (0, 0, _SMALL_WIDTH, _SMALL_HEIGHT), label, "chart small")


def _placed(axis: Axis, values: Floats) -> Floats:
    share = (values - axis.low) / (axis.high - axis.low)
    # A tenth of a unit is a hundredth of a millimetre of paper: enough for a chart.
    return np.round(axis.start + share * (axis.end - axis.start), 1)
