"""The products in three dimensions: points for the page's own viewer, and a still picture where none runs."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup

from roemetry.records import Profiles
from roemetry.records.arrays import Floats, Integers
from roemetry_report import palette, svg
from roemetry_report.words import plain

_POINTS_MAX = 720
_STEP_MM = 0.01
"""Coordinates are sent in whole steps: 1/100 mm, coarser where the scene is more than 600 mm long."""

_SEEN, _JOINED = 1, 2
_ACROSS = 8
_YAW_DEG, _RISE_DEG = -28.0, 34.0
_WIDTH, _HEIGHT = 760.0, 400.0


@dataclass(frozen=True, slots=True)
class Solid:
    """What the page shows of a scene in belt coordinates.

    Attributes
    ----------
    still
        A picture from a fixed place: for paper, and where no script runs.
    head
        JSON: each slice's stripe, product and number of points; step and origin, mm; the largest stated
        uncertainty, mm (0: none is stated).
    points
        Base64 of x, y, z as 16-bit steps from the origin, then a byte of flags (1 seen, 2 joined to the
        point before) and a byte of uncertainty (share of the largest in 254ths, 255: not stated) for each.
    notes
        What a reader must know of the drawing.
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
    parts = [Markup('<path class="solid-belt" d="{}z"/>').format(svg.line(*_tenths(view.drawn(belt))))]
    cells = [cell for pair in pairwise(slices) for cell in _cells(*pair)]
    for cell in sorted(cells, key=view.nearness):
        share = float(cell[:, 2].mean() / high[2])
        shape = svg.line(*_tenths(view.drawn(cell)))
        colour = palette.height_colour(share)
        parts.append(Markup('<path class="solid-cell" fill="{}" d="{}z"/>').format(colour, shape))
    for one in slices if not cells else ():
        parts.append(Markup('<path class="solid-line" d="{}"/>').format(_line(view, one)))
    label = (
        f"The surface over the belt, seen from the front and above: {plain(high[0] - low[0], 0)} by "
        f"{plain(high[1] - low[1], 0)} mm, {plain(high[2], 1)} mm high"
    )
    return svg.picture(parts, box=(0, 0, _WIDTH, _HEIGHT), label=label, kind="still")


def _cells(one: _Slice, other: _Slice) -> Iterator[Floats]:
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


def _line(view: _View, given: _Slice) -> str:
    return svg.line(*_tenths(view.drawn(given.xyz_mm)))


def _tenths(places: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Round to a tenth of a unit: a still picture needs no more."""
    return np.round(places[0], 1), np.round(places[1], 1)
