"""Small multiples: the height along each slice; or, without a calibration, the displacement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from roemetry.records import Profiles, StripeMap
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette, svg
from roemetry_report.charts import ticks_to
from roemetry_report.curves import runs
from roemetry_report.words import plain

_WIDTH, _HEIGHT = 220.0, 112.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 26.0, 6.0, 8.0, 16.0
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
        return np.asarray(_LEFT + (along - self.left) / span * (_WIDTH - _LEFT - _RIGHT), np.float64)

    def y(self, up: Floats) -> Floats:
        span = max(self.above - self.below, 1e-9)
        return np.asarray(_TOP + (self.above - up) / span * (_HEIGHT - _TOP - _BOTTOM), np.float64)


def _drawing(given: _Slice, known: Flags, frame: _Frame, step: int, what: str) -> Markup:
    parts = []
    for level in sorted({frame.below, 0.0, (frame.below + frame.above) / 2, frame.above}):
        y = float(frame.y(np.array([level]))[0])
        parts.append(
            Markup('<path class="{}" d="M{} {}H{}"/>').format(
                "rule zero" if level == 0 else "rule",
                svg.number(_LEFT),
                svg.number(y),
                svg.number(_WIDTH - _RIGHT),
            )
        )
        text = plain(level, 0 if level == int(level) else 1)
        parts.append(svg.text(_LEFT - 4, y + 3.5, text, "tick end"))
    for value, where in ((frame.left, "start"), (frame.right, "end")):
        x = _LEFT if where == "start" else _WIDTH - _RIGHT
        parts.append(svg.text(x, _HEIGHT - 4, plain(value, 0), f"tick {where}"))
    colour = palette.stripe_colour_on_paper(given.stripe)
    across, upward = frame.x(given.along), frame.y(given.up)
    for mask, kind, join in ((known & given.seen, "seen", False), (known & ~given.seen, "bridged", True)):
        data = "".join(_line(across, upward, known, begin, end, step, join) for begin, end in runs(mask))
        if data:
            parts.append(Markup('<path class="{}" stroke="{}" d="{}"/>').format(kind, colour, data))
    top = float(given.up[known][np.abs(given.up[known]).argmax()])
    span = f"from {plain(frame.left, 0)} to {plain(frame.right, 0)}, largest {plain(top, 1)}"
    label = f"Stripe {given.stripe + 1}: {what}; {span}"
    return svg.picture(parts, box=(0, 0, _WIDTH, _HEIGHT), label=label, kind="chart small")


def _line(x: Floats, y: Floats, known: Flags, begin: int, end: int, step: int, join: bool) -> str:
    first = begin - 1 if join and begin > 0 and known[begin - 1] else begin
    last = end if join and end < len(known) and known[end] else end - 1
    points = np.arange(first, last + 1, step)
    if points[-1] != last:
        points = np.append(points, last)
    # A tenth of a unit is a hundredth of a millimetre of paper: enough for a chart.
    return svg.line(np.round(x[points], 1), np.round(y[points], 1))
