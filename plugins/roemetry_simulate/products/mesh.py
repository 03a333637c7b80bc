"""A user's own mesh as a product: read, checked for closedness, laid on the belt, hit by rays.

Rays meet the triangles in float64 through a tree of boxes. Its nodes stand in the order of a walk from the
root, so that a ray needs no stack: past a node whose box it misses it jumps over all below. `links` holds for
each node where to jump, and for a leaf its first triangle and their number (0 for a node that is no leaf). A
triangle is a row of nine: one corner and the two edges from it. Edges count as inside by a tolerance of 1e-12
of the edges' length, so that no ray slips through between neighbours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from roemetry.errors import DataError
from roemetry.io.meshes import Triangles, check_closed, read_mesh
from roemetry_kernels.compiling import kernel
from roemetry_simulate.products.family import (
    Drawn,
    Pose,
    ProductFamily,
    ProductOptions,
    describe,
    draw_pose,
    random_of,
)
from roemetry_simulate.solid import MESH, MISS, ExactBody

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_RAYS = 2_000_000  # vertical rays of the visible volume: right to 1e-4 of a box
_LEAF = 4  # triangles of a leaf: fewer make the tree deep, more test many triangles
_MARGIN_MM = 1e-7  # about boxes, against rounding
_EDGE = 1e-12  # of an edge's length: what counts as inside, so that no ray slips through between neighbours
_FILE = ("product", "options", "file")

_UP = {
    "x": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    "y": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
}
"""Turns (never mirrors) that bring an axis up."""


class MeshOptions(ProductOptions):
    """Options of `mesh`."""

    file: Path = Field(description="mesh file, .obj, .stl or .ply")
    mm_per_unit: float = Field(
        default=1.0,
        gt=0,
        le=1e6,
        description="millimetres in one unit of the file: 1000 for metres, 25.4 for inches",
    )
    up: Literal["x", "-x", "y", "-y", "z", "-z"] = Field(
        default="z", description="axis of the file that points up"
    )


class ClosedMesh(NamedTuple):
    """A closed mesh, its middle over its own origin and its lowest point at z = 0.

    corners_mm has shape (T, 3, 3); volumes are in mm³, the footprint in mm².
    """

    corners_mm: Floats
    visible_mm3: float
    true_mm3: float
    footprint_mm2: float


class Tree(NamedTuple):
    """Triangles in the order of the tree (T, 9), the nodes' boxes (N, 6) and their links (N, 3)."""

    triangles: Floats
    boxes: Floats
    links: Integers


def build_tree(corners_mm: Floats) -> Tree:
    """Sort triangles, shape (T, 3, 3): triangle, corner, (x, y, z), into a read-only tree of boxes."""
    order, boxes, links = _sort(np.ascontiguousarray(corners_mm, dtype=np.float64))
    sorted_mm = corners_mm[order]
    first = sorted_mm[:, 0]
    # one corner and both edges from it
    rows = np.concatenate([first, sorted_mm[:, 1] - first, sorted_mm[:, 2] - first], axis=1)
    tree = Tree(np.ascontiguousarray(rows), boxes, links)
    for array in tree:
        array.flags.writeable = False
    return tree


