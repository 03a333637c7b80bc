"""The plots of the page, as inline SVG: errors, scatter, shares, centres, times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry.records.arrays import Floats
from roemetry_tools.compare.aggregate import Pairs, columns_of
from roemetry_tools.compare.statistics import Errors, relative_pct

DOTS_MAX = 300
"""So many dots are drawn of a variant; of more, these are taken evenly by rank."""

_COLOURS = ("#0d689c", "#a65a00", "#187059", "#b71d7c", "#5a4fcf", "#726317", "#7a3b1d", "#44525f")
_LEFT, _RIGHT = 12.0, 428.0
_ROW = 50.0


def colour(number: int) -> str:
    """Colour of a variant; names tell them apart too."""
    return _COLOURS[number % len(_COLOURS)]


@dataclass(frozen=True, eq=False, slots=True)
class Estimates:
    """One variant's estimates of one quantity."""

    number: int
    name: str
    pairs: Pairs
    errors: Errors


def strips(variants: Sequence[Estimates], what: str) -> Markup:
    """Draw the relative errors: a dot for each product, the middle half as a box, the mean as a diamond."""
    drawn = [_evenly(v.pairs) for v in variants]
    relative = [relative_pct(*columns_of(pairs)) for pairs in drawn]
    axis = svg.Axis.over(*_range(relative), _LEFT, _RIGHT)
    floor = 8.0 + _ROW * len(variants)
    parts = _scale(axis, 8.0, floor, "error, % of the true value")
    for place, (variant, pairs, errors) in enumerate(zip(variants, drawn, relative, strict=True)):
        top = 8.0 + _ROW * place
        parts += _strip(variant, pairs, errors, axis, top)
    label = f"Relative errors of {what}: " + "; ".join(
        f"{v.name}: mean {svg.plain(v.errors.bias_pct, 1, True)} %, middle half from "
        f"{svg.plain(v.errors.low_pct, 1, True)} to {svg.plain(v.errors.high_pct, 1, True)} %"
        for v in variants
    )
    return svg.picture(parts, floor + 36.0, label)


def scatter(variant: Estimates, low: float, high: float, unit: str) -> Markup:
    """Draw estimates over true values; on the line both are equal."""
    size, left, right, floor = 260.0, 60.0, 232.0, 188.0  # beside the axes: room for a tick's whole number
    across = svg.Axis.over(low, high, left, right)
    up = svg.Axis.over(low, high, floor, 8.0)
    parts = []
    for value, written in across.ticks(4):
        parts += [
            svg.line(across(value), 8.0, across(value), floor, "grid"),
            svg.text(across(value), floor + 15.0, written),
            svg.line(left, up(value), right, up(value), "grid"),
            svg.text(left - 5.0, up(value) + 4.0, written, "end"),
        ]
    parts.append(svg.line(across(low), up(low), across(high), up(high), "equal"))
    for pair in _evenly(variant.pairs):
        title = f"{pair.product}: {svg.plain(pair.estimate, 1)} for {svg.plain(pair.true, 1)} {unit}"
        parts.append(svg.dot(across(pair.true), up(pair.estimate), "point", title, colour(variant.number)))
    parts += [
        svg.text((left + right) / 2, floor + 32.0, f"true, {unit}"),
        svg.text(left + 4.0, 19.0, f"estimated, {unit}", "start"),
    ]
    label = f"{variant.name}: {variant.errors.n} estimates over true values, {unit}"
    return svg.picture(parts, floor + 38.0, label, width=size)


def stacked(
    rows: Sequence[tuple[str, Sequence[tuple[str, float, str]], str]],
    top_value: float,
    axis_words: str,
    *,
    beside: bool = False,
) -> Markup:
    """Draw a bar for each row, stacked of (name, value, CSS class); the row's words stand above it.

    With `beside`, each value has a bar of its own, one below the other.
    """
    axis = svg.Axis.over(0.0, top_value, _LEFT, _RIGHT)
    floor = 8.0 + 44.0 * len(rows)
    parts = _scale(axis, 8.0, floor, axis_words)
    said = []
    for place, (name, values, words) in enumerate(rows):
        top, x = 8.0 + 44.0 * place, axis(0.0)
        parts += _headed(name, words, top)
        height = 15.0 / len(values) if beside else 15.0
        for order, (part, value, kind) in enumerate(values):
            width = axis(value) - axis(0.0)
            y = top + 19.0 + (height * order if beside else 0.0)
            if width > 0:
                parts.append(svg.box(x, y, width, height, f"part {kind}", f"{part}: {svg.plain(value, 2)}"))
            x += 0.0 if beside else width
        said.append(f"{name}: " + ", ".join(f"{p} {svg.plain(v, 2)}" for p, v, _ in values))
    return svg.picture(parts, floor + 36.0, f"{axis_words}: " + "; ".join(said))


