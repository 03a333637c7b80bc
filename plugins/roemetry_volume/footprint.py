"""The footprint's border on the belt, from the outline in the image; integration over it.

The outline is a perspective silhouette: each of its points lies on a ray that touches the product's widest
line, the rim, so its place on the belt depends on the rim's height there and, where the camera looks from
inside outwards, on how the dome falls to the rim (`border_at`). Over the inside of that border volumes are
integrated by Gauss's rule (`nodes_within`).

It assumes that one line on the product, the rim, makes the outline. It fails where an overhang or a corner
makes it instead: the border is then off by how much higher that lies, times the tilt of sight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, kernel


class Border(NamedTuple):
    """The footprint's border."""

    xy_mm: Floats
    """(n, 2) closed polygon on the belt."""
    outward: Floats
    """(n, 2) unit normals."""
    tilt: Floats
    """(n,) tangent of the viewing ray's tilt along the normal; positive where the camera looks from inside
    outwards and the wall is hidden, negative where it sees the wall."""


def border_at(rays: tuple[Floats, Floats], height_mm: Floats, fall_mm: Floats) -> Border:
    """Place a contour at the heights of the rim that made it.

    Where a dome falls to its rim as (z − z_rim)² = α·d, a ray of tilt t along the normal touches it α·t²/4
    outside the rim (for an ellipse c²·t²/(2b)): the border lies that much further inside.

    Parameters
    ----------
    rays
        A point and the direction, (n, 3) each, of the silhouette's lines of sight (`View.rays`).
    height_mm : ndarray, shape (n,)
        Height of the rim at each of its points.
    fall_mm : ndarray, shape (n,)
        α at each point, mm; 0 where it meets the rim at an angle.
    """
    return Border(*placed_border(*rays, height_mm, fall_mm))


@float_kernel
def placed_border(
    start: Floats, way: Floats, height_mm: Floats, fall_mm: Floats
) -> tuple[Floats, Floats, Floats]:
    """Give what `Border` holds, as `border_at` says."""
    n = height_mm.size
    xy, tilt = np.empty((n, 2)), np.empty(n)
    for k in range(n):
        # where the line of sight is as high as the rim
        along = (height_mm[k] - start[k, 2]) / way[k, 2]
        xy[k, 0], xy[k, 1] = start[k, 0] + along * way[k, 0], start[k, 1] + along * way[k, 1]
    outward = normals_of(xy, 2)
    for k in range(n):
        # outwards for each millimetre downwards
        tilt[k] = (way[k, 0] * outward[k, 0] + way[k, 1] * outward[k, 1]) / -way[k, 2]
        # α t²/4 with the sign of t, and α t/4 beyond 45°
        inwards = 0.25 * fall_mm[k] * tilt[k] * min(max(abs(tilt[k]), 0.0), 1.0)
        xy[k, 0] -= inwards * outward[k, 0]
        xy[k, 1] -= inwards * outward[k, 1]
    return xy, outward, tilt


@float_kernel
def area_of(xy: Floats) -> float:
    """Signed area of a closed polygon; positive if it runs counter-clockwise."""
    total, last = 0.0, xy.shape[0] - 1
    for k in range(last):
        total += xy[k, 0] * xy[k + 1, 1] - xy[k, 1] * xy[k + 1, 0]
    return 0.5 * (total + xy[last, 0] * xy[0, 1] - xy[last, 1] * xy[0, 0])


def around(xy: Floats, by: int) -> Floats:
    """Give of each point of a ring the one so many places ahead."""
    return np.concatenate([xy[by:], xy[:by]])


