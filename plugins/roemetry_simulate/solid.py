"""Solids on the belt: height fields with their truth, packed for the ray caster.

Model. A gridded body lies between two surfaces about a mid-surface: z = mid(x, y) ± √u(x, y), with u_top
above and u_bottom below, all three bilinear between the nodes of a square grid. The squares u fall linearly
through 0 at the outline, so the rim is round as an ellipse's, and its place is exact between nodes. Volumes
and footprint are integrals of that very body: in closed form along X, where √u of a linear u has one, and by
four Gauss points along Y in each cell.

Assumed: over each place of the belt the body is one piece, from a bottom to a top. Overhangs, holes and exact
edges are for `ExactBody` (parts and meshes).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roemetry_kernels.compiling import kernel

Floats = NDArray[np.float64]

Reach = tuple[float, float, float, float, float, float]

NOTHING, FIELD, PARTS, MESH, FIELDS = 0, 1, 2, 3, 4  # kinds of bodies, for the kernels
MISS = -1.0  # distance of a ray that meets nothing

NOWHERE: Reach = (0.0, 0.0, -2.0, 0.0, 0.0, -1.0)
"""A box below the belt, where no ray comes."""


def no_array(*shape: int, dtype: type[np.generic] = np.float64) -> NDArray[Any]:
    """Stand in for a member of a body that does not count."""
    nothing = np.zeros(shape, dtype=dtype)
    nothing.flags.writeable = False
    return nothing


class Body(NamedTuple):
    """Nothing, or a gridded body (FIELD, which takes all members), in the form the kernels take.

    `reach` is a box that holds all of it: smallest x, y, z, largest x, y, z. `top_mm` is at or over the
    highest point. All arrays are read-only, so that the kernels are compiled once.
    """

    kind: int
    reach: Reach = NOWHERE
    grid: Floats = no_array(2, 2, 3)
    x0_mm: float = 0.0
    y0_mm: float = 0.0
    step_mm: float = 1.0
    top_mm: float = 0.0
    mid_slope: float = 0.0
    u_slope_mm: float = 0.0


class ExactBody(NamedTuple):
    """A body of exact surfaces in the form the kernels take.

    PARTS takes `surfaces` (see `roemetry_simulate.products.parts`); MESH takes `triangles`, `boxes` and
    `links` (see `roemetry_simulate.products.mesh`). It is a type of its own since every array that a
    kernel hands on costs time; the kernels are compiled for both.
    """

    kind: int
    reach: Reach
    top_mm: float
    surfaces: Floats = no_array(1, 11)
    triangles: Floats = no_array(1, 9)
    boxes: Floats = no_array(1, 6)
    links: NDArray[np.int64] = no_array(1, 3, dtype=np.int64)


def exact_body(surfaces: Floats, extent_mm: tuple[float, float, float, float], top_mm: float) -> ExactBody:
    """Return the kernels' form of surfaces (F, 11), read-only, over a footprint's extent."""
    x_min, x_max, y_min, y_max = extent_mm
    bounds = np.array([[x_min, y_min, 0.0, x_max, y_max, top_mm]])
    # against rounding of rays that graze a side
    bounds += np.array([-1e-6, -1e-6, -1e-6, 1e-6, 1e-6, 1e-6])
    bounds.flags.writeable = False
    return ExactBody(PARTS, tuple(bounds[0].tolist()), float(top_mm), surfaces=surfaces, boxes=bounds)


@kernel
def between_sides(box: Any, o: Floats, d: Floats, t_max: float) -> tuple[float, float]:
    """Give where a ray enters and leaves a box (as `Body.reach`), within 0 and t_max; (1, -1): nowhere."""
    near, far = 0.0, t_max
    for k in range(3):
        # level along this axis: inside the two sides or never
        if d[k] == 0.0:
            if o[k] < box[k] or o[k] > box[k + 3]:
                return 1.0, -1.0
            continue
        one, two = (box[k] - o[k]) / d[k], (box[k + 3] - o[k]) / d[k]
        # within all pairs of sides at once
        near, far = max(near, min(one, two)), min(far, max(one, two))
    return near, far


class Fields(NamedTuple):
    """Several gridded bodies in the form the kernels take.

    `nodes` (n, 3) holds the nodes of all grids, one grid after the other, row by row; a row of `places` says
    of one of them: x0, y0, step, highest point, steepest slope of mid and of u (see `Body`), its first node,
    its rows and its columns.
    """

    kind: int
    reach: Reach
    top_mm: float
    nodes: Floats
    places: Floats


class Solid(Protocol):
    """Anything that can lie on the belt."""

    def body(self) -> Body | ExactBody | Fields:
        """Return the kernels' form."""
        ...

    @property
    def visible_volume_mm3(self) -> float:
        """Integral of the top surface's height over the footprint."""
        ...

    @property
    def true_volume_mm3(self) -> float:
        """Volume of the closed body."""
        ...

    @property
    def footprint_mm2(self) -> float:
        """Area of the vertical footprint on the belt."""
        ...

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Highest and lowest Z of the body over belt positions of one shape; NaN outside the footprint.

        What lies between them need not all be body: air under an overhang, or below a ball bar's rod,
        counts as filled in the visible volume and not in the true one.
        """
        ...

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y of the footprint, millimetres."""
        ...


