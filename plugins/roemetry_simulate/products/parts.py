"""Bodies with exact surfaces: unions of convex parts, each bounded by planes and convex quadrics.

A surface is a row of eleven numbers: the part it bounds, then ten coefficients of

    g(x, y, z) = xx x² + yy y² + zz z² + xy x y + xz x z + yz y z + x x + y y + z z + constant

with g <= 0 inside; the rows of a part follow each other. A plane has zeros in the first six. A part is where
all its g <= 0; each is convex, so a line meets a part in one interval, whose ends are roots of quadratics:
all heights and hits are closed forms in float64. Parts may touch and overlap; the body is their union. The
belt is no surface of a body: parts that rest on it flat are bounded by z = 0 themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roemetry_kernels.compiling import kernel
from roemetry_simulate.products.family import Pose
from roemetry_simulate.solid import MISS, ExactBody, between_sides, exact_body

Floats = NDArray[np.float64]
Surface = tuple[float, float, float, float, float, float, float, float, float, float]

_PARALLEL = 1e-15  # coefficient of t² (or t) below which a surface is flat (or parallel) along a ray


def plane(normal: tuple[float, float, float], offset_mm: float) -> Surface:
    """Return the half-space n·X <= d as a surface."""
    return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *normal, -offset_mm)


def ball(x_mm: float, y_mm: float, z_mm: float, radius_mm: float) -> Surface:
    """Return a sphere as a surface."""
    constant = x_mm**2 + y_mm**2 + z_mm**2 - radius_mm**2
    return (1.0, 1.0, 1.0, 0.0, 0.0, 0.0, -2.0 * x_mm, -2.0 * y_mm, -2.0 * z_mm, constant)


def tube(y_mm: float, z_mm: float, radius_mm: float) -> Surface:
    """Return an endless cylinder along x as a surface."""
    constant = y_mm**2 + z_mm**2 - radius_mm**2
    return (0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, -2.0 * y_mm, -2.0 * z_mm, constant)


def box(x_mm: tuple[float, float], y_mm: tuple[float, float], z_mm: tuple[float, float]) -> list[Surface]:
    """Return the six planes of a box between the given limits."""
    return [
        plane((-1.0, 0.0, 0.0), -x_mm[0]),
        plane((1.0, 0.0, 0.0), x_mm[1]),
        plane((0.0, -1.0, 0.0), -y_mm[0]),
        plane((0.0, 1.0, 0.0), y_mm[1]),
        plane((0.0, 0.0, -1.0), -z_mm[0]),
        plane((0.0, 0.0, 1.0), z_mm[1]),
    ]


@dataclass(frozen=True, eq=False)
class PartsSolid:
    """A union of convex parts on the belt.

    - `surfaces`, shape (F, 11): Its surfaces in the belt frame, see the module.
    - `visible_volume_mm3`, `true_volume_mm3`, `footprint_mm2`: From closed forms of whoever made it.
    - `extent_mm`: Smallest and largest X, smallest and largest Y of the footprint.
    - `top_mm`: Height of the highest point.
    """

    surfaces: Floats
    visible_volume_mm3: float
    true_volume_mm3: float
    footprint_mm2: float
    extent_mm: tuple[float, float, float, float]
    top_mm: float

    def __post_init__(self) -> None:
        surfaces = np.ascontiguousarray(self.surfaces, dtype=np.float64)
        if surfaces.ndim != 2 or surfaces.shape[1] != 11 or not np.isfinite(surfaces).all():
            raise ValueError("surfaces must be finite, of shape (F, 11)")
        surfaces.flags.writeable = False
        object.__setattr__(self, "surfaces", surfaces)

    def body(self) -> ExactBody:
        """Return the kernels' form."""
        return exact_body(self.surfaces, self.extent_mm, self.top_mm)

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Highest and lowest Z over belt positions of one shape; NaN outside the footprint."""
        x, y = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(y_mm, dtype=np.float64))
        flat = np.ascontiguousarray(x).ravel(), np.ascontiguousarray(y).ravel()
        top, bottom = _vertical(self.surfaces, *flat)
        return top.reshape(x.shape), bottom.reshape(x.shape)

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y of the footprint, millimetres."""
        return self.extent_mm


def placed(parts: Sequence[Sequence[Surface]], pose: Pose) -> Floats:
    """Move parts from their own frame (origin on the belt, z up) onto the belt: surfaces, shape (F, 11)."""
    c, s = math.cos(math.radians(pose.yaw_deg)), math.sin(math.radians(pose.yaw_deg))
    # own = turn · belt + shift
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    shift = -turn @ np.array([pose.x_mm, pose.y_mm, 0.0])
    rows: list[list[float]] = []
    for number, surfaces in enumerate(parts):
        for xx, yy, zz, xy, xz, yz, *linear, constant in surfaces:
            # g = XᵀQX + l·X + k, with the mixed terms halved on both sides of Q
            square = np.array([[xx, xy / 2, xz / 2], [xy / 2, yy, yz / 2], [xz / 2, yz / 2, zz]])
            line = np.array(linear)
            q = turn.T @ square @ turn
            # X = turn · belt + shift, put into g
            b = turn.T @ (2.0 * square @ shift + line)
            k = shift @ square @ shift + line @ shift + constant
            upper = [q[0, 0], q[1, 1], q[2, 2], 2 * q[0, 1], 2 * q[0, 2], 2 * q[1, 2]]
            rows.append([float(number), *upper, *b, k])
    return np.array(rows, dtype=np.float64)


