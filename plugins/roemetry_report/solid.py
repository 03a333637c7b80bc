"""The product in three dimensions: what the page's viewer turns, and a still picture of it for paper."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from roemetry.html import plots as svg
from roemetry.html.plots import plain
from roemetry.records import Product, ProductTrace, Profiles, Surface
from roemetry.records.arrays import Floats, Integers
from roemetry_report import palette

_POINTS_MAX = 720
"""Measured points of all slices: 12 kB of the page."""
_VERTICES_MAX = 1000
"""Of all surfaces of an acquisition: 15 kB of the page, and 10 ms to draw."""
_STEP_MM = 0.01
"""Coordinates are sent in whole steps: 1/100 mm, coarser where the scene is more than 600 mm long."""
_PX_PER_STEP = 0.25
_BRIGHT, _GAIN_MAX = 235.0, 4.0
"""Level of a product's brightest places in the image that covers it, and how much that may lift it."""
_ALONG_STRIPE = 0.3
"""A place between two stripes takes what is known at the same Y of either, not of what lies nearest."""
_CLOSE_MM = 2.0  # along the belt: farther from any measured point, a vertex has no place in the image

_SEEN, _JOINED = 1, 2
SEEN, INTERPOLATED, ASSUMED, VOID = range(4)
_YAW_DEG, _RISE_DEG = -28.0, 34.0
_WIDTH, _HEIGHT = 760.0, 400.0
"""Where the scene is first seen from, and the view's size; the viewer's script begins with the same."""
_STILL = 17, 8
"""Stations and points of the still picture: enough for its size on paper."""


