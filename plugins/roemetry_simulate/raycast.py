"""First hits of rays on a body or the belt, in float64; kernels shared by rendering and truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.bodies import BOX, FIELD, PARTS, Body, ExactBody
from roemetry_simulate.products.parts import hit_parts, parts_normal
from roemetry_simulate.products.triangles import hit_triangles, triangles_normal

Floats = NDArray[np.float64]
Place = tuple[float, float, float]

MISS = -1.0
_LEAST_STEP_MM = 0.02


def _hit(body: Body | ExactBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    """Stand for the hit of the body's own type, which the compiler chooses."""
    raise NotImplementedError


def _normal(body: Body | ExactBody, point: Floats, normal: Floats) -> None:
    """Stand for the normal of the body's own type, which the compiler chooses."""
    raise NotImplementedError


@kernel
def sample(grid: Floats, at_x: float, at_y: float) -> tuple[float, float, float, int, int, float, float]:
    """Interpolate the three layers at a place in grid units; also its cell and the place within it."""
    i = min(max(int(at_x), 0), grid.shape[1] - 2)
    j = min(max(int(at_y), 0), grid.shape[0] - 2)
    a, b = at_x - i, at_y - j
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    p, q, r, s = grid[j, i], grid[j, i + 1], grid[j + 1, i], grid[j + 1, i + 1]
    mid = w00 * p[0] + w01 * q[0] + w10 * r[0] + w11 * s[0]
    top = w00 * p[1] + w01 * q[1] + w10 * r[1] + w11 * s[1]
    low = w00 * p[2] + w01 * q[2] + w10 * r[2] + w11 * s[2]
    return mid, top, low, i, j, a, b


