"""The product from above: its plan with dents and humps, and maps of its surface."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry.html.plots import Box, plain
from roemetry.records import Relief, ReliefMap, ReliefRegion
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette
from roemetry_report.panels import Panel
from roemetry_report.words import counted

_MARGIN_MM, _LEGEND_MM = 9.0, 11.0
"""Room about the body for numbers and sizes, and below it for the legend."""
_QUANTILE = 0.98
"""Of the values' sizes: what lies beyond has the colour of the end."""

_ARROW_MM = 5.0
"""How long a direction that lies flat is drawn."""
_ARROW_EVERY = 3
"""Samples: closer arrows cover each other."""
_TEXT_MM = 3.2
"""Height of letters, as the style has it."""
_NAMED_MAX = 5
"""Dents and humps named below the plan; all stand in it."""


def relief_panels(relief: Relief) -> tuple[Panel, ...]:
    """Draw the plan and each map; nothing where there are no sections."""
    if not relief.xy_mm.size:
        return ()
    known = (shown for shown in relief.maps if np.isfinite(shown.values).any())
    maps = (_map(shown, relief) for shown in known)
    return (_plan(relief), *maps)


def _plan(relief: Relief) -> Panel:
    box = _box(relief, legend=False)
    middle = relief.middle_mm
    body = [
        _edge(relief, "plan-body"),
        *(svg.path("plan-section", _over(row[[0, -1]])) for row in relief.xy_mm),
        *(_region(region, relief) for region in relief.regions),
        svg.path("plan-chord", _over(middle[[0, -1]])),
        svg.path("plan-middle", _over(middle)),
        *_sizes(relief),
        *(_numbered(region, number) for number, region in enumerate(relief.regions, start=1)),
    ]
    kinds = [region.kind for region in relief.regions]
    counts = [counted(kinds.count(kind), kind) for kind in ("dent", "hump")]
    notes = [*counts, *_in_words(relief)]
    label = f"Plan of the product with its mid-line; {'; '.join(notes)}"
    return Panel("", "Shape from above, mm", svg.view(body, box, label, "plan"), tuple(notes))


def _over(xy_mm: Floats) -> str:
    """Path data of a line on the belt, seen from above: Y points upwards."""
    return svg.polyline(xy_mm[:, 0], -xy_mm[:, 1])


def _edge(relief: Relief, kind: str) -> Markup:
    return svg.path(kind, _over(np.concatenate([relief.xy_mm[:, 0], relief.xy_mm[::-1, -1]])) + "z")


def _region(region: ReliefRegion, relief: Relief) -> Markup:
    inside = np.zeros(relief.xy_mm.shape[:2], np.bool_)
    inside[tuple(region.cells.T)] = True
    return svg.path(f"plan-{region.kind}", _cells(relief, inside))


def _numbered(region: ReliefRegion, number: int) -> Markup:
    x, y = region.xy_mm.tolist()
    place = svg.path("plan-place", svg.crosses(np.array([x]), np.array([-y]), 1.2))
    return place + svg.text(x, -y - 2.2, str(number), "plan-words")


def _sizes(relief: Relief) -> list[Markup]:
    """Dimension lines: the seen length below the product, the largest width at its place."""
    x, y = relief.xy_mm[..., 0], -relief.xy_mm[..., 1]
    below = float(y.max()) + 5.0
    left, right = float(x.min()), float(x.max())
    widest = int(np.argmax(np.abs(y[:, -1] - y[:, 0])))
    at, top, bottom = float(x[widest, 0]), float(y[widest].min()), float(y[widest].max())
    found = [
        svg.line(left, below, right, below, "plan-size"),
        svg.line(at, top, at, bottom, "plan-size"),
    ]
    figures = relief.figures
    if "length_seen_mm" in figures:
        words = f"{plain(figures['length_seen_mm'], 1)} seen along the mid-line"
        found.append(svg.text((left + right) / 2, below + 3.6, words, "plan-words"))
    # Above the whole body: numbers of dents and humps may stand at its edge.
    found.append(svg.text(at, float(y.min()) - 4.0, f"{plain(bottom - top, 1)} wide", "plan-words"))
    return found


