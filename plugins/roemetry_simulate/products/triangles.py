"""Exact hits of rays on triangles in float64, through a tree of boxes; kernels for bodies given as meshes.

The tree's nodes stand in the order of a walk from the root, so that a ray needs no stack: past a node whose
box it misses it jumps over all below. `links` holds for each node where to jump, and for a leaf its first
triangle and their number (0 for a node that is no leaf). A triangle is a row of nine: one corner and the two
edges from it. Edges count as inside by a tolerance of 1e-12 of the edges' length, so that no ray slips
through between neighbours.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MISS = -1.0
_LEAF = 4
_MARGIN_MM = 1e-7
_EDGE = 1e-12


class Tree(NamedTuple):
    """Triangles in the order of the tree (T, 9), the nodes' boxes (N, 6) and their links (N, 3)."""

    triangles: Floats
    boxes: Floats
    links: Integers


def build_tree(corners_mm: Floats) -> Tree:
    """Sort triangles into a tree of boxes.

    Parameters
    ----------
    corners_mm : ndarray, shape (T, 3, 3)
        Triangle, corner, (x, y, z).

    Returns
    -------
    Tree
        Read-only, for `hit_triangles` and `triangles_normal`.
    """
    order, boxes, links = _sort(np.ascontiguousarray(corners_mm, dtype=np.float64))
    sorted_mm = corners_mm[order]
    first = sorted_mm[:, 0]
    rows = np.concatenate([first, sorted_mm[:, 1] - first, sorted_mm[:, 2] - first], axis=1)
    tree = Tree(np.ascontiguousarray(rows), boxes, links)
    for array in tree:
        array.flags.writeable = False
    return tree


@kernel
def hit_triangles(
    triangles: Floats, boxes: Floats, links: Integers, o: Floats, d: Floats, t_max: float
) -> float:
    """Distance from o along d to the first triangle, from either side, or MISS.

    Parameters
    ----------
    triangles, boxes, links : ndarray
        `ExactBody.triangles`, `ExactBody.boxes`, `ExactBody.links`.
    o, d : ndarray, shape (3,)
        Start and direction.
    t_max : float
        Hits beyond it do not count.
    """
    best, found = t_max, MISS
    ix, iy, iz = _inverse(d[0]), _inverse(d[1]), _inverse(d[2])
    node = 0
    while node < boxes.shape[0]:
        box = boxes[node]
        one, two = (box[0] - o[0]) * ix, (box[3] - o[0]) * ix
        near, far = max(0.0, min(one, two)), min(best, max(one, two))
        one, two = (box[1] - o[1]) * iy, (box[4] - o[1]) * iy
        near, far = max(near, min(one, two)), min(far, max(one, two))
        one, two = (box[2] - o[2]) * iz, (box[5] - o[2]) * iz
        near, far = max(near, min(one, two)), min(far, max(one, two))
        if near > far:
            node = links[node, 0]
            continue
        first, count = links[node, 1], links[node, 2]
        for k in range(first, first + count):
            t = _hit(triangles[k], o, d)
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
        axis = np.argmax(boxes[node, 3:] - boxes[node, :3])
        middles = np.empty(count)
        for k in range(count):
            p = corners[order[start + k]]
            middles[k] = p[0, axis] + p[1, axis] + p[2, axis]
        order[start:end] = order[start:end][np.argsort(middles)]
        half = start + count // 2
        waiting.append((node + 1 + sizes[count // 2], half, end))
        waiting.append((node + 1, start, half))
    return order, boxes, links