@dataclass(frozen=True, eq=False)
class MeshSolid:
    """A closed mesh on the belt.

    - `corners_mm`, shape (T, 3, 3): Triangle, corner, (x, y, z), belt frame, counter-clockwise seen from
      outside.
    - `visible_volume_mm3`, `true_volume_mm3`, `footprint_mm2`: Its volumes and its footprint's area.
    """

    corners_mm: Floats
    visible_volume_mm3: float
    true_volume_mm3: float
    footprint_mm2: float
    _tree: Tree = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_tree", build_tree(self.corners_mm))

    def body(self) -> ExactBody:
        """Return the kernels' form."""
        top_mm = float(self.corners_mm[..., 2].max())
        return ExactBody(MESH, tuple(self._tree.boxes[0].tolist()), top_mm, **self._tree._asdict())

    def heights_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Highest and lowest Z over belt positions of one shape; NaN outside the footprint."""
        x, y = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(y_mm, dtype=np.float64))
        flat = np.ascontiguousarray(x).ravel(), np.ascontiguousarray(y).ravel()
        top, bottom = vertical_heights(self._tree, *flat)
        return top.reshape(x.shape), bottom.reshape(x.shape)

    def footprint_extent_mm(self) -> tuple[float, float, float, float]:
        """Smallest and largest X, smallest and largest Y of the footprint, millimetres."""
        low, high = self.corners_mm.min(axis=(0, 1)), self.corners_mm.max(axis=(0, 1))
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def close(mesh: Triangles, mm_per_unit: float = 1.0, up: str = "z", name: str = "mesh") -> ClosedMesh:
    """Check that a mesh is closed, scale it, turn its axis `up` to +z, and lay it down.

    Points at exactly the same place are one, faces without area are left out, and a mesh whose faces all
    looked inwards is turned inside out.

    Raises
    ------
    DataError
        Edges are open or faces are turned against their neighbours; the message begins with the name.
    """
    points, faces = check_closed(mesh, name)
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # faces without area have no normal
    corners = mm_per_unit * corners[np.any(across != 0.0, axis=1)] @ np.array(_UP[up], dtype=np.float64).T
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    corners -= np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    # signed tetrahedra from the origin to each face (divergence theorem)
    volume = float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)
    # faces look inwards: turned inside out
    if volume < 0.0:
        corners, volume = np.ascontiguousarray(corners[:, ::-1]), -volume
    visible, area = _visible(corners)
    return ClosedMesh(corners, visible, volume, area)


def lay(mesh: ClosedMesh, pose: Pose) -> MeshSolid:
    """Lay a mesh on the belt."""
    at = math.radians(pose.yaw_deg)
    turn = np.array([[math.cos(at), -math.sin(at), 0.0], [math.sin(at), math.cos(at), 0.0], [0.0, 0.0, 1.0]])
    corners = mesh.corners_mm @ turn.T + np.array([pose.x_mm, pose.y_mm, 0.0])
    return MeshSolid(corners, mesh.visible_mm3, mesh.true_mm3, mesh.footprint_mm2)


def _visible(corners_mm: Floats) -> tuple[float, float]:
    """Visible volume (mm³) and footprint (mm²) of triangles that stand on z = 0 about their own origin."""
    low, high = corners_mm.min(axis=(0, 1))[:2], corners_mm.max(axis=(0, 1))[:2]
    size = high - low
    # as many rays as are wanted, evenly over the box
    step = math.sqrt(float(size[0] * size[1]) / _RAYS)
    columns, rows = (max(math.ceil(side / step), 1) for side in size)
    step_x, step_y = size[0] / columns, size[1] / rows
    top = np.full((rows, columns), -1.0)
    _rasterise(top, np.ascontiguousarray(corners_mm), low[0], low[1], step_x, step_y)
    cell = float(step_x * step_y)
    # cells where the top was never raised are outside the footprint
    return float(top[top > 0.0].sum()) * cell, float((top >= 0.0).sum()) * cell


@kernel
def _rasterise(top: Floats, corners: Floats, x0: float, y0: float, step_x: float, step_y: float) -> None:
    """Raise each node of a grid to the highest triangle over its middle."""
    rows, columns = top.shape
    for k in range(corners.shape[0]):
        a, b, c = corners[k, 0], corners[k, 1], corners[k, 2]
        # twice the area seen from above; 0: the face stands upright
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if turn == 0.0:
            continue
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        lower, upper = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        i0, i1 = math.ceil((left - x0) / step_x - 0.5), math.floor((right - x0) / step_x - 0.5)
        j0, j1 = math.ceil((lower - y0) / step_y - 0.5), math.floor((upper - y0) / step_y - 0.5)
        for j in range(max(j0, 0), min(j1, rows - 1) + 1):
            y = y0 + (j + 0.5) * step_y - a[1]
            for i in range(max(i0, 0), min(i1, columns - 1) + 1):
                x = x0 + (i + 0.5) * step_x - a[0]
                # barycentric coordinates of the cell's middle
                u = (x * (c[1] - a[1]) - y * (c[0] - a[0])) / turn
                v = (y * (b[0] - a[0]) - x * (b[1] - a[1])) / turn
                if u >= -1e-12 and v >= -1e-12 and u + v <= 1.0 + 1e-12:
                    z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                    top[j, i] = max(top[j, i], z)


@lru_cache(maxsize=4)
def _closed(path: Path, changed_ns: int, mm_per_unit: float, up: str) -> ClosedMesh:
    """Read and check a file once for all products made of it; `changed_ns` makes a changed file another."""
    return close(read_mesh(path), mm_per_unit, up, str(path))


def _make(seed: int, options: MeshOptions) -> Drawn:
    try:
        changed_ns = options.file.stat().st_mtime_ns
        mesh = _closed(options.file, changed_ns, options.mm_per_unit, options.up)
    except OSError as fault:
        raise DataError(f"{options.file}: {fault.strerror or fault}", at=_FILE) from fault
    except DataError as fault:
        fault.at = _FILE
        raise
    pose = draw_pose(random_of(seed, "mesh"), options)
    solid = lay(mesh, pose)
    figures = {"yaw_deg": pose.yaw_deg, "height_mm": float(mesh.corners_mm[..., 2].max())}
    return Drawn(solid, describe(solid, options, figures=figures))


MESH_FAMILY = ProductFamily("mesh", "any closed mesh: OBJ, STL or PLY", MeshOptions, _make)
"""The family."""


@kernel
def hit_triangles(
    triangles: Floats, boxes: Floats, links: Integers, o: Floats, d: Floats, t_max: float
) -> float:
    """Distance (mm) from o along d to the first triangle, from either side and within t_max, or MISS."""
    best, found = t_max, MISS
    # reciprocals once a ray: slabs are then products
    ix, iy, iz = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    node = 0
    while node < boxes.shape[0]:
        box = boxes[node]
        one, two = (box[0] - o[0]) * ix, (box[3] - o[0]) * ix
        # the interval in which the ray is within the box's sides, one pair after another (slabs)
        near, far = max(0.0, min(one, two)), min(best, max(one, two))
        one, two = (box[1] - o[1]) * iy, (box[4] - o[1]) * iy
        near, far = max(near, min(one, two)), min(far, max(one, two))
        one, two = (box[2] - o[2]) * iz, (box[5] - o[2]) * iz
        near, far = max(near, min(one, two)), min(far, max(one, two))
        # missed: on to the node behind all that hang below
        if near > far:
            node = links[node, 0]
            continue
        first, count = links[node, 1], links[node, 2]
        for k in range(first, first + count):
            t = _hit(triangles[k], o, d)
            # hits from either side: a shadow ray may start inside
            if 0.0 <= t <= best:
                best, found = t, t
        node += 1
    return found


@kernel
def triangles_normal(
    triangles: Floats, boxes: Floats, links: Integers, point: Floats, normal: Floats
) -> None:
    """Write the outward unit normal of the triangle that a point of the skin lies on."""
    nearest = 1e300
    node = 0
    while node < boxes.shape[0]:
        box = boxes[node]
        outside = False
        for m in range(3):
            # the point lies on the skin up to rounding
            outside |= point[m] < box[m] - 1e-4 or point[m] > box[m + 3] + 1e-4
        if outside:
            node = links[node, 0]
            continue
        first, count = links[node, 1], links[node, 2]
        for k in range(first, first + count):
            p = triangles[k]
            nx, ny, nz = _across(p)
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            x, y, z = point[0] - p[0], point[1] - p[1], point[2] - p[2]
            away = abs(nx * x + ny * y + nz * z) / length
            # how far the foot of the point lies outside the triangle, as a share of its height
            u = (y * p[8] - z * p[7]) * nx + (z * p[6] - x * p[8]) * ny + (x * p[7] - y * p[6]) * nz
            v = (p[4] * z - p[5] * y) * nx + (p[5] * x - p[3] * z) * ny + (p[3] * y - p[4] * x) * nz
            beside = max(-u, -v, u + v - length * length, 0.0) / length**1.5
            if away + beside < nearest:
                nearest = away + beside
                normal[0], normal[1], normal[2] = nx / length, ny / length, nz / length
        node += 1


@kernel
def vertical_heights(tree: Tree, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Highest and lowest point of the triangles on vertical lines, shape of x; NaN where there is none."""
    top, bottom = np.full(x.size, np.nan), np.full(x.size, np.nan)
    o, d = np.zeros(3), np.zeros(3)
    # from just above and below the whole body
    low, high = tree.boxes[0, 2] - 1.0, tree.boxes[0, 5] + 1.0
    for k in range(x.size):
        o[0], o[1], o[2], d[2] = x[k], y[k], high, -1.0
        t = hit_triangles(tree.triangles, tree.boxes, tree.links, o, d, high - low)
        if t < 0.0:
            continue
        top[k] = high - t
        o[2], d[2] = low, 1.0
        t = hit_triangles(tree.triangles, tree.boxes, tree.links, o, d, high - low)
        bottom[k] = low + t if t >= 0.0 else top[k]
    return top, bottom


