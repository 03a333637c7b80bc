"""A product's shape seen from above, mm: sizes, mid-line, dents and humps, and maps of the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from roemetry.records import Relief, ReliefMap, ReliefRegion
from roemetry.records.arrays import Flags, Floats
from roemetry_report import palette, svg
from roemetry_report.panels import Panel
from roemetry_report.svg import Box
from roemetry_report.words import counted, plain

_MARGIN_MM = 9.0
_LEGEND_MM = 11.0
_QUANTILE = 0.98
"""Of the values' sizes: what lies beyond has the colour of the end."""

_ARROW_MM = 5.0
"""How long a direction that lies flat is drawn."""
_ARROW_EVERY = 3
_TEXT_MM = 3.2
_NAMED_MAX = 5


def relief_panels(relief: Relief) -> tuple[Panel, ...]:
    """Draw the plan and each map; nothing where there are no sections."""
    if not relief.xy_mm.size:
        return ()
    known = (shown for shown in relief.maps if np.isfinite(shown.values).any())
    maps = (_map(shown, relief, letter) for letter, shown in zip("klmnopqr", known, strict=False))
    return (_plan(relief), *maps)


def _plan(relief: Relief) -> Panel:
    box = _box(relief, legend=False)
    edges = np.concatenate([relief.xy_mm[:, 0], relief.xy_mm[::-1, -1]])
    body = [
        Markup('<path class="plan-body" d="{}z"/>').format(svg.line(edges[:, 0], -edges[:, 1])),
        *(
            Markup('<path class="plan-section" d="{}"/>').format(svg.line(row[[0, -1], 0], -row[[0, -1], 1]))
            for row in relief.xy_mm
        ),
        *(_region(region, relief) for region in relief.regions),
        *_mid_line(relief),
        *_sizes(relief),
        *(_numbered(region, number) for number, region in enumerate(relief.regions, start=1)),
    ]
    kinds = [region.kind for region in relief.regions]
    counts = [counted(kinds.count(kind), kind) for kind in ("dent", "hump")]
    notes = [*counts, *_regions(relief), *_figures(relief)]
    label = f"Plan of the product with its mid-line; {'; '.join(notes)}"
    return Panel(
        "j", "Shape from above, mm", svg.picture(body, box=box, label=label, kind="plan"), tuple(notes)
    )


def _region(region: ReliefRegion, relief: Relief) -> Markup:
    inside = np.zeros(relief.xy_mm.shape[:2])
    inside[tuple(region.cells.T)] = 1.0
    return Markup('<path class="plan-{}" d="{}"/>').format(region.kind, _cells(relief, inside > 0.5))


def _numbered(region: ReliefRegion, number: int) -> Markup:
    x, y = region.xy_mm.tolist()
    return Markup('<path class="plan-place" d="{}"/>').format(
        svg.crosses(np.array([x]), np.array([-y]), 1.2)
    ) + svg.text(x, -y - 2.2, str(number), "plan-words")


def _mid_line(relief: Relief) -> list[Markup]:
    x, y = relief.middle_mm.T
    chord = svg.line(x[[0, -1]], -y[[0, -1]])
    return [
        Markup('<path class="plan-chord" d="{}"/>').format(chord),
        Markup('<path class="plan-middle" d="{}"/>').format(svg.line(x, -y)),
    ]


def _sizes(relief: Relief) -> list[Markup]:
    """Dimension lines: the seen length below the product, the largest width at its place."""
    x, y = relief.xy_mm[..., 0], -relief.xy_mm[..., 1]
    below = float(y.max()) + 5.0
    left, right = float(x.min()), float(x.max())
    widest = int(np.argmax(np.abs(y[:, -1] - y[:, 0])))
    at, top, bottom = float(x[widest, 0]), float(y[widest].min()), float(y[widest].max())
    found = [
        Markup('<path class="plan-size" d="M{} {}H{}"/>').format(
            svg.number(left), svg.number(below), svg.number(right)
        ),
        Markup('<path class="plan-size" d="M{} {}V{}"/>').format(
            svg.number(at), svg.number(top), svg.number(bottom)
        ),
    ]
    figures = relief.figures
    if "length_seen_mm" in figures:
        words = f"{plain(figures['length_seen_mm'], 1)} seen along the mid-line"
        found.append(svg.text((left + right) / 2, below + 3.6, words, "plan-words"))
    # Above the whole body: numbers of dents and humps may stand at its edge.
    found.append(svg.text(at, float(y.min()) - 4.0, f"{plain(bottom - top, 1)} wide", "plan-words"))
    return found