def _in_words(relief: Relief) -> list[str]:
    """The first regions in words, by the numbers they have in the plan, and the sizes."""
    shown = list(enumerate(relief.regions, start=1))[:_NAMED_MAX]
    said = [
        f"{number}: {region.kind} of {plain(region.depth_mm, 1)} mm over {plain(region.area_mm2, 0)} mm²"
        for number, region in shown
    ]
    said += ["and more"] if len(relief.regions) > _NAMED_MAX else []
    words = {
        "length_mm": "length {} mm by the outline",
        "thickness_mm": "thickness {} mm",
        "bend_mm": "bend {} mm",
        "turn_net_deg": "turns by {}°",
        "lean_range_deg": "lean varies by {}°",
    }
    return said + [
        word.format(plain(relief.figures[n], 1)) for n, word in words.items() if n in relief.figures
    ]


def _map(shown: ReliefMap, relief: Relief) -> Panel:
    known = shown.values[np.isfinite(shown.values)]
    low, high = (float(value) for value in np.quantile(known, (1.0 - _QUANTILE, _QUANTILE)))
    colours, ends = _scale(shown, low, high)
    unit = f", {shown.unit}" if shown.unit else ""
    size = max(abs(low), abs(high))
    digits = 3 if size < 0.2 else 2 if size < 2 else 1 if size < 20 else 0
    least, most = plain(float(known.min()), digits), plain(float(known.max()), digits)
    note = f"from {least} to {most}"
    body = [_raster(shown.values, relief, colours, ends), _edge(relief, "map-edge")]
    if shown.arrows is not None:
        body.append(_arrows(shown.arrows, relief))
    body += _legend(relief, colours, ends, (low, high), (least, most), digits)
    label = f"Map of {shown.title}{unit} over the product; {note}"
    drawing = svg.view(body, _box(relief, legend=True), label, "plan")
    notes = (note, *(("white: not known",) if known.size < shown.values.size else ()))
    return Panel("", f"{shown.title}{unit}", drawing, notes)


def _scale(shown: ReliefMap, low: float, high: float) -> tuple[Sequence[str], tuple[float, float]]:
    """Choose colours, and the values of the first and the last of them.

    A map whose sign matters, or that has a scale of its own, keeps it, so that little looks pale; others are
    spread over what they hold.
    """
    if shown.about_zero and (shown.full_scale or low < 0.0 < high):
        size = max(-low, high, shown.full_scale) or 1.0
        return palette.DIVERGING, (-size, size)
    if shown.full_scale:
        return palette.RISING, (0.0, max(high, shown.full_scale))
    return palette.RISING, (low, high if high > low else low + 1.0)


_RASTER_PX = 180
"""Columns of a map's picture: half a millimetre on most products."""


def _raster(values: Floats, relief: Relief, colours: Sequence[str], ends: tuple[float, float]) -> Markup:
    """Draw a map as a picture, linear between sections and along them, clear where nothing is known."""
    import cv2

    x, y = relief.middle_mm[:, 0], relief.xy_mm[..., 1]
    if len(x) < 2 or np.any(np.diff(x) <= 0.0):
        return Markup("")
    top, bottom = float(y.max()), float(y.min())
    rows = max(8, round(_RASTER_PX * (top - bottom) / float(x[-1] - x[0])))
    across = x[0] + (np.arange(_RASTER_PX) + 0.5) / _RASTER_PX * (x[-1] - x[0])
    section = np.clip(np.searchsorted(x, across) - 1, 0, len(x) - 2)
    a = ((across - x[section]) / (x[section + 1] - x[section]))[None, :]
    first, last = ((1 - a[0]) * y[section, k] + a[0] * y[section + 1, k] for k in (0, -1))
    upward = top - (np.arange(rows) + 0.5)[:, None] / rows * (top - bottom)
    v = (upward - first) / (last - first) * (y.shape[1] - 1)
    within = (v >= 0) & (v <= y.shape[1] - 1)
    sample = np.clip(np.floor(v), 0, y.shape[1] - 2).astype(int)
    b = v - sample
    total, weight = np.zeros(v.shape), np.zeros(v.shape)
    for i, share in ((section, 1 - a), (section + 1, a)):
        for k, part in ((sample, 1 - b), (sample + 1, b)):
            value = values[np.broadcast_to(i, v.shape), k]
            known = np.isfinite(value)
            total += np.where(known, share * part * value, 0.0)
            weight += np.where(known, share * part, 0.0)
    within &= weight > 0.5
    shares = np.where(within, (total / np.maximum(weight, 1e-9) - ends[0]) / (ends[1] - ends[0]), 0.0)
    picture = np.zeros((rows, _RASTER_PX, 4), np.uint8)
    picture[..., :3] = palette.mixed(colours, np.round(shares * 40) / 40)[..., ::-1]
    picture[..., 3] = 255 * within
    data = base64.b64encode(cv2.imencode(".png", picture)[1].tobytes()).decode()
    return svg.image(f"data:image/png;base64,{data}", (float(x[0]), -top, float(x[-1] - x[0]), top - bottom))


