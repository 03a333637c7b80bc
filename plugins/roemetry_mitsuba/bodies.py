"""Closed triangle meshes on the belt: checks, exact volume, height map, files.

A body is a closed mesh in the belt frame (mm, z up, lowest point at z = 0). Its true volume is that of the
divergence theorem; its visible volume, all that lies under its top surface down to the belt, is summed over a
grid of vertical rays 0.1 mm apart (for a body of 25 mm the sum is right to about 0.01 %: the error of a
midpoint rule at an edge of random phase).

It assumes meshes whose faces do not cross each other; where some do, the divergence theorem counts what lies
inside twice. It fails for open meshes, which are refused.
"""

from __future__ import annotations

import math
import multiprocessing
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import PluginError
from roemetry.io.meshes import check_closed, read_mesh
from roemetry_kernels.compiling import kernel

Floats = NDArray[np.float64]
Faces = NDArray[np.int64]

RASTER_MM = 0.1
"""Pitch of the height map; a quarter of the smallest detail a family makes."""

VARIANT = "llvm_ad_mono"
"""Of Mitsuba: rays vectorised by LLVM on the processor, one colour."""


@dataclass(frozen=True, eq=False)
class Body:
    """A closed mesh: corners (V, 3), belt frame, and faces (F, 3), counter-clockwise from outside.

    Light sees interpolated normals where it is `smooth` (curved bodies), else the faces' own (blocks).
    """

    points_mm: Floats
    faces: Faces
    smooth: bool = True

    @property
    def corners_mm(self) -> Floats:
        """Corners of each face, shape (F, 3, 3)."""
        return self.points_mm[self.faces]

    @property
    def normals(self) -> Floats:
        """Unit normals at the corners, weighted by the areas of their faces, shape (V, 3)."""
        return normals_of(self.points_mm, self.faces)

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y."""
        low, high = self.points_mm.min(axis=0), self.points_mm.max(axis=0)
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])

    @property
    def height_mm(self) -> float:
        """Largest Z."""
        return float(self.points_mm[:, 2].max())

    @cached_property
    def true_mm3(self) -> float:
        """Volume within the mesh."""
        # signed volumes of the tetrahedra from the origin, by the divergence theorem
        a, b, c = np.moveaxis(self.corners_mm, 1, 0)
        return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0)

    @cached_property
    def heights(self) -> HeightMap:
        """Highest Z over the belt."""
        x_min, x_max, y_min, y_max = self.extent_mm
        columns = max(math.ceil((x_max - x_min) / RASTER_MM), 1)
        rows = max(math.ceil((y_max - y_min) / RASTER_MM), 1)
        # a whole number of cells over the extent: the sum over a block that lies straight is exact
        step = (x_max - x_min) / columns, (y_max - y_min) / rows
        top = np.full((rows, columns), -1.0)
        _rasterise(top, np.ascontiguousarray(self.corners_mm), x_min, y_min, *step)
        top[top < 0.0] = np.nan
        return HeightMap(top, (x_min, y_min), step)

    @property
    def visible_mm3(self) -> float:
        """Volume under the top surface down to the belt."""
        return float(np.nansum(self.heights.top_mm)) * math.prod(self.heights.step_mm)

    @property
    def footprint_mm2(self) -> float:
        """Area that the body hides from above."""
        return float(np.isfinite(self.heights.top_mm).sum()) * math.prod(self.heights.step_mm)

    def moved(self, x_mm: float, y_mm: float, yaw_deg: float = 0.0) -> Body:
        """Give the body turned about its own origin, then moved."""
        c, s = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return replace(self, points_mm=self.points_mm @ turn.T + np.array([x_mm, y_mm, 0.0]))


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Highest Z at cells' middles, NaN beside the body; cell (0, 0) begins at `start_mm`, (X, Y)."""

    top_mm: Floats
    start_mm: tuple[float, float]
    step_mm: tuple[float, float]

    def at(self, x_mm: Floats, y_mm: Floats) -> Floats:
        """Give the height of the cell that each place lies in, NaN beside the body."""
        i = np.floor((x_mm - self.start_mm[0]) / self.step_mm[0]).astype(np.int64)
        j = np.floor((y_mm - self.start_mm[1]) / self.step_mm[1]).astype(np.int64)
        rows, columns = self.top_mm.shape
        inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
        found = np.full(np.shape(x_mm), np.nan)
        found[inside] = self.top_mm[j[inside], i[inside]]
        return found


