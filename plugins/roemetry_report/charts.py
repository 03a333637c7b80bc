"""Small charts as SVG: slice areas, and the shares of a volume."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from roemetry.records import Shares, Volume
from roemetry_report import palette, svg
from roemetry_report.words import percent, plain

_WIDTH, _HEIGHT = 520.0, 250.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 8.0, 16.0, 50.0


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