@kernel
def _across(p: Floats) -> tuple[float, float, float]:
    """Cross product of a triangle's edges."""
    return p[4] * p[8] - p[5] * p[7], p[5] * p[6] - p[3] * p[8], p[3] * p[7] - p[4] * p[6]


@kernel
def _hit(p: Floats, o: Floats, d: Floats) -> float:
    """Distance to a triangle, or MISS."""
    hx, hy, hz = d[1] * p[8] - d[2] * p[7], d[2] * p[6] - d[0] * p[8], d[0] * p[7] - d[1] * p[6]
    # Möller and Trumbore (1997): triple products instead of a plane
    turn = p[3] * hx + p[4] * hy + p[5] * hz
    if turn == 0.0:
        return MISS
    x, y, z = o[0] - p[0], o[1] - p[1], o[2] - p[2]
    u = (x * hx + y * hy + z * hz) / turn
    if u < -_EDGE or u > 1.0 + _EDGE:
        return MISS
    qx, qy, qz = y * p[5] - z * p[4], z * p[3] - x * p[5], x * p[4] - y * p[3]
    v = (d[0] * qx + d[1] * qy + d[2] * qz) / turn
    if v < -_EDGE or u + v > 1.0 + _EDGE:
        return MISS
    return (p[6] * qx + p[7] * qy + p[8] * qz) / turn


