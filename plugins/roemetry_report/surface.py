"""The product's surface: relief maps from above, and the solid body that the reader turns."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from roemetry.html import plots as svg
from roemetry.html.plots import Box, plain
from roemetry.records import Profiles, Relief, ReliefMap, ReliefRegion
from roemetry.records.arrays import Flags, Floats, Integers
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
    maps = (_map(shown, relief, letter) for letter, shown in zip("klmnopqr", known, strict=False))
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
    return Panel("j", "Shape from above, mm", svg.view(body, box, label, "plan"), tuple(notes))


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
            body.append(svg.path("", _cells(relief, which), fill=colour))
    body.append(_edge(relief, "map-edge"))
    if shown.arrows is not None:
        body.append(_arrows(shown.arrows, relief))
    body += _legend(relief, colours, (low, size))
    unit = f", {shown.unit}" if shown.unit else ""
    least, most = float(np.nanmin(values)), float(np.nanmax(values))
    digits = 3 if size < 0.5 else 1 if size < 20 else 0
    note = f"from {plain(least, digits)} to {plain(most, digits)}"
    label = f"Map of {shown.title}{unit} over the product; {note}"
    drawing = svg.view(body, _box(relief, legend=True), label, "plan")
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
    return svg.path("map-arrows", data)


def _legend(relief: Relief, colours: Sequence[str], ends: tuple[float, float]) -> list[Markup]:
    x0, _, width, _ = _box(relief, legend=True)
    y = -float(relief.xy_mm[..., 1].min()) + 4.0
    left, step = x0 + 0.25 * width, 0.5 * width / len(colours)
    parts = [
        svg.box(left + k * step, y, step + 0.05, 2.6, "", fill=colour) for k, colour in enumerate(colours)
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


_POINTS_MAX = 720
"""Of all slices: 8 kB of the page."""
_STEP_MM = 0.01
"""Coordinates are sent in whole steps: 1/100 mm, coarser where the scene is more than 600 mm long."""

_SEEN, _JOINED = 1, 2
_ACROSS = 8
"""Points across a slice of the still picture: enough for its size on paper."""
_YAW_DEG, _RISE_DEG = -28.0, 34.0
_WIDTH, _HEIGHT = 760.0, 400.0
"""Where the scene is first seen from, and the view's size; the viewer's script begins with the same."""


@dataclass(frozen=True, slots=True)
class Solid:
    """What the page shows of a scene in belt coordinates; `still` is for paper, and where no script runs.

    `head` is JSON: each slice's stripe, product and number of points; step and origin, mm; the largest stated
    uncertainty, mm (0: none is stated). `points` is base64 of x, y, z as 16-bit steps from the origin, then a
    byte of flags (1 seen, 2 joined to the point before) and a byte of uncertainty (share of the largest in
    254ths, 255: not stated) for each.
    """

    still: Markup
    head: str
    points: str
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Slice:
    stripe: int
    product: int
    xyz_mm: Floats
    seen: Integers
    joined: Integers
    std_mm: Floats


def solid(profiles: Profiles) -> Solid | None:
    """Prepare the slices on products for the viewer; None where no product has two points."""
    count = int(np.count_nonzero(_mine(profiles)))
    step = max(1, -(-count // _POINTS_MAX))
    slices = list(_slices(profiles, step))
    if not slices:
        return None
    xyz = np.concatenate([one.xyz_mm for one in slices])
    std = np.concatenate([one.std_mm for one in slices])
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    low[2], high[2] = min(low[2], 0.0), max(high[2], 1e-3)
    origin = np.round((low + high) / 2, 3)
    step_mm = max(_STEP_MM, float((high - low).max()) / 60000.0)
    steps = np.rint((xyz - origin) / step_mm).astype("<i2")
    flags = np.concatenate([one.seen * _SEEN + one.joined * _JOINED for one in slices]).astype(np.uint8)
    largest = float(np.nanmax(std)) if np.isfinite(std).any() else 0.0
    shares = np.full(len(std), 255, np.uint8)
    if largest > 0:
        shares = np.where(np.isfinite(std), np.rint(np.nan_to_num(std) / largest * 254), 255).astype(np.uint8)
    head = {
        "slices": [[one.stripe, one.product, len(one.xyz_mm)] for one in slices],
        "step": step_mm,
        "origin": origin.tolist(),
        "low": [round(float(value), 3) for value in low],
        "high": [round(float(value), 3) for value in high],
        "std": round(largest, 5),
    }
    data = base64.b64encode(steps.tobytes() + flags.tobytes() + shares.tobytes()).decode("ascii")
    notes: tuple[str, ...] = (
        "between stripes the surface is drawn straight, end to end; the volume's own rule may differ",
    )
    if step > 1:
        notes = (*notes, f"one point in {step} is drawn")
    return Solid(_still(slices, low, high), json.dumps(head, separators=(",", ":")), data, notes)


def _mine(profiles: Profiles) -> np.ndarray:
    return np.asarray((profiles.product > 0) & np.isfinite(profiles.xyz_mm).all(axis=2))


def _slices(profiles: Profiles, step: int) -> Iterator[_Slice]:
    """Give the part of each slice on each product, thinned out, ends kept."""
    mine = _mine(profiles)
    for product in np.unique(profiles.product[mine]):
        for index in range(profiles.slice_count):
            on = np.flatnonzero(mine[index] & (profiles.product[index] == product))
            if on.size < 2:
                continue
            ends = np.flatnonzero(np.diff(on) > 1)
            kept = np.unique(np.concatenate([np.arange(0, on.size, step), ends, ends + 1, [on.size - 1]]))
            run = np.concatenate([[0], np.cumsum(np.diff(on) > 1)])[kept]
            yield _Slice(
                int(profiles.stripe[index]),
                int(product),
                profiles.xyz_mm[index, on[kept]],
                profiles.seen[index, on[kept]].astype(np.int64),
                np.concatenate([[0], run[1:] == run[:-1]]).astype(np.int64),
                profiles.height_std_mm[index, on[kept]],
            )


class _View:
    """From belt coordinates to the still picture: from the front and above, without perspective."""

    def __init__(self, low: Floats, high: Floats) -> None:
        yaw, rise = math.radians(_YAW_DEG), math.radians(_RISE_DEG)
        self._centre = (low + high) / 2
        self._right = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        self._up = np.array([-math.sin(yaw) * math.sin(rise), math.cos(yaw) * math.sin(rise), math.cos(rise)])
        self._near = np.cross(self._right, self._up)
        corners = np.array([[x, y, z] for x in _ends(low, high, 0) for y in _ends(low, high, 1)
                            for z in (low[2], high[2])])  # fmt: skip
        across, upward = self._raw(corners)
        self._scale = min(_WIDTH * 0.92 / np.ptp(across), _HEIGHT * 0.9 / np.ptp(upward))
        self._left = _WIDTH / 2 - self._scale * (across.min() + across.max()) / 2
        self._top = _HEIGHT / 2 + self._scale * (upward.min() + upward.max()) / 2

    def drawn(self, xyz: Floats) -> tuple[Floats, Floats]:
        across, upward = self._raw(xyz)
        return self._left + self._scale * across, self._top - self._scale * upward

    def nearness(self, xyz: Floats) -> float:
        return float(((xyz - self._centre) @ self._near).mean())

    def _raw(self, xyz: Floats) -> tuple[Floats, Floats]:
        off = xyz - self._centre
        return off @ self._right, off @ self._up


def _ends(low: Floats, high: Floats, axis: int) -> tuple[float, float]:
    """Give how far the belt is drawn: a tenth beyond the products."""
    room = 0.1 * float((high - low)[:2].max())
    return float(low[axis]) - room, float(high[axis]) + room


def _still(slices: list[_Slice], low: Floats, high: Floats) -> Markup:
    view = _View(low, high)
    (x0, x1), (y0, y1) = _ends(low, high, 0), _ends(low, high, 1)
    belt = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    parts = [svg.path("solid-belt", _outline(view, belt) + "z")]
    cells = [cell for pair in pairwise(slices) for cell in _solid_cells(*pair)]
    for cell in sorted(cells, key=view.nearness):
        colour = palette.height_colour(float(cell[:, 2].mean() / high[2]))
        parts.append(svg.path("solid-cell", _outline(view, cell) + "z", fill=colour))
    parts += [svg.path("solid-line", _outline(view, one.xyz_mm)) for one in slices if not cells]
    label = (
        f"The surface over the belt, seen from the front and above: {plain(high[0] - low[0], 0)} by "
        f"{plain(high[1] - low[1], 0)} mm, {plain(high[2], 1)} mm high"
    )
    return svg.view(parts, (0, 0, _WIDTH, _HEIGHT), label, "still")


def _solid_cells(one: _Slice, other: _Slice) -> Iterator[Floats]:
    """Give the quadrangles between two neighbouring slices of a product, from end to end of both."""
    if one.product != other.product:
        return
    edges = []
    for part in (one, other):
        order = np.argsort(part.xyz_mm[:, 1])
        along = part.xyz_mm[order]
        y = np.linspace(along[0, 1], along[-1, 1], _ACROSS)
        edges.append(np.column_stack([np.interp(y, along[:, 1], along[:, k]) for k in range(3)]))
    for k in range(_ACROSS - 1):
        yield np.array([edges[0][k], edges[0][k + 1], edges[1][k + 1], edges[1][k]])


def _outline(view: _View, xyz_mm: Floats) -> str:
    """Path data of points, to a tenth of a unit: a still picture needs no more."""
    across, upward = view.drawn(xyz_mm)
    return svg.polyline(np.round(across, 1), np.round(upward, 1))