@dataclass(frozen=True, slots=True)
class Solid:
    """What the page shows of a scene in belt coordinates; `still` is for paper, and where no script runs.

    `head` is JSON: each slice's stripe, product and number of points; each surface's product, stations,
    points, and 1 if walls close it; step and origin, mm; pixels for each step of the places in the image;
    the largest stated uncertainty, mm (0: none is stated); whether surfaces have the image's colours.

    `points` is base64: for each measured point x, y, z as 16-bit steps, then for each its place in the image;
    for each vertex of the surfaces x, y, z; then bytes: each point's flags (1 seen, 2 joined to the one
    before) and uncertainty (share of the largest in 254ths, 255: not stated); each vertex's kind (0 seen,
    1 interpolated, 2 assumed, 3 a gap), uncertainty, and red, green and blue.
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
    px: Floats
    seen: Integers
    joined: Integers
    std_mm: Floats


@dataclass(frozen=True, slots=True)
class _Grid:
    """A surface as it is drawn, (station, point) each."""

    product: int
    xyz_mm: Floats
    kind: NDArray[np.uint8]
    std_mm: Floats
    rgb: NDArray[np.uint8]
    closed: bool
    """Whether it is the surface of a volume, with upright walls down to the belt."""


def solid(
    profiles: Profiles, products: Sequence[ProductTrace] = (), picture: NDArray[np.uint8] | None = None
) -> Solid | None:
    """Prepare the products of a scene for the viewer; None where no product has two points.

    Parameters
    ----------
    profiles, products
        Of one trace. A product whose volume has no surface is drawn straight from slice to slice.
    picture : ndarray of uint8, shape (row, column, 3)
        What the surfaces are coloured by, blue, green, red, in the turned image; None: they are not.
    """
    count = int(np.count_nonzero(_mine(profiles)))
    step = max(1, -(-count // _POINTS_MAX))
    slices = list(_slices(profiles, step))
    if not slices:
        return None
    grids = _grids(slices, products, picture)
    xyz = np.concatenate([one.xyz_mm for one in slices])
    vertices = [grid.xyz_mm.reshape(-1, 3) for grid in grids]
    every = np.concatenate([xyz, *(v[np.isfinite(v[:, 2])] for v in vertices)])
    low, high = every.min(axis=0), every.max(axis=0)
    low[2], high[2] = min(low[2], 0.0), max(high[2], 1e-3)
    origin = np.round((low + high) / 2, 3)
    step_mm = max(_STEP_MM, float((high - low).max()) / 60000.0)
    std = np.concatenate([one.std_mm for one in slices])
    largest = float(np.nanmax(std)) if np.isfinite(std).any() else 0.0

    def steps(places: Floats) -> bytes:
        return _words((np.nan_to_num(places) - origin) / step_mm)

    def shares(of: Floats) -> bytes:
        if not largest > 0:
            return bytes([255]) * of.size
        known = np.rint(np.nan_to_num(of) / largest * 254).clip(0, 254)
        return np.where(np.isfinite(of), known, 255).astype(np.uint8).tobytes()

    px = np.concatenate([one.px for one in slices]) / _PX_PER_STEP
    data = [steps(xyz), _words(np.nan_to_num(px))]
    data += [steps(v) for v in vertices]
    data += [
        np.concatenate([one.seen * _SEEN + one.joined * _JOINED for one in slices])
        .astype(np.uint8)
        .tobytes(),
        shares(std),
        *(grid.kind.tobytes() for grid in grids),
        *(shares(grid.std_mm) for grid in grids),
        *(grid.rgb.tobytes() for grid in grids),
    ]
    head = {
        "slices": [[one.stripe, one.product, len(one.xyz_mm)] for one in slices],
        "grids": [[grid.product, *grid.kind.shape, int(grid.closed)] for grid in grids],
        "step": step_mm,
        "px": _PX_PER_STEP,
        "origin": origin.tolist(),
        "low": [round(float(value), 3) for value in low],
        "high": [round(float(value), 3) for value in high],
        "std": round(largest, 5),
        "coloured": picture is not None and any(grid.rgb.any() for grid in grids),
    }
    return Solid(
        _still(grids, slices, low, high),
        json.dumps(head, separators=(",", ":")),
        base64.b64encode(b"".join(data)).decode("ascii"),
        _notes(products, step),
    )


def _words(values: Floats) -> bytes:
    """Code numbers as 16-bit integers, lowest byte first."""
    return bytes(np.rint(values).clip(-32768, 32767).astype("<i2").tobytes())


def _notes(products: Sequence[ProductTrace], step: int) -> tuple[str, ...]:
    notes = ["grey upright walls close the volume down to the belt"]
    if not any(found.surface is not None for found in products):
        notes = ["no volume estimator gave a surface: drawn straight from stripe to stripe, ends left open"]
    return (*notes, *((f"one measured point in {step} is drawn",) if step > 1 else ()))


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
                np.column_stack([profiles.x_px[index, on[kept]], profiles.row_px[index, on[kept]]]),
                profiles.seen[index, on[kept]].astype(np.int64),
                np.concatenate([[0], run[1:] == run[:-1]]).astype(np.int64),
                profiles.height_std_mm[index, on[kept]],
            )


def _grids(
    slices: list[_Slice], products: Sequence[ProductTrace], picture: NDArray[np.uint8] | None
) -> list[_Grid]:
    surfaces = {found.product.number: found.surface for found in products if found.surface is not None}
    views = {found.product.number: found.product for found in products}
    numbers = sorted({one.product for one in slices})
    given = {}
    for number in numbers:
        mine = [one for one in slices if one.product == number]
        surface = surfaces.get(number) or _straight(mine)
        if surface is not None:
            given[number] = (surface, mine)
    room = math.sqrt(_VERTICES_MAX / max(1, sum(s.assumed.size for s, _ in given.values())))
    found = []
    for number, (surface, mine) in given.items():
        xyz, assumed = _thinned(surface, tuple(max(4, int(n * room)) for n in surface.assumed.shape))
        kind, std = _known(xyz, assumed, mine)
        rgb = _colours(xyz, views.get(number), picture)
        found.append(_Grid(number, xyz, kind, std, rgb, number in surfaces))
    return found


def _straight(slices: list[_Slice]) -> Surface | None:
    """Join neighbouring slices end to end; what lies in a slice's gap is one of the surface."""
    if len(slices) < 2:
        return None
    stations = []
    for one in slices:
        order = np.argsort(one.xyz_mm[:, 1])
        along = one.xyz_mm[order]
        y = np.linspace(along[0, 1], along[-1, 1], 29)
        station = np.column_stack([np.interp(y, along[:, 1], along[:, k]) for k in range(3)])
        for k in np.flatnonzero(one.joined[1:] == 0) + 1:
            low, high = sorted((one.xyz_mm[k - 1, 1], one.xyz_mm[k, 1]))
            station[(y > low) & (y < high)] = math.nan
        stations.append(station)
    xyz = np.array(stations)
    return Surface(xyz, np.zeros(xyz.shape[:2], np.bool_))