@kernel
def _inverse(d: float) -> float:
    """Return 1 / d, or a huge number of its sign that no product with a length makes infinite."""
    return 1.0 / d if abs(d) > 1e-200 else math.copysign(1e200, d)


@kernel
def _sort(corners: Floats) -> tuple[Integers, Floats, Integers]:
    """Order of the triangles, boxes and links of the tree: halves by the median of the longest side."""
    total = corners.shape[0]
    # number of nodes of a tree over n triangles, for the jumps
    sizes = np.ones(total + 1, dtype=np.int64)
    for n in range(_LEAF + 1, total + 1):
        sizes[n] = 1 + sizes[n // 2] + sizes[n - n // 2]
    order = np.arange(total)
    boxes = np.empty((sizes[total], 6))
    links = np.zeros((sizes[total], 3), dtype=np.int64)
    waiting = [(0, 0, total)]
    while len(waiting) > 0:
        node, start, end = waiting.pop()
        count = end - start
        # box of the triangles, wider by a margin
        for m in range(3):
            low, high = 1e300, -1e300
            for k in range(start, end):
                for c in range(3):
                    low, high = min(low, corners[order[k], c, m]), max(high, corners[order[k], c, m])
            boxes[node, m], boxes[node, m + 3] = low - _MARGIN_MM, high + _MARGIN_MM
        links[node, 0] = node + sizes[count]
        links[node, 1] = start
        if count <= _LEAF:
            links[node, 2] = count
            continue
        # halved along its longest side, by the middles' median
        axis = np.argmax(boxes[node, 3:] - boxes[node, :3])
        middles = np.empty(count)
        for k in range(count):
            p = corners[order[start + k]]
            middles[k] = p[0, axis] + p[1, axis] + p[2, axis]
        order[start:end] = order[start:end][np.argsort(middles)]
        half = start + count // 2
        # the left child comes next, the right one behind its whole subtree
        waiting.append((node + 1 + sizes[count // 2], half, end))
        waiting.append((node + 1, start, half))
    return order, boxes, links
