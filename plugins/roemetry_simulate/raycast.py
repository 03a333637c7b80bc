"""Where rays meet bodies: height fields, parts and triangles, with exact shadows.

Model. A ray o + t·d meets the belt z = 0, or a body within the box that holds it. A gridded body
(`GriddedSolid`) is where

    f(x, y, z) = (z − mid(x, y))² − u(x, y) ≤ 0,    u of the upper side above mid, of the lower one below

with mid and u bilinear in each cell. Along the ray f can fall no faster than the steepest slopes of mid and u
allow, so the march takes steps that cannot pass the surface, and ends in a bracket that false position and
bisection shrink to a tolerance. Bodies of exact parts and of triangles have closed forms (`products.parts`,
`products.mesh`). A point is lit, or seen, where nothing lies between it and the light or the camera and its
surface faces it.

Assumed: a body's `reach` holds all of it, and rays to the belt come from above. It fails where a gridded rim
is thinner than the least step of the march: a grazing ray may miss it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.products.mesh import hit_triangles, triangles_normal
from roemetry_simulate.products.parts import hit_parts, parts_normal
from roemetry_simulate.solid import FIELD, MISS, PARTS, Body, ExactBody, Fields, Reach, between_sides

Floats = NDArray[np.float64]

AnyBody = Body | ExactBody | Fields
Place = tuple[float, float, float]

_LEAST_STEP_MM = 0.02  # of the march, so that a grazing ray ends; a thinner rim may be missed


def _hit(body: AnyBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    """Stand for the hit of the body's own type, which the compiler chooses."""
    raise NotImplementedError


def _normal(body: AnyBody, point: Floats, normal: Floats) -> None:
    """Stand for the normal of the body's own type, which the compiler chooses."""
    raise NotImplementedError