def normals_of(points_mm: Floats, faces: Faces) -> Floats:
    """Give unit normals at corners, weighted by the areas of their faces, outwards where faces are."""
    a, b, c = np.moveaxis(points_mm[faces], 1, 0)
    # twice the area long: so faces weigh by their areas
    across = np.cross(b - a, c - a)
    summed = np.zeros_like(points_mm)
    for corner in range(3):
        for axis in range(3):
            summed[:, axis] += np.bincount(faces[:, corner], across[:, axis], len(points_mm))
    unit: Floats = summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), 1e-300)
    return unit


def rest_on_belt(points_mm: Floats, faces: Faces, smooth: bool = True) -> Body:
    """Give a body whose lowest point touches the belt, the middle of its bounds over the origin."""
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    middle = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    return outwards(Body(points_mm - middle, faces, smooth))


def outwards(body: Body) -> Body:
    """Give the body with its faces turned outwards."""
    return body if body.true_mm3 > 0.0 else replace(body, faces=np.ascontiguousarray(body.faces[:, ::-1]))


def read_body(path: Path, mm_per_unit: float, up: str) -> Body:
    """Read a mesh file and lay it on the belt; raise DataError, with its name, for what is no closed mesh."""
    points, faces = check_closed(read_mesh(path), str(path))
    size = mm_per_unit * points @ _upright(up).T
    return rest_on_belt(size, faces, _is_smooth(size, faces))


def mitsuba() -> Any:
    """Import Mitsuba in the variant used here; raise PluginError that says what to install."""
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError as error:
        raise PluginError(
            f"simulator `mitsuba` needs the module mitsuba ({error})", hint='pip install "roemetry[mitsuba]"'
        ) from error
    if mi.variant() == VARIANT:
        return mi
    if not dr.has_backend(dr.JitBackend.LLVM):
        raise PluginError(
            "simulator `mitsuba` does not find the LLVM library, by which it compiles its kernels",
            hint="install LLVM (Debian, Ubuntu: apt install libllvm15), or say where it is by the "
            "environment variable DRJIT_LIBLLVM_PATH",
        )
    mi.set_variant(VARIANT)
    mi.set_log_level(mi.LogLevel.Error)
    if multiprocessing.parent_process() is not None:
        dr.set_thread_count(1)  # one of several worker processes: they share the processors between them
    return mi


def _upright(up: str) -> Floats:
    """Give a rotation that turns an axis (x, -y, …) to +z."""
    order = {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}[up[-1]]
    turn = np.eye(3)[order]
    return np.diag([1.0, -1.0, -1.0]) @ turn if up[0] == "-" else turn


def _is_smooth(points: Floats, faces: Faces) -> bool:
    """Whether neighbouring faces mostly meet at less than 30 degrees: the mesh stands for a curved body."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    a, b, c = np.moveaxis(points[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    owner = np.tile(np.arange(len(faces)), 3)
    # sorted, both faces of an edge stand side by side
    order = np.lexsort(np.sort(edges, axis=1).T)
    pairs = owner[order][: 2 * (len(order) // 2)].reshape(-1, 2)
    cosine = np.einsum("ti,ti->t", normals[pairs[:, 0]], normals[pairs[:, 1]])
    return float((cosine < math.cos(math.radians(30.0))).mean()) < 0.02


@kernel
def _rasterise(top: Floats, corners: Floats, x0: float, y0: float, step_x: float, step_y: float) -> None:
    """Raise each cell of a grid to the highest face over its middle."""
    rows, columns = top.shape
    for k in range(corners.shape[0]):
        a, b, c = corners[k, 0], corners[k, 1], corners[k, 2]
        # twice the area seen from above; negative from below
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if turn <= 0.0:  # looks down or edge on: another face lies above it
            continue
        # cells whose middles lie within the face's bounds
        i0 = max(math.ceil((min(a[0], b[0], c[0]) - x0) / step_x - 0.5), 0)
        i1 = min(math.floor((max(a[0], b[0], c[0]) - x0) / step_x - 0.5), columns - 1)
        j0 = max(math.ceil((min(a[1], b[1], c[1]) - y0) / step_y - 0.5), 0)
        j1 = min(math.floor((max(a[1], b[1], c[1]) - y0) / step_y - 0.5), rows - 1)
        for j in range(j0, j1 + 1):
            y = y0 + (j + 0.5) * step_y - a[1]
            for i in range(i0, i1 + 1):
                x = x0 + (i + 0.5) * step_x - a[0]
                # barycentric; the margins leave no gap between neighbours
                u = (x * (c[1] - a[1]) - y * (c[0] - a[0])) / turn
                v = (y * (b[0] - a[0]) - x * (b[1] - a[1])) / turn
                if u >= -1e-12 and v >= -1e-12 and u + v <= 1.0 + 1e-12:
                    top[j, i] = max(top[j, i], a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]))