@dataclass(frozen=True)
class EmptyBelt:
    """Nothing on the belt."""

    visible_volume_mm3: float = 0.0
    true_volume_mm3: float = 0.0
    footprint_mm2: float = 0.0

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Return NaN everywhere."""
        x, _ = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(y_mm, dtype=np.float64))
        return np.full(x.shape, np.nan), np.full(x.shape, np.nan)

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Return NaN four times: there is no footprint."""
        return np.nan, np.nan, np.nan, np.nan

    def body(self) -> Body:
        """Return the kernels' form."""
        return Body(NOTHING)


@dataclass(frozen=True)
class Block:
    """A rectangular block on the belt, exact.

    - `length_mm`, `width_mm`, `height_mm`: Sides along its own x, its own y, and Z.
    - `centre_x_mm`, `centre_y_mm`: Centre of its footprint, belt frame.
    - `yaw_deg`: Its own x axis turned from belt X, counter-clockwise seen from above.
    """

    length_mm: float
    width_mm: float
    height_mm: float
    centre_x_mm: float = 0.0
    centre_y_mm: float = 0.0
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        if min(self.length_mm, self.width_mm, self.height_mm) <= 0.0:
            raise ValueError("a block needs three positive sides")

    @property
    def visible_volume_mm3(self) -> float:
        """Integral of the top surface's height over the footprint."""
        return self.length_mm * self.width_mm * self.height_mm

    @property
    def true_volume_mm3(self) -> float:
        """Volume of the closed body."""
        return self.visible_volume_mm3

    @property
    def footprint_mm2(self) -> float:
        """Area of the vertical footprint on the belt."""
        return self.length_mm * self.width_mm

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Highest and lowest Z over belt positions of one shape; NaN outside the footprint."""
        c, s = np.cos(np.deg2rad(self.yaw_deg)), np.sin(np.deg2rad(self.yaw_deg))
        x = np.asarray(x_mm, dtype=np.float64) - self.centre_x_mm
        y = np.asarray(y_mm, dtype=np.float64) - self.centre_y_mm
        along, across = np.abs(c * x + s * y), np.abs(c * y - s * x)
        inside = (along <= 0.5 * self.length_mm) & (across <= 0.5 * self.width_mm)
        return np.where(inside, self.height_mm, np.nan), np.where(inside, 0.0, np.nan)

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y of the footprint, millimetres."""
        c, s = abs(np.cos(np.deg2rad(self.yaw_deg))), abs(np.sin(np.deg2rad(self.yaw_deg)))
        half_x = 0.5 * (c * self.length_mm + s * self.width_mm)
        half_y = 0.5 * (s * self.length_mm + c * self.width_mm)
        x, y = self.centre_x_mm, self.centre_y_mm
        return float(x - half_x), float(x + half_x), float(y - half_y), float(y + half_y)

    def body(self) -> ExactBody:
        """Return the kernels' form: six planes."""
        c, s = np.cos(np.deg2rad(self.yaw_deg)), np.sin(np.deg2rad(self.yaw_deg))
        own = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        normals = np.concatenate([-own, own])
        half = 0.5 * self.length_mm, 0.5 * self.width_mm
        offsets = np.array([*half, 0.0, *half, self.height_mm])
        offsets += normals @ np.array([self.centre_x_mm, self.centre_y_mm, 0.0])
        surfaces = np.column_stack([np.zeros((6, 7)), normals, -offsets])
        surfaces.flags.writeable = False
        return exact_body(surfaces, self.footprint_extent_mm(), self.height_mm)