def _regions(relief: Relief) -> list[str]:
    """The first regions in words, by the numbers they have in the plan."""
    shown = list(enumerate(relief.regions, start=1))[:_NAMED_MAX]
    said = [
        f"{number}: {region.kind} of {plain(region.depth_mm, 1)} mm over {plain(region.area_mm2, 0)} mm²"
        for number, region in shown
    ]
    return said + (["and more"] if len(relief.regions) > _NAMED_MAX else [])


def _figures(relief: Relief) -> list[str]:
    """The sizes in words."""
    words = {
        "length_mm": "length {} mm by the outline",
        "thickness_mm": "thickness {} mm",
        "bend_mm": "bend {} mm",
        "turn_net_deg": "turns by {}°",
        "lean_range_deg": "lean varies by {}°",
    }
    return [said.format(plain(relief.figures[n], 1)) for n, said in words.items() if n in relief.figures]


def _map(shown: ReliefMap, relief: Relief, letter: str) -> Panel:
    values = shown.values
    usual = float(np.quantile(np.abs(values[np.isfinite(values)]), _QUANTILE))
    size = max(usual, shown.full_scale) or 1.0
    low = -size if shown.about_zero else 0.0
    colours = palette.DIVERGING if shown.about_zero else palette.RISING
    number = np.clip((values - low) / (size - low) * len(colours), 0, len(colours) - 1e-9)
    body = []
    for k, colour in enumerate(colours):
        with np.errstate(invalid="ignore"):
            which = np.isfinite(values) & (np.floor(number) == k)
        if which.any():
            body.append(Markup('<path fill="{}" d="{}"/>').format(colour, _cells(relief, which)))
    edges = np.concatenate([relief.xy_mm[:, 0], relief.xy_mm[::-1, -1]])
    body.append(Markup('<path class="map-edge" d="{}z"/>').format(svg.line(edges[:, 0], -edges[:, 1])))
    if shown.arrows is not None:
        body.append(_arrows(shown.arrows, relief))
    body += _legend(relief, colours, (low, size))
    unit = f", {shown.unit}" if shown.unit else ""
    least, most = float(np.nanmin(values)), float(np.nanmax(values))
    digits = 3 if size < 0.5 else 1 if size < 20 else 0
    note = f"from {plain(least, digits)} to {plain(most, digits)}"
    label = f"Map of {shown.title}{unit} over the product; {note}"
    drawing = svg.picture(body, box=_box(relief, legend=True), label=label, kind="plan")
    return Panel(letter, f"{shown.title}{unit}", drawing, (note,))


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
    return Markup('<path class="map-arrows" d="{}"/>').format(data)


def _legend(relief: Relief, colours: Sequence[str], ends: tuple[float, float]) -> list[Markup]:
    x0, _, width, _ = _box(relief, legend=True)
    y = -float(relief.xy_mm[..., 1].min()) + 4.0
    left, step = x0 + 0.25 * width, 0.5 * width / len(colours)
    parts = [
        Markup('<rect fill="{}" x="{}" y="{}" width="{}" height="2.6"/>').format(
            colour, svg.number(left + k * step), svg.number(y), svg.number(step + 0.05)
        )
        for k, colour in enumerate(colours)
    ]
    digits = 3 if ends[1] < 0.5 else 1 if ends[1] < 20 else 0
    for at, value in ((left, ends[0]), (left + 0.5 * width, ends[1])):
        parts.append(svg.text(at, y + 6.2, plain(value, digits), "plan-words"))
    return parts


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
