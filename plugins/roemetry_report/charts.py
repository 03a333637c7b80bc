"""Small charts as SVG: slice areas, the shares of a volume, heights along the stripes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from roemetry.records import Profiles, Shares, StripeMap, Volume
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette, svg
from roemetry_report.panels import runs
from roemetry_report.words import percent, plain

_WIDTH, _HEIGHT = 520.0, 250.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 8.0, 16.0, 50.0
"""View and margins of the chart of slices, in units of its SVG; the margins hold the tick labels."""


def slice_chart(volume: Volume) -> Markup | None:
    """Draw the slices as bars: as high as the slice's area, as wide as the spacing it was held over.

    So a bar's face is that slice's share of the volume. None where the estimator summed no slices.
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
    across, up = (_WIDTH - _LEFT - _RIGHT) / total, (_HEIGHT - _TOP - _BOTTOM) / ticks[-1]
    floor = _HEIGHT - _BOTTOM
    parts = [_rule(_LEFT, _WIDTH - _RIGHT, floor - tick * up, plain(tick, _places(ticks))) for tick in ticks]
    x = _LEFT
    for stripe, a, s, w in zip(volume.slice_stripe[order].tolist(), area, spacing, wide, strict=True):
        width, height = float(w) * across, max(0.0, float(np.nan_to_num(a))) * up
        parts.append(
            Markup(
                '<rect class="bar" fill="{}" x="{}" y="{}" width="{}" height="{}">'
                "<title>Stripe {}: {} mm², held over {} mm</title></rect>"
            ).format(
                palette.stripe_colour_on_paper(stripe),
                svg.number(x + 0.75),
                svg.number(floor - height),
                svg.number(max(width - 1.5, 0.5)),
                svg.number(height),
                stripe + 1,
                plain(float(a), 1),
                plain(float(s), 2),
            )
        )
        if width >= 17:
            middle = x + width / 2
            parts += [
                svg.text(middle, floor - height - 4, plain(float(a), 0), "value"),
                svg.text(middle, floor + 14, str(stripe + 1), "tick strong"),
                svg.text(middle, floor + 27, plain(float(s), 1), "tick"),
            ]
        x += width
    parts += [
        svg.text(_LEFT - 6, floor + 14, "stripe", "tick end"),
        svg.text(_LEFT - 6, floor + 27, "mm", "tick end"),
        svg.text(_LEFT, 9, "area, mm²", "tick start"),
        svg.text((_LEFT + _WIDTH - _RIGHT) / 2, _HEIGHT - 5, "spacing (width of the bar), mm", "tick"),
    ]
    label = f"Bar chart of the areas of {len(area)} slices over their spacing; the figures are in the table"
    return svg.picture(parts, box=(0, 0, _WIDTH, _HEIGHT), label=label, kind="chart")


def share_bar(shares: Shares) -> Markup | None:
    """Draw a stacked bar: seen full, interpolated hatched, assumed empty. None where they are not known."""
    parts = (shares.seen, shares.interpolated, shares.assumed)
    if not all(math.isfinite(part) and part >= 0 for part in parts) or sum(parts) <= 0:
        return None
    x, body = 0.0, []
    for part, kind in zip(parts, ("seen", "interpolated", "assumed"), strict=True):
        width = 100 * part / sum(parts)
        if width > 0:
            body.append(
                Markup('<rect class="{}" x="{}" y="0" width="{}" height="10"/>').format(
                    kind, svg.number(x), svg.number(width)
                )
            )
        x += width
    label = f"seen {percent(parts[0])}, interpolated {percent(parts[1])}, assumed {percent(parts[2])}"
    return svg.picture(body, box=(0, 0, 100, 10), label=label, kind="shares", stretch=True)


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


def _rule(left: float, right: float, y: float, text: str) -> Markup:
    return Markup('<path class="rule" d="M{} {}H{}"/>').format(
        svg.number(left), svg.number(y), svg.number(right)
    ) + svg.text(left - 6, y + 3.5, text, "tick end")


_SMALL_WIDTH, _SMALL_HEIGHT = 220.0, 112.0
_SMALL_LEFT, _SMALL_RIGHT, _SMALL_TOP, _SMALL_BOTTOM = 33.0, 6.0, 8.0, 16.0
"""The same of a chart of heights along one stripe, many of which stand side by side."""
_POINTS_MAX = 2400


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