def _thinned(surface: Surface, most: tuple[int, ...]) -> tuple[Floats, NDArray[np.bool_]]:
    kept = [
        np.unique(np.rint(np.linspace(0, size - 1, min(size, room))).astype(int))
        for size, room in zip(surface.assumed.shape, most, strict=True)
    ]
    at = np.ix_(*kept)
    return surface.xyz_mm[at], surface.assumed[at]


def _known(xyz: Floats, assumed: NDArray[np.bool_], slices: list[_Slice]) -> tuple[NDArray[np.uint8], Floats]:
    """Say of each vertex what it rests on, and the uncertainty of the measured point beside it, mm."""
    places = np.concatenate([one.xyz_mm[:, :2] for one in slices])
    seen = np.concatenate([one.seen for one in slices]).astype(np.bool_)
    std = np.concatenate([one.std_mm for one in slices])
    scale = np.array([_ALONG_STRIPE, 1.0])
    vertices = np.nan_to_num(xyz[..., :2].reshape(-1, 2))
    nearest = (((vertices[:, None] - places[None]) * scale) ** 2).sum(axis=2).argmin(axis=1)
    close = np.abs(vertices[:, 1] - places[nearest, 1]) <= _CLOSE_MM
    kind = np.where(seen[nearest] & close, SEEN, INTERPOLATED).reshape(assumed.shape)
    kind = np.where(assumed, ASSUMED, kind)
    kind[~np.isfinite(xyz[..., 2])] = VOID
    return kind.astype(np.uint8), np.where(kind <= INTERPOLATED, std[nearest].reshape(kind.shape), np.nan)


def _colours(xyz: Floats, product: Product | None, picture: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    """Give red, green and blue of the image where each vertex appears; black where it does not."""
    if picture is None or product is None or product.view is None:
        return np.zeros((*xyz.shape[:2], 3), np.uint8)
    import cv2

    place = np.nan_to_num(product.view.project(xyz), nan=-10.0).astype(np.float32)
    soft = cv2.GaussianBlur(picture, (5, 5), 0)
    found = cv2.remap(soft, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    top = max(float(np.percentile(found, 98)), _BRIGHT / _GAIN_MAX)
    return np.ascontiguousarray(np.clip(found[..., ::-1] * (_BRIGHT / top), 0, 255).astype(np.uint8))


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


def _still(grids: list[_Grid], slices: list[_Slice], low: Floats, high: Floats) -> Markup:
    view = _View(low, high)
    (x0, x1), (y0, y1) = _ends(low, high, 0), _ends(low, high, 1)
    belt = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    parts = [svg.path("solid-belt", _outline(view, belt) + "z")]
    cells = [cell for grid in grids for cell in _cells(grid)]
    for cell in sorted(cells, key=view.nearness):
        colour = palette.height_colour(float(cell[:, 2].mean() / high[2]))
        parts.append(svg.path("solid-cell", _outline(view, cell) + "z", fill=colour))
    parts += [svg.path("solid-line", _outline(view, one.xyz_mm)) for one in slices if not cells]
    label = (
        f"The surface over the belt, seen from the front and above: {plain(high[0] - low[0], 0)} by "
        f"{plain(high[1] - low[1], 0)} mm, {plain(high[2], 1)} mm high"
    )
    return svg.view(parts, (0, 0, _WIDTH, _HEIGHT), label, "still")


def _cells(grid: _Grid) -> Iterator[Floats]:
    """Give the quadrangles of a surface, coarsely."""
    xyz, _ = _thinned(Surface(grid.xyz_mm, grid.kind == ASSUMED), _STILL)
    for i in range(xyz.shape[0] - 1):
        for k in range(xyz.shape[1] - 1):
            cell = np.array([xyz[i, k], xyz[i, k + 1], xyz[i + 1, k + 1], xyz[i + 1, k]])
            if np.isfinite(cell).all():
                yield cell


def _outline(view: _View, xyz_mm: Floats) -> str:
    """Path data of points, to a tenth of a unit: a still picture needs no more."""
    across, upward = view.drawn(xyz_mm)
    return svg.polyline(np.round(across, 1), np.round(upward, 1))