def centres(rows: Sequence[tuple[int, str, float, float, float, str]]) -> Markup:
    """Draw, for each (number, name, bias, robust spread, RMS, words), the error of stripe centres, px."""
    far = max(max(abs(bias) + spread, rms) for _, _, bias, spread, rms, _ in rows) or 0.01
    axis = svg.Axis.over(-1.08 * far, 1.08 * far, _LEFT, _RIGHT)
    floor = 8.0 + 44.0 * len(rows)
    parts = _scale(axis, 8.0, floor, "found − true along the row, px")
    said = []
    for place, (number, name, bias, spread, rms, words) in enumerate(rows):
        top = 8.0 + 44.0 * place
        middle = top + 27.0
        parts += [
            *_headed(name, words, top),
            svg.line(axis(-rms), middle, axis(rms), middle, "whisker"),
            svg.box(
                axis(bias - spread),
                middle - 5.5,
                axis(bias + spread) - axis(bias - spread),
                11.0,
                "middle",
                f"bias {svg.plain(bias, 3, True)} ± {svg.plain(spread, 3)} px",
                colour(number),
            ),
            _diamond(axis(bias), middle, 5.0, f"bias {svg.plain(bias, 3, True)} px"),
        ]
        said.append(f"{name}: bias {svg.plain(bias, 3, True)} px, RMS {svg.plain(rms, 3)} px")
    return svg.picture(parts, floor + 36.0, "Error of stripe centres: " + "; ".join(said))


def _strip(variant: Estimates, pairs: Pairs, errors: Floats, axis: svg.Axis, top: float) -> list[Markup]:
    sums, paint, middle = variant.errors, colour(variant.number), top + 32.0
    words = f"bias {svg.plain(sums.bias_pct, 1, True)} %, n = {sums.n}"
    parts = [
        *_headed(variant.name, words, top),
        svg.line(axis(sums.min_pct), middle, axis(sums.max_pct), middle, "whisker"),
        svg.box(
            axis(sums.low_pct),
            middle - 11.0,
            axis(sums.high_pct) - axis(sums.low_pct),
            22.0,
            "middle",
            f"middle half: {svg.plain(sums.low_pct, 2, True)} to {svg.plain(sums.high_pct, 2, True)} %",
            paint,
        ),
        svg.line(axis(sums.median_pct), middle - 11.0, axis(sums.median_pct), middle + 11.0, "median"),
    ]
    for rank, (pair, error) in enumerate(zip(pairs, errors.tolist(), strict=True)):
        aside = 7.0 * ((rank * 0.618034) % 1.0 - 0.5) * 2.0  # spread evenly, and the same each time
        title = f"{pair.product}: {svg.plain(error, 2, True)} %"
        if axis.low <= error <= axis.high:
            parts.append(svg.dot(axis(error), middle + aside, "point", title, paint))
        else:
            way = 1.0 if error > axis.high else -1.0
            x, y = axis(error), middle + aside
            parts.append(
                svg.shape([(x, y), (x - 7 * way, y - 3.5), (x - 7 * way, y + 3.5)], "point", paint, title)
            )
    parts.append(_diamond(axis(sums.bias_pct), middle, 6.0, f"mean {svg.plain(sums.bias_pct, 2, True)} %"))
    return parts


def _headed(name: str, words: str, top: float) -> list[Markup]:
    """Write a row's name at the left, cut off if it would meet the words at the right."""
    room = int((_RIGHT - _LEFT - 6.4 * len(words)) / 7.6)
    shown = name if len(name) <= room else name[: max(room - 1, 8)] + "…"
    return [svg.text(_LEFT, top + 13.0, shown, "start name"), svg.text(_RIGHT, top + 13.0, words, "end")]


def _diamond(x: float, y: float, arm: float, title: str) -> Markup:
    return svg.shape([(x, y - arm), (x + arm, y), (x, y + arm), (x - arm, y)], "mean", "", title)


def _scale(axis: svg.Axis, top: float, floor: float, words: str) -> list[Markup]:
    parts = []
    for value, written in axis.ticks():
        x = axis(value)
        if x > axis.start:  # names stand at the left edge
            parts.append(svg.line(x, top, x, floor, "zero" if abs(value) < 1e-12 else "grid"))
        anchor = "start" if x < _LEFT + 8.0 else "end" if x > _RIGHT - 8.0 else ""
        parts.append(svg.text(x, floor + 14.0, written, anchor))
    parts.append(svg.text((_LEFT + _RIGHT) / 2, floor + 30.0, words))
    return parts


def _range(relative: Sequence[Floats]) -> tuple[float, float]:
    """Hold all errors and 0; but one variant's far ones do not press the others together."""
    reach = sorted(float(np.abs(errors).max()) for errors in relative)
    usual = 4.0 * reach[(len(reach) - 1) // 2] or math.inf
    low = max(min(0.0, *(float(errors.min()) for errors in relative)), -usual)
    high = min(max(0.0, *(float(errors.max()) for errors in relative)), usual)
    room = 0.04 * (high - low)
    return low - room, high + room


def _evenly(pairs: Pairs) -> Pairs:
    if len(pairs) <= DOTS_MAX:
        return pairs
    ranked = sorted(pairs, key=lambda pair: pair.estimate / pair.true)
    chosen = np.linspace(0, len(ranked) - 1, DOTS_MAX).round().astype(int)
    return [ranked[place] for place in chosen.tolist()]