@dataclass(frozen=True, eq=False)
class GriddedSolid:
    """A body with a rounded rim, on a regular grid.

    - `x0_mm`, `y0_mm`, `step_mm`: Belt position of node (0, 0) and the pitch of the square grid.
    - `grid`, shape (rows along Y, columns along X, 3): mid (mm), u_top (mm²), u_bottom (mm²); the two u are
      negative outside the footprint. The border nodes lie outside the footprint.
    """

    x0_mm: float
    y0_mm: float
    step_mm: float
    grid: Floats
    _volumes: tuple[float, float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        grid = np.ascontiguousarray(self.grid, dtype=np.float64)
        if grid.ndim != 3 or grid.shape[2] != 3 or min(grid.shape[:2]) < 3:
            raise ValueError(f"the grid must have shape (rows, columns, 3), not {grid.shape}")
        if not np.isfinite(grid).all():
            raise ValueError("the grid holds NaN or infinity")
        border = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
        if border[:, 1].max() > 0.0:
            raise ValueError("the body reaches the border of its grid")
        grid.flags.writeable = False
        object.__setattr__(self, "grid", grid)
        object.__setattr__(self, "_volumes", tuple(_integrals(grid, float(self.step_mm))))

    @property
    def visible_volume_mm3(self) -> float:
        """Integral of the top surface's height over the footprint."""
        return self._volumes[0]

    @property
    def true_volume_mm3(self) -> float:
        """Volume of the closed body."""
        return self._volumes[1]

    @property
    def footprint_mm2(self) -> float:
        """Area of the vertical footprint on the belt."""
        return self._volumes[2]

    def body(self) -> Body:
        """Return the kernels' form."""
        mid, u = self.grid[..., 0], self.grid[..., 1:]
        inside = self.grid[..., 1] > 0.0
        # highest point of the mid-surface plus the root of the upper square
        top = float((mid + np.sqrt(np.maximum(u[..., 0], 0.0)))[inside].max()) if inside.any() else 0.0
        place = float(self.x0_mm), float(self.y0_mm), float(self.step_mm)
        slopes = _steepest(mid[..., None], self.step_mm), _steepest(u, self.step_mm)
        x_max = place[0] + (self.grid.shape[1] - 1) * place[2]
        y_max = place[1] + (self.grid.shape[0] - 1) * place[2]
        reach = (place[0], place[1], 0.0, x_max, y_max, top + 0.01)
        return Body(FIELD, reach, self.grid, *place, top + 0.01, *slopes)

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Highest and lowest Z over belt positions of one shape; NaN outside the footprint."""
        x, y = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(y_mm, dtype=np.float64))
        rows, columns = self.grid.shape[:2]
        at_x, at_y = (x - self.x0_mm) / self.step_mm, (y - self.y0_mm) / self.step_mm
        known = (at_x >= 0) & (at_y >= 0) & (at_x <= columns - 1) & (at_y <= rows - 1)
        i = np.clip(np.nan_to_num(at_x).astype(int), 0, columns - 2)
        j = np.clip(np.nan_to_num(at_y).astype(int), 0, rows - 2)
        a, b = (at_x - i)[..., None], (at_y - j)[..., None]
        low = self.grid[j, i] * (1 - a) + self.grid[j, i + 1] * a
        high = self.grid[j + 1, i] * (1 - a) + self.grid[j + 1, i + 1] * a
        mid, u_top, u_bottom = np.moveaxis(low * (1 - b) + high * b, -1, 0)
        inside = known & (u_top > 0.0)
        top = np.where(inside, mid + np.sqrt(np.maximum(u_top, 0.0)), np.nan)
        bottom = np.where(inside, mid - np.sqrt(np.maximum(u_bottom, 0.0)), np.nan)
        return top, bottom

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y of the footprint, to a grid step, millimetres."""
        inside = self.grid[..., 1] > 0.0
        columns, rows = np.flatnonzero(inside.any(axis=0)), np.flatnonzero(inside.any(axis=1))
        x = self.x0_mm + self.step_mm * columns[[0, -1]]
        y = self.y0_mm + self.step_mm * rows[[0, -1]]
        return float(x[0]), float(x[1]), float(y[0]), float(y[1])


def _steepest(layers: Floats, step_mm: float) -> float:
    """Return a bound of the gradient's length of bilinear layers (rows, columns, k)."""
    # bilinear: the largest difference along each axis bounds the gradient
    along_x = np.abs(np.diff(layers, axis=1)).max()
    along_y = np.abs(np.diff(layers, axis=0)).max()
    return float(np.hypot(along_x, along_y) / step_mm)


@kernel
def _root_integral(u_left: float, u_right: float) -> tuple[float, float, float]:
    """Integrate over a in [0, 1] where u(a), linear, is positive: sqrt(u), 1 and a."""
    if u_left <= 0.0 and u_right <= 0.0:
        return 0.0, 0.0, 0.0
    start, end = 0.0, 1.0
    if u_left < 0.0:
        start = u_left / (u_left - u_right)
    if u_right < 0.0:
        end = u_left / (u_left - u_right)
    from_u, to_u = np.sqrt(max(u_left, 0.0)), np.sqrt(max(u_right, 0.0))
    # the mean of sqrt over a linear ramp, in the form that survives equal ends
    root = 2.0 / 3.0 * (from_u * from_u + from_u * to_u + to_u * to_u) / (from_u + to_u)
    return root * (end - start), end - start, 0.5 * (end * end - start * start)


@kernel
def _integrals(grid: Floats, step_mm: float) -> tuple[float, float, float]:
    """Visible volume, true volume (mm³) and footprint (mm²): closed form along X, Gauss points along Y."""
    nodes = (0.069431844202973712, 0.330009478207571868, 0.669990521792428132, 0.930568155797026287)
    weights = (0.173927422568726929, 0.326072577431273071, 0.326072577431273071, 0.173927422568726929)
    visible, closed, area = 0.0, 0.0, 0.0
    for j in range(grid.shape[0] - 1):
        for i in range(grid.shape[1] - 1):
            if (
                grid[j, i, 1] <= 0.0
                and grid[j, i + 1, 1] <= 0.0
                and grid[j + 1, i, 1] <= 0.0
                and grid[j + 1, i + 1, 1] <= 0.0
            ):
                continue
            for k in range(4):
                b, weight = nodes[k], weights[k]
                # the cell's left and right edge at the Gauss point
                left = grid[j, i] * (1.0 - b) + grid[j + 1, i] * b
                right = grid[j, i + 1] * (1.0 - b) + grid[j + 1, i + 1] * b
                above, length, first = _root_integral(left[1], right[1])
                below, _, _ = _root_integral(left[2], right[2])
                # mid integrated over the part of the cell that is inside, plus the root
                visible += weight * (above + left[0] * length + (right[0] - left[0]) * first)
                # the closed body lies between both roots about the same mid
                closed += weight * (above + below)
                area += weight * length
    cell = step_mm * step_mm
    return visible * cell, closed * cell, area * cell