@kernel
def hit_body(body: AnyBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    """Distance (mm) from o along the unit direction d to the body, or MISS."""
    return _hit(body, o, d, t_max, tol_mm)


def _hit_exact(body: ExactBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    if body.kind == PARTS:
        return hit_parts(body.surfaces, body.boxes[0], o, d, t_max)
    return hit_triangles(body.triangles, body.boxes, body.links, o, d, t_max)


def _hit_simple(body: Body, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    if body.kind == FIELD:
        # the parts it takes, not the whole: numba counts references of every array that is handed on
        place = (body.x0_mm, body.y0_mm, body.step_mm)
        bounds = (body.top_mm, body.mid_slope, body.u_slope_mm)
        return hit_field(body.grid, place, bounds, o, d, t_max, tol_mm)
    return MISS


def _hit_fields(body: Fields, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    """Distance along a unit direction to the nearest of several gridded bodies, or MISS."""
    best = MISS
    # the nearest of several: each only has to beat the best so far
    for k in range(body.places.shape[0]):
        p = body.places[k]
        place, bounds = (p[0], p[1], p[2]), (p[3], p[4], p[5])
        t = hit_field(_grid(body, k), place, bounds, o, d, t_max if best < 0.0 else best, tol_mm)
        if t >= 0.0 and (best < 0.0 or t < best):
            best = t
    return best


@overload(_hit, strict=False)
def _choose_hit(body: Any, o: Any, d: Any, t_max: Any, tol_mm: Any) -> Callable[..., float]:
    chosen: Callable[..., float] = _hit_simple
    if "surfaces" in body.fields:
        chosen = _hit_exact
    elif "places" in body.fields:
        chosen = _hit_fields
    return chosen


@kernel
def _may_meet(reach: Reach, o: Floats, d: Floats, t_max: float) -> bool:
    """Tell whether a ray passes the box that holds the body."""
    near, far = between_sides(reach, o, d, t_max)
    return near <= far


@kernel
def first_hit(body: AnyBody, reach: Reach, o: Floats, d: Floats, tol_mm: float, point: Floats) -> int:
    """Write the first point a ray from above meets; 1 the body, 0 the belt, -1 neither.

    `reach` is the body's own. Kernels take it out of the body once: numba counts references of every array
    that is handed on, and most rays never come near the body.
    """
    # where the belt would be met; upwards it never is
    t_belt = -o[2] / d[2] if d[2] < 0.0 else 1e300
    t = MISS
    # most rays miss the box: the belt needs no march
    if _may_meet(reach, o, d, t_belt):
        t = hit_body(body, o, d, t_belt, tol_mm)
    on = 1
    if t < 0.0:
        if d[2] >= 0.0:
            return -1
        t, on = t_belt, 0
    for k in range(3):
        point[k] = o[k] + t * d[k]
    if on == 0:
        # exactly on the belt, without rounding
        point[2] = 0.0
    return on


@kernel
def normal_at(body: AnyBody, on: int, point: Floats, normal: Floats) -> None:
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
    place = (body.x0_mm, body.y0_mm, body.step_mm)
    field_normal(body.grid, place, point, normal)


def _normal_fields(body: Fields, point: Floats, normal: Floats) -> None:
    """Write the outward unit normal of the gridded body on whose skin a point lies."""
    nearest, which = 1e300, 0
    for k in range(body.places.shape[0]):
        p = body.places[k]
        inside = True
        for m in range(2):
            size = (p[8 - m] - 1.0) * p[2]
            # grids may overlap in their extents though bodies do not
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


@overload(_normal, strict=False)
def _choose_normal(body: Any, point: Any, normal: Any) -> Callable[..., None]:
    chosen: Callable[..., None] = _normal_simple
    if "surfaces" in body.fields:
        chosen = _normal_exact
    elif "places" in body.fields:
        chosen = _normal_fields
    return chosen


@kernel
def sees(
    body: AnyBody, reach: Reach, point: Floats, normal: Floats, light: Floats, d: Floats, start: Floats
) -> float:
    """Cosine at which a point receives a light at a place, 0 where it is turned away or shadowed.

    `reach` is the body's own. `d` and `start` are scratch of shape (3,); `d` is left holding the unit
    direction to the light.
    """
    # from the surface towards the light
    length = 0.0
    for k in range(3):
        d[k] = light[k] - point[k]
        length += d[k] * d[k]
    length = math.sqrt(length)
    cosine = 0.0
    for k in range(3):
        d[k] /= length
        cosine += d[k] * normal[k]
    # turned away: no ray is needed
    if cosine <= 0.0:
        return 0.0
    for k in range(3):
        # a little off the surface, or it would shadow itself
        start[k] = point[k] + 1e-4 * normal[k]
    if not _may_meet(reach, start, d, length):
        return cosine
    return cosine if hit_body(body, start, d, length, 1e-3) < 0.0 else 0.0


@kernel
def field_value(grid: Floats, place: Place, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the implicit function of a gridded body (negative inside, mm²) and z - mid (mm)."""
    at_x, at_y = (x - place[0]) / place[2], (y - place[1]) / place[2]
    i = min(max(int(at_x), 0), grid.shape[1] - 2)
    j = min(max(int(at_y), 0), grid.shape[0] - 2)
    a, b = at_x - i, at_y - j
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    # bilinear weights of the cell's four nodes
    mid = (
        w00 * grid[j, i, 0] + w01 * grid[j, i + 1, 0] + w10 * grid[j + 1, i, 0] + w11 * grid[j + 1, i + 1, 0]
    )
    w = z - mid
    # above the mid-surface the upper square holds, below it the lower
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
        # false position twice, then a bisection: plain false position may creep from one side
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
    x_max = place[0] + (grid.shape[1] - 1) * place[2]
    y_max = place[1] + (grid.shape[0] - 1) * place[2]
    # the body's box without its border bounds the march
    near, far = between_sides((place[0], place[1], 0.0, x_max, y_max, bounds[0]), o, d, t_max)
    if near >= far:
        return MISS
    flat = math.sqrt(d[0] * d[0] + d[1] * d[1])
    # f = (z − mid)² − u: along the ray z − mid changes by at most `fall`, u by at most `side` a millimetre
    fall = abs(d[2]) + bounds[1] * flat
    side = bounds[2] * flat
    t = near
    f, w = field_value(grid, place, o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    # starts inside: hit at once
    if f <= 0.0:
        return t
    while t < far:
        b = 2.0 * abs(w) * fall + side
        # over a way t, f falls by at most b·t + fall²·t²; the step is shorter: b·t + 2·fall²·t² = f
        step = (math.sqrt(b * b + 8.0 * fall * fall * f) - b) / (4.0 * fall * fall)
        # a grazing ray would else never end
        t2 = min(t + max(step, _LEAST_STEP_MM), far)
        f2, w = field_value(grid, place, o[0] + t2 * d[0], o[1] + t2 * d[1], o[2] + t2 * d[2])
        if f2 <= 0.0:
            return _refine(grid, place, o, d, t, f, t2, f2, tol_mm)
        t, f = t2, f2
    return MISS


@kernel
# gradient of f: the cell's bilinear slopes, without the node's kinks
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
    # on the ridge line of a rim both vanish: upwards
    if length == 0.0:
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        return
    for k in range(3):
        normal[k] /= length


@kernel
def _grid(body: Fields, k: int) -> Floats:
    first, rows, columns = int(body.places[k, 6]), int(body.places[k, 7]), int(body.places[k, 8])
    return body.nodes[first : first + rows * columns].reshape((rows, columns, 3))