@kernel
def field_value(grid: Floats, place: Place, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the implicit function of a gridded body (negative inside, mm²) and z - mid (mm)."""
    mid, top, low, _, _, _, _ = sample(grid, (x - place[0]) / place[2], (y - place[1]) / place[2])
    w = z - mid
    if w >= 0.0:
        return w * w - top, w
    return w * w - low, w


@kernel
def _hit_box(box: Floats, o: Floats, d: Floats, t_max: float) -> float:
    """Distance along the ray to a block; its far side if the ray starts inside."""
    c, s = math.cos(box[2]), math.sin(box[2])
    ox, oy = o[0] - box[0], o[1] - box[1]
    start = (c * ox + s * oy, c * oy - s * ox, o[2] - 0.5 * box[5])
    along = (c * d[0] + s * d[1], c * d[1] - s * d[0], d[2])
    half = (box[3], box[4], 0.5 * box[5])
    near, far = -1e300, 1e300
    for k in range(3):
        if along[k] == 0.0:
            if abs(start[k]) > half[k]:
                return MISS
            continue
        one = (-half[k] - start[k]) / along[k]
        two = (half[k] - start[k]) / along[k]
        near = max(near, min(one, two))
        far = min(far, max(one, two))
    if near > far or far < 0.0:
        return MISS
    t = near if near >= 0.0 else far
    return t if t <= t_max else MISS


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
def _hit_field(
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
def hit_body(body: Body | ExactBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    """Distance (mm) from o along the unit direction d to the body, or MISS."""
    return _hit(body, o, d, t_max, tol_mm)


def _hit_exact(body: ExactBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    if body.kind == PARTS:
        return hit_parts(body.surfaces, body.boxes[0], o, d, t_max)
    return hit_triangles(body.triangles, body.boxes, body.links, o, d, t_max)


def _hit_simple(body: Body, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    if body.kind == BOX:
        return _hit_box(body.box, o, d, t_max)
    if body.kind == FIELD:
        # the parts it takes, not the whole: numba counts references of every array that is handed on
        place = (body.x0_mm, body.y0_mm, body.step_mm)
        bounds = (body.top_mm, body.mid_slope, body.u_slope_mm)
        return _hit_field(body.grid, place, bounds, o, d, t_max, tol_mm)
    return MISS


@overload(_hit, strict=False)
def _choose_hit(body: Any, o: Any, d: Any, t_max: Any, tol_mm: Any) -> Callable[..., float]:
    exact: Callable[..., float] = _hit_exact
    return exact if "surfaces" in body.fields else _hit_simple


@kernel
def first_hit(body: Body | ExactBody, o: Floats, d: Floats, tol_mm: float, point: Floats) -> int:
    """Write the first point a ray from above meets; 1 the body, 0 the belt, -1 neither."""
    t_belt = -o[2] / d[2] if d[2] < 0.0 else 1e300
    t = hit_body(body, o, d, t_belt, tol_mm)
    on = 1
    if t < 0.0:
        if d[2] >= 0.0:
            return -1
        t, on = t_belt, 0
    for k in range(3):
        point[k] = o[k] + t * d[k]
    if on == 0:
        point[2] = 0.0
    return on


@kernel
def normal_at(body: Body | ExactBody, on: int, point: Floats, normal: Floats) -> None:
    """Write the outward unit normal at a hit."""
    normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
    if on == 1:
        _normal(body, point, normal)


def _normal_exact(body: ExactBody, point: Floats, normal: Floats) -> None:
    if body.kind == PARTS:
        parts_normal(body.surfaces, point, normal)
    else:
        triangles_normal(body.triangles, body.boxes, body.links, point, normal)


def _normal_simple(body: Body, point: Floats, normal: Floats) -> None:
    if body.kind == BOX:
        _box_normal(body.box, point, normal)
        return
    mid, _, _, i, j, a, b = sample(
        body.grid, (point[0] - body.x0_mm) / body.step_mm, (point[1] - body.y0_mm) / body.step_mm
    )
    w = point[2] - mid
    layer = 1 if w >= 0.0 else 2
    g = body.grid
    slope_x = np.empty(2)
    slope_y = np.empty(2)
    for k in range(2):
        m = 0 if k == 0 else layer
        slope_x[k] = (1 - b) * (g[j, i + 1, m] - g[j, i, m]) + b * (g[j + 1, i + 1, m] - g[j + 1, i, m])
        slope_y[k] = (1 - a) * (g[j + 1, i, m] - g[j, i, m]) + a * (g[j + 1, i + 1, m] - g[j, i + 1, m])
    normal[0] = -(2.0 * w * slope_x[0] + slope_x[1]) / body.step_mm
    normal[1] = -(2.0 * w * slope_y[0] + slope_y[1]) / body.step_mm
    normal[2] = 2.0 * w
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length == 0.0:
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        return
    for k in range(3):
        normal[k] /= length


@overload(_normal, strict=False)
def _choose_normal(body: Any, point: Any, normal: Any) -> Callable[..., None]:
    exact: Callable[..., None] = _normal_exact
    return exact if "surfaces" in body.fields else _normal_simple


@kernel
def _box_normal(box: Floats, point: Floats, normal: Floats) -> None:
    """Write the normal of the face a point lies on (the nearest)."""
    c, s = math.cos(box[2]), math.sin(box[2])
    px, py = point[0] - box[0], point[1] - box[1]
    along, across = c * px + s * py, c * py - s * px
    to_top = abs(box[5] - point[2])
    to_end, to_side = abs(box[3] - abs(along)), abs(box[4] - abs(across))
    if to_top <= to_end and to_top <= to_side:
        return
    normal[2] = 0.0
    if to_end <= to_side:
        sign = 1.0 if along > 0.0 else -1.0
        normal[0], normal[1] = sign * c, sign * s
    else:
        sign = 1.0 if across > 0.0 else -1.0
        normal[0], normal[1] = -sign * s, sign * c


@kernel
def sees(
    body: Body | ExactBody, point: Floats, normal: Floats, light: Floats, d: Floats, start: Floats
) -> float:
    """Cosine at which a point receives a light at a place, 0 where it is turned away or shadowed.

    `d` and `start` are scratch of shape (3,); `d` is left holding the unit direction to the light.
    """
    length = 0.0
    for k in range(3):
        d[k] = light[k] - point[k]
        length += d[k] * d[k]
    length = math.sqrt(length)
    cosine = 0.0
    for k in range(3):
        d[k] /= length
        cosine += d[k] * normal[k]
    if cosine <= 0.0:
        return 0.0
    for k in range(3):
        start[k] = point[k] + 1e-4 * normal[k]
    return cosine if hit_body(body, start, d, length, 1e-3) < 0.0 else 0.0