@kernel
def _span(f: Floats, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> tuple[float, float]:
    """Interval of t where a line is inside a surface; (1, -1) where it is nowhere."""
    a = (
        f[1] * dx * dx + f[2] * dy * dy + f[3] * dz * dz
        + f[4] * dx * dy + f[5] * dx * dz + f[6] * dy * dz
    )  # fmt: skip
    b = (
        2.0 * (f[1] * ox * dx + f[2] * oy * dy + f[3] * oz * dz)
        + f[4] * (ox * dy + oy * dx) + f[5] * (ox * dz + oz * dx) + f[6] * (oy * dz + oz * dy)
        + f[7] * dx + f[8] * dy + f[9] * dz
    )  # fmt: skip
    c = _value(f, ox, oy, oz)
    # coefficients of g along the line: a t² + b t + c
    if a > _PARALLEL:
        # b² < 4 a c: the line passes beside
        root = b * b - 4.0 * a * c
        if root < 0.0:
            return 1.0, -1.0
        # the root that does not cancel, the other from c / q
        q = -0.5 * (b + math.copysign(math.sqrt(root), b))
        if q == 0.0:
            return 0.0, 0.0
        one, two = q / a, c / q
        return min(one, two), max(one, two)
    # flat along the line: a half-line, or all or nothing
    if abs(b) <= _PARALLEL:
        return (-1e300, 1e300) if c <= 0.0 else (1.0, -1.0)
    if b > 0.0:
        return -1e300, -c / b
    return -c / b, 1e300


@kernel
def _value(f: Floats, x: float, y: float, z: float) -> float:
    """Return g at a point."""
    return (
        x * (f[1] * x + f[4] * y + f[5] * z + f[7])
        + y * (f[2] * y + f[6] * z + f[8]) + z * (f[3] * z + f[9]) + f[10]
    )  # fmt: skip


@kernel
def _vertical(surfaces: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Highest and lowest point of the body on vertical lines, shape of x; NaN where there is none."""
    top, bottom = np.full(x.size, np.nan), np.full(x.size, np.nan)
    for k in range(x.size):
        i = 0
        while i < surfaces.shape[0]:
            part = surfaces[i, 0]
            # a convex part meets a line in one interval: the intersection of its surfaces' own
            low, high = -1e300, 1e300
            while i < surfaces.shape[0] and surfaces[i, 0] == part:
                near, far = _span(surfaces[i], x[k], y[k], 0.0, 0.0, 0.0, 1.0)
                low, high = max(low, near), min(high, far)
                i += 1
            if low <= high:
                # union of parts: the highest and the lowest of all
                top[k] = high if not top[k] >= high else top[k]
                bottom[k] = low if not bottom[k] <= low else bottom[k]
    return top, bottom


@kernel
def hit_parts(surfaces: Floats, bounds: Floats, o: Floats, d: Floats, t_max: float) -> float:
    """Distance (mm) along the ray, within t_max, to a body of parts, or MISS.

    The far side of a part that the ray starts in. `bounds` holds smallest x, y, z, largest x, y, z.
    """
    near, far = between_sides(bounds, o, d, t_max)
    if near > far:
        return MISS
    best = MISS
    i = 0
    while i < surfaces.shape[0]:
        part = surfaces[i, 0]
        low, high = -1e300, 1e300
        while i < surfaces.shape[0] and surfaces[i, 0] == part:
            if low <= high:
                near, far = _span(surfaces[i], o[0], o[1], o[2], d[0], d[1], d[2])
                low, high = max(low, near), min(high, far)
            i += 1
        if low > high or high < 0.0:
            continue
        # from inside, the far side is the hit
        t = low if low >= 0.0 else high
        if t <= t_max and (best < 0.0 or t < best):
            best = t
    return best


@kernel
def parts_normal(surfaces: Floats, point: Floats, normal: Floats) -> None:
    """Write the outward unit normal of the surface that a point of the body's skin lies on."""
    x, y, z = point[0], point[1], point[2]
    nearest = 1e300
    i = 0
    while i < surfaces.shape[0]:
        part = surfaces[i, 0]
        most, nx, ny, nz = -1e300, 0.0, 0.0, 1.0
        while i < surfaces.shape[0] and surfaces[i, 0] == part:
            f = surfaces[i]
            gx = 2.0 * f[1] * x + f[4] * y + f[5] * z + f[7]
            gy = 2.0 * f[2] * y + f[4] * x + f[6] * z + f[8]
            gz = 2.0 * f[3] * z + f[5] * x + f[6] * y + f[9]
            length = math.sqrt(gx * gx + gy * gy + gz * gz)
            # the surface that bounds the part most tightly here is the one the point lies on
            away = _value(f, x, y, z) / max(length, 1e-300)
            if away > most:
                most, nx, ny, nz = away, gx / length, gy / length, gz / length
            i += 1
        if abs(most) < nearest:
            nearest = abs(most)
            normal[0], normal[1], normal[2] = nx, ny, nz