@float_kernel
def evenly(contour: Floats, points: int) -> Floats:
    """Resample a closed polygon to points at even distances."""
    n = contour.shape[0]
    along = np.zeros(n + 1)
    for k in range(n):
        m = k + 1 if k < n - 1 else 0
        step_x, step_y = contour[m, 0] - contour[k, 0], contour[m, 1] - contour[k, 1]
        along[k + 1] = along[k] + math.sqrt(step_x * step_x + step_y * step_y)
    out = np.empty((points, 2))
    k = 0
    for p in range(points):
        at = along[n] * p / points
        while k < n - 1 and along[k + 1] <= at:
            k += 1
        m = k + 1 if k < n - 1 else 0
        share = (at - along[k]) / (along[k + 1] - along[k]) if along[k + 1] > along[k] else 0.0
        out[p, 0] = contour[k, 0] + share * (contour[m, 0] - contour[k, 0])
        out[p, 1] = contour[k, 1] + share * (contour[m, 1] - contour[k, 1])
    return out


@float_kernel
def normals_of(ring: Floats, reach: int) -> Floats:
    """Give the outward unit normals (n, 2) of a ring, from the points so many places before and ahead."""
    n = ring.shape[0]
    sign = 1.0 if area_of(ring) >= 0.0 else -1.0
    normal = np.empty((n, 2))
    for k in range(n):
        before, ahead = (k - reach) % n, (k + reach) % n
        along_x, along_y = ring[ahead, 0] - ring[before, 0], ring[ahead, 1] - ring[before, 1]
        length = math.sqrt(along_x * along_x + along_y * along_y)
        long = sign / (length if length > 0.0 else 1.0)
        # a quarter turn outwards, whichever way the ring runs
        normal[k, 0], normal[k, 1] = along_y * long, -along_x * long
    return normal


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
        # with the derivative of the substitution
        width = 0.5 * (high - low) * math.cos(quarter * nodes_s[a]) * quarter * weights_s[a]
        found = 0
        for k in range(n):
            m = k + 1 if k < n - 1 else 0
            if (contour[k, 0] <= at) != (contour[m, 0] <= at) and found < 16:
                share = (at - contour[k, 0]) / (contour[m, 0] - contour[k, 0])
                crossings[found] = contour[k, 1] + share * (contour[m, 1] - contour[k, 1])
                found += 1
        for k in range(1, found):  # a handful: no sorting routine is compiled for them
            late, m = crossings[k], k
            while m > 0 and crossings[m - 1] > late:
                crossings[m] = crossings[m - 1]
                m -= 1
            crossings[m] = late
        # inside lies between the first and the second crossing, the third and the fourth, and so on
        for pair in range(0, found - 1, 2):
            middle = 0.5 * (crossings[pair] + crossings[pair + 1])
            half = 0.5 * (crossings[pair + 1] - crossings[pair])
            for b in range(per):
                s[filled] = at
                v[filled] = middle + half * math.sin(quarter * nodes_v[b])
                weight[filled] = width * half * math.cos(quarter * nodes_v[b]) * quarter * weights_v[b]
                filled += 1
    return s[:filled].copy(), v[:filled].copy(), weight[:filled].copy()


@float_kernel
def inside_by(contour: Floats, places: Floats) -> Floats:
    """Give how far each place (n, 2) lies within a closed polygon; negative outside."""
    n, count = contour.shape[0], places.shape[0]
    x, y = places[:, 0].copy(), places[:, 1].copy()
    best, crossed = np.full(count, np.inf), np.zeros(count, np.int64)
    for k in range(n):
        m = k + 1 if k < n - 1 else 0
        ax, ay, by = contour[k, 0], contour[k, 1], contour[m, 1]
        dx, dy = contour[m, 0] - ax, by - ay
        square = dx * dx + dy * dy
        share = 1.0 / square if square > 0.0 else 0.0
        run = dx / dy if dy != 0.0 else 0.0
        for p in range(count):  # a vector at a time
            right, up = x[p] - ax, y[p] - ay
            along = min(max((right * dx + up * dy) * share, 0.0), 1.0)
            right_of, above = right - along * dx, up - along * dy
            best[p] = min(best[p], right_of * right_of + above * above)
            # from inside, the way to the right crosses the border an odd number of times
            crossed[p] += ((ay <= y[p]) != (by <= y[p])) & (right < up * run)
    for p in range(count):
        distance = math.sqrt(best[p])
        best[p] = distance if crossed[p] % 2 == 1 else -distance
    return best
