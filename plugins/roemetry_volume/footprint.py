"""Integration nodes within a closed contour, and distances from it."""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import kernel


@kernel
def nodes_within(
    contour: Floats, nodes_s: Floats, weights_s: Floats, nodes_v: Floats, weights_v: Floats
) -> tuple[Floats, Floats, Floats]:
    """Give nodes and weights that integrate over the inside of a contour.

    Along s and along v the substitution x = m + h·sin θ puts Gauss's nodes close to both ends, where the
    square root of a surface that meets its rim upright has its singular slope.

    Parameters
    ----------
    contour : ndarray, shape (n, 2)
        Closed polygon; the last point is not the first again.
    nodes_s, weights_s, nodes_v, weights_v : ndarray
        Nodes and weights of Gauss and Legendre on −1…1, for both directions.

    Returns
    -------
    s, v, weight : ndarray
        Places, and the area each stands for.
    """
    count, per = nodes_s.size, nodes_v.size
    low, high = contour[:, 0].min(), contour[:, 0].max()
    n = contour.shape[0]
    room = count * per * 8
    s, v, weight = np.empty(room), np.empty(room), np.empty(room)
    crossings = np.empty(16)
    filled = 0
    quarter = 0.5 * math.pi
    for a in range(count):
        at = 0.5 * (low + high) + 0.5 * (high - low) * math.sin(quarter * nodes_s[a])
        width = 0.5 * (high - low) * math.cos(quarter * nodes_s[a]) * quarter * weights_s[a]
        found = 0
        for k in range(n):
            m = k + 1 if k < n - 1 else 0
            if (contour[k, 0] <= at) != (contour[m, 0] <= at) and found < 16:
                share = (at - contour[k, 0]) / (contour[m, 0] - contour[k, 0])
                crossings[found] = contour[k, 1] + share * (contour[m, 1] - contour[k, 1])
                found += 1
        crossings[:found].sort()
        for pair in range(0, found - 1, 2):
            middle = 0.5 * (crossings[pair] + crossings[pair + 1])
            half = 0.5 * (crossings[pair + 1] - crossings[pair])
            for b in range(per):
                s[filled] = at
                v[filled] = middle + half * math.sin(quarter * nodes_v[b])
                weight[filled] = width * half * math.cos(quarter * nodes_v[b]) * quarter * weights_v[b]
                filled += 1
    return s[:filled].copy(), v[:filled].copy(), weight[:filled].copy()


@kernel
def inside_by(contour: Floats, places: Floats) -> Floats:
    """Give how far each place (n, 2) lies within a closed polygon; negative outside."""
    n = contour.shape[0]
    out = np.empty(places.shape[0])
    for p in range(places.shape[0]):
        x, y = places[p, 0], places[p, 1]
        best = np.inf
        inside = False
        for k in range(n):
            m = k + 1 if k < n - 1 else 0
            ax, ay = contour[k, 0], contour[k, 1]
            dx, dy = contour[m, 0] - ax, contour[m, 1] - ay
            square = dx * dx + dy * dy
            along = 0.0
            if square > 0.0:
                along = min(max(((x - ax) * dx + (y - ay) * dy) / square, 0.0), 1.0)
            off = (x - ax - along * dx) ** 2 + (y - ay - along * dy) ** 2
            best = min(best, off)
            if (ay <= y) != (contour[m, 1] <= y) and x < ax + (y - ay) * dx / dy:
                inside = not inside
        out[p] = math.sqrt(best) if inside else -math.sqrt(best)
    return out
