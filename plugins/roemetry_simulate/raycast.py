"""First hits of rays on a body or the belt, in float64; kernels shared by rendering and truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.bodies import BOX, FIELD, PARTS, Body, ExactBody, Fields
from roemetry_simulate.fields import MISS, field_normal, fields_normal, hit_field, hit_fields
from roemetry_simulate.products.parts import hit_parts, parts_normal
from roemetry_simulate.products.triangles import hit_triangles, triangles_normal

Floats = NDArray[np.float64]

AnyBody = Body | ExactBody | Fields
Reach = tuple[float, float, float, float, float, float]


def _hit(body: AnyBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    """Stand for the hit of the body's own type, which the compiler chooses."""
    raise NotImplementedError


def _normal(body: AnyBody, point: Floats, normal: Floats) -> None:
    """Stand for the normal of the body's own type, which the compiler chooses."""
    raise NotImplementedError


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
def hit_body(body: AnyBody, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
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
        return hit_field(body.grid, place, bounds, o, d, t_max, tol_mm)
    return MISS


def _hit_several(body: Fields, o: Floats, d: Floats, t_max: float, tol_mm: float) -> float:
    return hit_fields(body, o, d, t_max, tol_mm)


@overload(_hit, strict=False)
def _choose_hit(body: Any, o: Any, d: Any, t_max: Any, tol_mm: Any) -> Callable[..., float]:
    chosen: Callable[..., float] = _hit_simple
    if "surfaces" in body.fields:
        chosen = _hit_exact
    elif "places" in body.fields:
        chosen = _hit_several
    return chosen


@kernel
def _may_meet(reach: Reach, o: Floats, d: Floats, t_max: float) -> bool:
    """Tell whether a ray passes the box that holds the body."""
    near, far = 0.0, t_max
    for k in range(3):
        if d[k] == 0.0:
            if o[k] < reach[k] or o[k] > reach[k + 3]:
                return False
            continue
        one, two = (reach[k] - o[k]) / d[k], (reach[k + 3] - o[k]) / d[k]
        near, far = max(near, min(one, two)), min(far, max(one, two))
    return near <= far


@kernel
def first_hit(body: AnyBody, o: Floats, d: Floats, tol_mm: float, point: Floats) -> int:
    """Write the first point a ray from above meets; 1 the body, 0 the belt, -1 neither."""
    return first_hit_in(body, body.reach, o, d, tol_mm, point)


@kernel
def first_hit_in(body: AnyBody, reach: Reach, o: Floats, d: Floats, tol_mm: float, point: Floats) -> int:
    """Do what `first_hit` does, faster: `reach` is the body's own.

    Kernels take it out of the body once: numba counts references of every array that is handed on, and most
    rays never come near the body.
    """
    t_belt = -o[2] / d[2] if d[2] < 0.0 else 1e300
    t = MISS
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
    if body.kind == BOX:
        _box_normal(body.box, point, normal)
        return
    place = (body.x0_mm, body.y0_mm, body.step_mm)
    field_normal(body.grid, place, point, normal)


def _normal_several(body: Fields, point: Floats, normal: Floats) -> None:
    fields_normal(body, point, normal)


@overload(_normal, strict=False)
def _choose_normal(body: Any, point: Any, normal: Any) -> Callable[..., None]:
    chosen: Callable[..., None] = _normal_simple
    if "surfaces" in body.fields:
        chosen = _normal_exact
    elif "places" in body.fields:
        chosen = _normal_several
    return chosen


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
def sees(body: AnyBody, point: Floats, normal: Floats, light: Floats, d: Floats, start: Floats) -> float:
    """Cosine at which a point receives a light at a place, 0 where it is turned away or shadowed.

    `d` and `start` are scratch of shape (3,); `d` is left holding the unit direction to the light.
    """
    return sees_in(body, body.reach, point, normal, light, d, start)


@kernel
def sees_in(
    body: AnyBody, reach: Reach, point: Floats, normal: Floats, light: Floats, d: Floats, start: Floats
) -> float:
    """Do what `sees` does, faster: `reach` is the body's own, taken out of it once."""
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
    if not _may_meet(reach, start, d, length):
        return cosine
    return cosine if hit_body(body, start, d, length, 1e-3) < 0.0 else 0.0
