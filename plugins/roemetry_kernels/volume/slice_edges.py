"""What slices of a dome count wrongly at their own ends, where a known rim tells better."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats, Integers, Labels
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.volume.slice_areas import AT, FIRST_ROW, LAST_ROW, WALL, WIDTH

_APART = 3  # points: near enough for a parabola, far enough for noise
_FARTHEST = 8.0  # of the points' distance: more than the camera does not see of a steep rim


@float_kernel
def edges_missed(
    xyz_mm: Floats,
    product: Labels,
    row_px: Floats,
    number: int,
    table: Floats,
    place: Integers,
    at_end: int,
    lean: tuple[float, float],
    rim_mm: float,
) -> float:
    """Give what one end's half of the slices count too little at their own ends, mm³.

    A slice's outermost points lie over the rim, which has two effects. As the height of the wall below the
    slice's ends they are too high. And what lies outside of them is more than half the way to the next
    point: a camera above does not see how a dome falls to its rim, and near the rim rows lie far apart. There
    y is a parabola of z through three points; the slice goes on along it down to the rim, or up to where it
    turns.

    Parameters
    ----------
    xyz_mm, product, row_px : ndarray
        As in `Profiles`.
    number
        Number of the product.
    table, place
        Rows of `slice_areas` along rising rest X, and where each slice is in `Profiles`.
    at_end
        0 the half of the first slice, 1 that of the last.
    lean
        Of the planes of light of both outer slices: outwards for each millimetre upwards.
    rim_mm
        Height of the rim, not below the belt.

    Returns
    -------
    float
        As said.
    """
    n = table.shape[0]
    opening = (lean[0] + lean[1]) / (table[n - 1, AT] - table[0, AT])
    points = np.empty((product.shape[1], 2))
    total = 0.0
    for k in range(n):
        mine = min(max(0.5 * n - (k if at_end == 0 else n - 1 - k), 0.0), 1.0)
        if not mine > 0.0:
            continue
        i, count = place[k], 0
        for m in range(product.shape[1]):
            if product[i, m] != number or not np.isfinite(xyz_mm[i, m, 2]):
                continue
            if table[k, FIRST_ROW] <= row_px[i, m] <= table[k, LAST_ROW]:
                points[count, 0], points[count, 1] = xyz_mm[i, m, 1], xyz_mm[i, m, 2]
                count += 1
        held = 0.5 * (table[min(k + 1, n - 1), AT] - table[max(k - 1, 0), AT])
        missed = -0.5 * opening * table[k, WIDTH] * (table[k, WALL] - rim_mm * rim_mm)
        if count > 4 * _APART:
            missed += _beyond(points, 0, 1, rim_mm) + _beyond(points, count - 1, -1, rim_mm)
        total += mine * held * missed
    return total


@float_kernel
def _beyond(points: Floats, first: int, step: int, rim_mm: float) -> float:
    """Area beyond a slice's outermost point, less what is counted there, mm²."""
    y0, z0 = points[first, 0], points[first, 1]
    p, q = points[first + _APART * step], points[first + 2 * _APART * step]
    # outwards from the outermost point, as b·(z − z0) + c·(z − z0)²
    sign = -1.0 if q[0] > y0 else 1.0
    y1, y2, z1, z2 = sign * (p[0] - y0), sign * (q[0] - y0), p[1] - z0, q[1] - z0
    if not (z1 > 0.0 and z2 > z1 and y1 < 0.0 and y2 < y1):
        return 0.0
    c = (y2 / z2 - y1 / z1) / (z2 - z1)
    b = y1 / z1 - c * z1
    if not b < 0.0:
        return 0.0  # it has turned already
    stop = min(rim_mm - z0, 0.0)
    if c < 0.0:
        stop = max(stop, -0.5 * b / c)
    row = abs(points[first + step, 0] - y0)
    if (b + c * stop) * stop > _FARTHEST * row:
        return 0.0
    # ∫ z dy from there to the outermost point
    beyond = stop * (b * (z0 + 0.5 * stop) + c * stop * (z0 + 2.0 / 3.0 * stop))
    return beyond - 0.5 * row * z0