def _arrows(arrows: Floats, relief: Relief) -> Markup:
    """Lines from a few places of each section, as long as the direction lies flat; a dot at the place."""
    sections, samples = np.nonzero(np.isfinite(arrows).all(axis=-1))
    chosen = samples % _ARROW_EVERY == samples.min(initial=0) % _ARROW_EVERY
    places = relief.xy_mm[sections[chosen], samples[chosen]]
    steps = _ARROW_MM * arrows[sections[chosen], samples[chosen]]
    data = "".join(
        f"M{_tenth(x)} {_tenth(-y)}h.01M{_tenth(x)} {_tenth(-y)}l{_tenth(across)} {_tenth(-up)}"
        for (x, y), (across, up) in zip(places.tolist(), steps.tolist(), strict=True)
    )
    return svg.path("map-arrows", data)


_LEGEND_STEPS = 40  # boxes of colour: finer steps are not told apart


def _legend(
    relief: Relief,
    colours: Sequence[str],
    ends: tuple[float, float],
    range_: tuple[float, float],
    extremes: tuple[str, str],
    digits: int,
) -> list[Markup]:
    """Draw the colours of the values the map holds, no others, with both ends and 0 where it lies between.

    `extremes` are the map's least and greatest value: an end that stands for values beyond it says so.
    """
    x0, _, width, _ = _box(relief, legend=True)
    y = -float(relief.xy_mm[..., 1].min()) + 4.0
    low, high = range_ if range_[1] > range_[0] else ends
    left, step = x0 + 0.25 * width, 0.5 * width / _LEGEND_STEPS
    values = low + (np.arange(_LEGEND_STEPS) + 0.5) / _LEGEND_STEPS * (high - low)
    shades = palette.mixed(colours, (values - ends[0]) / (ends[1] - ends[0])).tolist()
    parts = [
        svg.box(left + k * step, y, step + 0.2, 2.6, "", fill=f"#{r:02x}{g:02x}{b:02x}")
        for k, (r, g, b) in enumerate(shades)
    ]
    zero = -low / (high - low)
    words = {share: plain(low + share * (high - low), digits) for share in (0.0, 1.0)}
    for share, sign, extreme in zip((0.0, 1.0), "≤≥", extremes, strict=True):
        words[share] = words[share] if words[share] == extreme else f"{sign} {words[share]}"
    if 0.15 < zero < 0.85:
        words[zero] = plain(0.0, digits)
    return parts + [
        svg.text(left + share * 0.5 * width, y + 6.2, word, "plan-words") for share, word in words.items()
    ]


def _cells(relief: Relief, which: Flags) -> str:
    """Path of the cells about chosen places: half way to the neighbours, runs along a section in one.

    The outer ones end at their section, where the body that is drawn ends.
    """
    x = relief.middle_mm[:, 0]
    half = np.diff(x) / 2.0
    end = np.zeros(1) if len(x) > 1 else np.full(1, 2.0)
    left = x - np.concatenate([end, half])
    right = x + np.concatenate([half, end])
    data = []
    for section in np.flatnonzero(which.any(axis=1)):
        y = -relief.xy_mm[section, :, 1]
        step = float(y[1] - y[0]) / 2.0
        chosen = np.flatnonzero(which[section])
        for run in np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1):
            top, bottom = float(y[run[0]]) - step, float(y[run[-1]]) + step
            data.append(
                f"M{_tenth(left[section])} {_tenth(top)}H{_tenth(right[section])}V{_tenth(bottom)}"
                f"H{_tenth(left[section])}z"
            )
    return "".join(data)


def _tenth(value: float) -> str:
    return svg.number(round(float(value), 1))


def _box(relief: Relief, *, legend: bool) -> Box:
    x, y = relief.xy_mm[..., 0], -relief.xy_mm[..., 1]
    bottom = _LEGEND_MM if legend else _MARGIN_MM + _TEXT_MM
    left, top = math.floor(float(x.min()) - _MARGIN_MM), math.floor(float(y.min()) - _MARGIN_MM)
    width, height = float(x.max()) + _MARGIN_MM - left, float(y.max()) + bottom - top
    return (float(left), float(top), math.ceil(width), math.ceil(height))
