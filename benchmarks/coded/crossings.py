"""Every place where a light plane crosses the middle of an image row, lit and seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roemetry_simulate.optics import Camera, LaserFan, camera_ray
from roemetry_simulate.raycast import first_hit, normal_at, sees
from roemetry_simulate.solid import Body, Solid

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

STEP_PX = 0.5
"""Pitch at which rows are searched; what is thinner between two jumps of depth is missed, as by a camera."""
_COARSE_PX = 8.0
"""The same where the belt is bare: there each plane is met once."""


class Crossings(NamedTuple):
    """All crossings, sorted by row, then by x; a stripe may have several in a row."""

    row: Integers
    stripe: Integers
    """row, stripe: (crossing,) image row, and stripe from 0, left to right."""
    x_px: Floats
    """(crossing,) sub-pixel place in the row."""
    xyz_mm: Floats
    """(crossing, 3) the point in the belt frame."""
    on_product: NDArray[np.bool_]
    """(crossing,) True on a product, False on the belt."""
    cosine: Floats
    """(crossing,) of the angle between the surface's normal and the light."""
    mm_per_px: Floats
    """(crossing,) by how much the distance to the light plane changes along the row."""


def crossings_of(camera: Camera, laser: LaserFan, solid: Solid) -> Crossings:
    """Find all crossings of a scene."""
    planes = np.column_stack([laser.normals, laser.offsets_mm])
    found, numbers = _search(
        solid.body(), camera.packed(), camera.rotation, laser.projector_mm, planes,
        camera.height_px, camera.width_px, _where(camera, solid),
    )  # fmt: skip
    order = np.lexsort((found[:, 0], numbers[:, 0]))
    found, numbers = found[order], numbers[order]
    return Crossings(
        numbers[:, 0].copy(),
        numbers[:, 1].copy(),
        found[:, 0].copy(),
        found[:, 1:4].copy(),
        numbers[:, 2] == 1,
        found[:, 4].copy(),
        found[:, 5].copy(),
    )


def _where(camera: Camera, solid: Solid) -> Floats:
    """First and last row, first and last column in which the body may be seen; beside it the belt is bare."""
    extent = np.array(solid.footprint_extent_mm())
    if np.isnan(extent).any():
        return np.array([1.0, 0.0, 1.0, 0.0])
    x_mm, y_mm = [extent[0] - 1.0, extent[1] + 1.0], [extent[2] - 1.0, extent[3] + 1.0]
    x, y, z = np.meshgrid(x_mm, y_mm, [0.0, solid.body().top_mm])
    seen = camera.project(np.column_stack([x.ravel(), y.ravel(), z.ravel()]))
    low, high = seen.min(axis=0) - 3.0, seen.max(axis=0) + 3.0
    return np.array([low[1], high[1], low[0], high[0]])


@njit(cache=True, nogil=True)
def _distance(
    body: Body, pinhole: Floats, rotation: Floats, plane: Floats, x_px: float, y_px: float, view: Floats,
    point: Floats, tol_mm: float,
) -> tuple[float, int]:  # fmt: skip
    """Signed distance from the plane to what the camera sees at an image point; and on what it lies."""
    camera_ray(pinhole, rotation, x_px, y_px, view)
    on = first_hit(body, pinhole[:3], view, tol_mm, point)
    if on < 0:
        return np.nan, on
    return plane[0] * point[0] + plane[1] * point[1] + plane[2] * point[2] - plane[3], on


@njit(cache=True, nogil=True)
def _places(places: Floats, columns: int, where: Floats, dense: bool) -> int:
    """Fill in where a row is looked at: finely where the body may be, coarsely where the belt is bare."""
    filled, x_px = 0, -0.5
    while x_px < columns - 0.5:
        places[filled] = x_px
        filled += 1
        fine = dense and where[2] - _COARSE_PX <= x_px <= where[3]
        x_px += STEP_PX if fine else _COARSE_PX
    places[filled] = columns - 0.5
    return filled + 1


@njit(cache=True, nogil=True)
def _search(
    body: Body, pinhole: Floats, rotation: Floats, projector: Floats, planes: Floats, rows: int, columns: int,
    where: Floats,
) -> tuple[Floats, Integers]:  # fmt: skip
    count = planes.shape[0]
    space = 6 * count * rows
    found, numbers = np.empty((space, 6)), np.empty((space, 3), np.int64)
    filled = 0
    point, normal, view = np.zeros(3), np.zeros(3), np.zeros(3)
    beam, scratch = np.zeros(3), np.zeros(3)
    before, now = np.empty(count), np.empty(count)
    places = np.empty(int(columns / STEP_PX) + columns + 2)
    for row in range(rows):
        steps = _places(places, columns, where, where[0] <= row <= where[1])
        for k in range(steps):
            camera_ray(pinhole, rotation, places[k], float(row), view)
            on = first_hit(body, pinhole[:3], view, 1e-3, point)
            for i in range(count):
                now[i] = np.nan
                if on >= 0:
                    now[i] = -planes[i, 3]
                    for m in range(3):
                        now[i] += planes[i, m] * point[m]
            for i in range(count):
                if k == 0 or (before[i] <= 0.0) == (now[i] <= 0.0):
                    continue
                low, high, f_low, f_high = places[k - 1], places[k], before[i], now[i]
                x_px, f, on_here = low, np.inf, -1
                for turn in range(60):
                    share = f_low / (f_low - f_high) if turn % 3 < 2 else 0.5
                    if not 0.01 < share < 0.99:  # NaN, too
                        share = 0.5
                    x_px = low + share * (high - low)
                    f, on_here = _distance(body, pinhole, rotation, planes[i], x_px, row, view, point, 1e-9)
                    if abs(f) < 1e-9 or high - low < 1e-6:
                        break
                    if (f <= 0.0) == (before[i] <= 0.0):
                        low, f_low = x_px, f
                    else:
                        high, f_high = x_px, f
                if not abs(f) < 1e-3 or x_px > columns - 0.5 or filled == space:
                    continue  # a jump from one surface to another, not a crossing
                normal_at(body, on_here, point, normal)
                cosine = sees(body, point, normal, projector, beam, scratch)
                if cosine == 0.0:
                    continue
                numbers[filled, 0], numbers[filled, 1], numbers[filled, 2] = row, i, on_here
                found[filled, 0] = x_px
                for m in range(3):
                    found[filled, 1 + m] = point[m]
                found[filled, 4] = cosine
                found[filled, 5] = abs(now[i] - before[i]) / (places[k] - places[k - 1])
                filled += 1
            for i in range(count):
                before[i] = now[i]
    return found[:filled], numbers[:filled]