def height_charts(profiles: Profiles, product: int) -> tuple[SmallChart, ...]:
    """Draw Z over Y, mm, for each slice that carries the product; all on the same scales."""
    slices = []
    for index in range(profiles.slice_count):
        z = np.where(profiles.product[index] == product, profiles.xyz_mm[index, :, 2], np.nan)
        slices.append(
            _Slice(int(profiles.stripe[index]), profiles.xyz_mm[index, :, 1], z, profiles.seen[index])
        )
    return _multiples(slices, "height over the belt along the stripe, mm")


def displacement_charts(stripes: StripeMap, product: int) -> tuple[SmallChart, ...]:
    """Draw the displacement from the rest line over the image row, px, for each stripe on the product."""
    rows = np.arange(stripes.rows, dtype=np.float64)
    slices = []
    for index in range(stripes.stripe_count):
        shift = stripes.x_px[index] - stripes.rest_px[index]
        up = np.where(stripes.product[index] == product, shift, np.nan)
        slices.append(_Slice(index, rows, up, stripes.seen[index]))
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
    frame = _Frame(float(along.min()), float(along.max()), below, above)
    return tuple(
        SmallChart(f"Stripe {s.stripe + 1}", _drawing(s, k, frame, step, what))
        for s, k in zip(slices, known, strict=True)
    )


@dataclass(frozen=True, slots=True)
class _Frame:
    """Limits of the axes, and the way from values to the drawing."""

    left: float
    right: float
    below: float
    above: float

    def x(self, along: Floats) -> Floats:
        span = max(self.right - self.left, 1e-9)
        return np.asarray(
            _SMALL_LEFT + (along - self.left) / span * (_SMALL_WIDTH - _SMALL_LEFT - _SMALL_RIGHT), np.float64
        )

    def y(self, up: Floats) -> Floats:
        span = max(self.above - self.below, 1e-9)
        return np.asarray(
            _SMALL_TOP + (self.above - up) / span * (_SMALL_HEIGHT - _SMALL_TOP - _SMALL_BOTTOM), np.float64
        )


def _drawing(given: _Slice, known: Flags, frame: _Frame, step: int, what: str) -> Markup:
    parts = []
    for level in sorted({frame.below, 0.0, (frame.below + frame.above) / 2, frame.above}):
        y = float(frame.y(np.array([level]))[0])
        parts.append(
            Markup('<path class="{}" d="M{} {}H{}"/>').format(
                "rule zero" if level == 0 else "rule",
                svg.number(_SMALL_LEFT),
                svg.number(y),
                svg.number(_SMALL_WIDTH - _SMALL_RIGHT),
            )
        )
        text = plain(level, 0 if level == int(level) else 1)
        parts.append(svg.text(_SMALL_LEFT - 4, y + 3.5, text, "tick end"))
    for value, where in ((frame.left, "start"), (frame.right, "end")):
        x = _SMALL_LEFT if where == "start" else _SMALL_WIDTH - _SMALL_RIGHT
        parts.append(svg.text(x, _SMALL_HEIGHT - 4, plain(value, 0), f"tick {where}"))
    colour = palette.stripe_colour_on_paper(given.stripe)
    across, upward = frame.x(given.along), frame.y(given.up)
    for mask, kind, join in ((known & given.seen, "seen", False), (known & ~given.seen, "bridged", True)):
        data = "".join(_line(across, upward, known, begin, end, step, join) for begin, end in runs(mask))
        if data:
            parts.append(Markup('<path class="{}" stroke="{}" d="{}"/>').format(kind, colour, data))
    top = float(given.up[known][np.abs(given.up[known]).argmax()])
    span = f"from {plain(frame.left, 0)} to {plain(frame.right, 0)}, largest {plain(top, 1)}"
    label = f"Stripe {given.stripe + 1}: {what}; {span}"
    return svg.picture(parts, box=(0, 0, _SMALL_WIDTH, _SMALL_HEIGHT), label=label, kind="chart small")


def _line(x: Floats, y: Floats, known: Flags, begin: int, end: int, step: int, join: bool) -> str:
    first = begin - 1 if join and begin > 0 and known[begin - 1] else begin
    last = end if join and end < len(known) and known[end] else end - 1
    points = np.arange(first, last + 1, step)
    if points[-1] != last:
        points = np.append(points, last)
    # A tenth of a unit is a hundredth of a millimetre of paper: enough for a chart.
    return svg.line(np.round(x[points], 1), np.round(y[points], 1))
