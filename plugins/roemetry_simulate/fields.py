"""Hits on bodies given on grids, one or several, by marching; their normals."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.bodies import Fields

Floats = NDArray[np.float64]
Place = tuple[float, float, float]

MISS = -1.0
_LEAST_STEP_MM = 0.02


@kernel
def field_value(grid: Floats, place: Place, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the implicit function of a gridded body (negative inside, mm²) and z - mid (mm)."""
    at_x, at_y = (x - place[0]) / place[2], (y - place[1]) / place[2]
    i = min(max(int(at_x), 0), grid.shape[1] - 2)
    j = min(max(int(at_y), 0), grid.shape[0] - 2)
    a, b = at_x - i, at_y - j
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    mid = (
        w00 * grid[j, i, 0] + w01 * grid[j, i + 1, 0] + w10 * grid[j + 1, i, 0] + w11 * grid[j + 1, i + 1, 0]
    )
    w = z - mid
    m = 1 if w >= 0.0 else 2
    u = w00 * grid[j, i, m] + w01 * grid[j, i + 1, m] + w10 * grid[j + 1, i, m] + w11 * grid[j + 1, i + 1, m]
    return w * w - u, w


@kernel
def _refine(
    grid: Floats, place: Place, o: Floats, d: Floats, t: float, f: float, t2: float, f2: float, tol_mm: float
) -> float:
    """Shrink a bracket (f > 0 at t, f2 <= 0 at t2) by false position that cannot stall, then bisection."""
    for k in range(200):
        if t2 - t <= tol_mm:
            break
        share = f / (f - f2) if k % 3 < 2 else 0.5
        share = min(max(share, 0.02), 0.98)
        middle = t + share * (t2 - t)
        if middle <= t or middle >= t2:
            break
        g, _ = field_value(grid, place, o[0] + middle * d[0], o[1] + middle * d[1], o[2] + middle * d[2])
        if g > 0.0:
            t, f = middle, g
        else:
            t2, f2 = middle, g
    return t + (t2 - t) * f / (f - f2)


@kernel
def hit_field(
    grid: Floats, place: Place, bounds: Place, o: Floats, d: Floats, t_max: float, tol_mm: float
) -> float:
    """March along a unit direction by steps that cannot overshoot the surface, then refine."""
    size = ((grid.shape[1] - 1) * place[2], (grid.shape[0] - 1) * place[2], bounds[0])
    corner = (place[0], place[1], 0.0)
    near, far = 0.0, t_max
    for k in range(3):
        if d[k] == 0.0:
            if o[k] < corner[k] or o[k] > corner[k] + size[k]:
                return MISS
            continue
        one = (corner[k] - o[k]) / d[k]
        two = (corner[k] + size[k] - o[k]) / d[k]
        near = max(near, min(one, two))
        far = min(far, max(one, two))
    if near >= far:
        return MISS
    flat = math.sqrt(d[0] * d[0] + d[1] * d[1])
    fall = abs(d[2]) + bounds[1] * flat
    side = bounds[2] * flat
    t = near
    f, w = field_value(grid, place, o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    if f <= 0.0:
        return t
    while t < far:
        b = 2.0 * abs(w) * fall + side
        step = (math.sqrt(b * b + 8.0 * fall * fall * f) - b) / (4.0 * fall * fall)
        t2 = min(t + max(step, _LEAST_STEP_MM), far)
        f2, w = field_value(grid, place, o[0] + t2 * d[0], o[1] + t2 * d[1], o[2] + t2 * d[2])
        if f2 <= 0.0:
            return _refine(grid, place, o, d, t, f, t2, f2, tol_mm)
        t, f = t2, f2
    return MISS


@kernel
def field_normal(grid: Floats, place: Place, point: Floats, normal: Floats) -> None:
    """Write the outward unit normal of a gridded body at a point of its skin."""
    at_x, at_y = (point[0] - place[0]) / place[2], (point[1] - place[1]) / place[2]
    i = min(max(int(at_x), 0), grid.shape[1] - 2)
    j = min(max(int(at_y), 0), grid.shape[0] - 2)
    a, b = at_x - i, at_y - j
    _, w = field_value(grid, place, point[0], point[1], point[2])
    layer = 1 if w >= 0.0 else 2
    slope_x = np.empty(2)
    slope_y = np.empty(2)
    for k in range(2):
        m = 0 if k == 0 else layer
        slope_x[k] = (1 - b) * (grid[j, i + 1, m] - grid[j, i, m]) + b * (
            grid[j + 1, i + 1, m] - grid[j + 1, i, m]
        )
        slope_y[k] = (1 - a) * (grid[j + 1, i, m] - grid[j, i, m]) + a * (
            grid[j + 1, i + 1, m] - grid[j, i + 1, m]
        )
    normal[0] = -(2.0 * w * slope_x[0] + slope_x[1]) / place[2]
    normal[1] = -(2.0 * w * slope_y[0] + slope_y[1]) / place[2]
    normal[2] = 2.0 * w
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length == 0.0:
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        return
    for k in range(3):
        normal[k] /= length


@kernel
def hit_fields(body: Fields, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    """Distance along a unit direction to the nearest of several gridded bodies, or MISS."""
    best = MISS
    for k in range(body.places.shape[0]):
        p = body.places[k]
        place, bounds = (p[0], p[1], p[2]), (p[3], p[4], p[5])
        t = hit_field(_grid(body, k), place, bounds, o, d, t_max if best < 0.0 else best, tol_mm)
        if t >= 0.0 and (best < 0.0 or t < best):
            best = t
    return best


@kernel
def fields_normal(body: Fields, point: Floats, normal: Floats) -> None:
    """Write the outward unit normal of the gridded body on whose skin a point lies."""
    nearest, which = 1e300, 0
    for k in range(body.places.shape[0]):
        p = body.places[k]
        inside = True
        for m in range(2):
            size = (p[8 - m] - 1.0) * p[2]
            inside = inside and p[m] <= point[m] <= p[m] + size
        if not inside:
            continue
        f, w = field_value(_grid(body, k), (p[0], p[1], p[2]), point[0], point[1], point[2])
        # f is a square; the distance it stands for is about f over twice the height over the rim
        away = abs(f) / max(2.0 * abs(w), 1e-3)
        if away < nearest:
            nearest, which = away, k
    p = body.places[which]
    field_normal(_grid(body, which), (p[0], p[1], p[2]), point, normal)


@kernel
def _grid(body: Fields, k: int) -> Floats:
    first, rows, columns = int(body.places[k, 6]), int(body.places[k, 7]), int(body.places[k, 8])
    return body.nodes[first : first + rows * columns].reshape((rows, columns, 3))
