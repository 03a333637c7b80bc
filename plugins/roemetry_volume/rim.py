"""Height of the rim, where the surface turns vertical: from the ends of the stripes, along the product.

Model. At each end of a slice (z − rim)² = α·d + β·d², d the distance inside the outline (`rim_heights`); the
rim is a polynomial of low order along and across the product through all ends.

Assumed: the outline is right to some tenths of a millimetre, and the rim has no steps. It fails with fewer
than four ends: then it is taken to lie somewhat below the lowest points, and is that unsure.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.robust_fit import robust_fit

_LENGTH_MM = 5.0
"""Of a stripe's end: long enough for a curve through it, short beside a product's width. At 4 mm volumes
change by up to 0.7 % and standard uncertainties by up to 32 %, at 6.25 mm by 0.04 and 1.5 %."""
_HEIGHT_STD_MM = 0.1  # of a point near the rim, where light grazes
_SPREAD_FLOOR_MM = 0.2
"""No end knows the rim better: its last lit row lies up to a row above it. Without it volumes change by up to
0.3 %."""
_UPRIGHT_LEAST = 0.35  # of the ends' uprightness (0 a slope, 1 a dome) at the median
_WALL_SLOPE, _WALL_MM = 12.0, 1.0  # steeper than a dome is from row to row, over at least so much
_RIDGE = np.array([0.0, 0.05, 0.05, 0.2])
"""Of the terms 1, s, s² and v of the rim: a few ends hold its tilt across the product worst."""
_SCATTER_LEAST_MM, _ROUNDS = 0.1, 8  # ends scatter by more; rounds of reweighting


class StripePoints(NamedTuple):
    """A product's points, slice after slice, down the rows.

    `xyz_mm` (n, 3); `slice` (n,) counts up from 0 over the slices with points; `first` (slices + 1,) where
    each begins, and the end.
    """

    xyz_mm: Floats
    slice: Integers
    first: Integers


class Rim(NamedTuple):
    """Height of the rim as a low-order polynomial: c₀ + c₁s + c₂s² + c₃v over scaled s and v.

    `std_mm` says how sure its level is; `upright` whether the surface meets it upright, as a dome does, or
    at an angle, as a slope.
    """

    coefficients: Floats
    scale_mm: tuple[float, float]
    std_mm: float
    upright: bool = True

    def at(self, s: Floats, v: Floats) -> Floats:
        """Height, mm, at places along and across the product."""
        places = np.ascontiguousarray(s), np.ascontiguousarray(v)
        height: Floats = rim_at(self.coefficients, self.scale_mm, *places)
        return height


@float_kernel
def rim_at(coefficients: Floats, scale_mm: tuple[float, float], s: Floats, v: Floats) -> Floats:
    """Give the heights of a `Rim`, at least 0, at places (n,)."""
    c, height = coefficients, np.empty(s.size)
    for k in range(s.size):
        a, b = s[k] / scale_mm[0], v[k] / scale_mm[1]
        height[k] = max(c[0] + a * (c[1] + c[2] * a) + c[3] * b, 0.0)
    return height


def ends_of(points: StripePoints, across_mm: Floats) -> tuple[Integers, Integers, Integers]:
    """Give the points of both ends of each slice, outermost first, within 5 mm along Y.

    Parameters
    ----------
    points
        The product's points.
    across_mm : ndarray, shape (n,)
        Their place across the product: down an upright side that the camera sees, it does not change.

    Returns
    -------
    index, first, size
        Points of all ends in a row; where each end begins in that, and how many points it has.
    """
    return ends_in_line(points.first, points.xyz_mm, across_mm)


@kernel
def ends_in_line(first: Integers, xyz_mm: Floats, across_mm: Floats) -> tuple[Integers, Integers, Integers]:
    """Give the ends as `ends_of` does.

    Points of an upright wall that the camera sees are left out: rows go down it, and hardly across.
    """
    ends = 2 * (first.size - 1)
    index, begins = np.empty(2 * xyz_mm.shape[0], np.int64), np.empty(ends, np.int64)
    size = np.empty(ends, np.int64)
    count = 0
    for end in range(ends):
        begin, stop, step = first[end // 2], first[end // 2 + 1], 1
        if end % 2:
            begin, stop, step = stop - 1, begin - 1, -1
        begins[end] = count
        for k in range(begin, stop, step):
            if abs(xyz_mm[k, 1] - xyz_mm[begin, 1]) <= _LENGTH_MM:
                index[count] = k
                count += 1
        # from the outermost point on, as long as it goes up a wall
        wall, rise = begins[end], 0.0
        while wall + 1 < count:
            up = xyz_mm[index[wall + 1], 2] - xyz_mm[index[wall], 2]
            if not up > _WALL_SLOPE * abs(across_mm[index[wall + 1]] - across_mm[index[wall]]):
                break
            wall, rise = wall + 1, rise + up
        if rise > _WALL_MM and wall + 1 < count:
            index[begins[end] : begins[end] + count - wall] = index[wall:count].copy()
            count -= wall - begins[end]
        size[end] = count - begins[end]
    return index[:count].copy(), begins, size


def rim_of(
    points: StripePoints, ends: tuple[Integers, Integers, Integers], place: Floats, inside_mm: Floats
) -> Rim:
    """Fit the rim.

    Parameters
    ----------
    points
        The product's points.
    ends
        As `ends_of` gave them.
    place : ndarray, shape (n, 2)
        Along and across the product, mm.
    inside_mm : ndarray
        Distance inside the outline of the points that `ends` lists.
    """
    index, first, size = ends
    found, scale, std, upright = fitted_rim(points.xyz_mm[index, 2], place, index, first, size, inside_mm)
    return Rim(found, scale, std, upright)


@float_kernel
def fitted_rim(
    z_mm: Floats, place: Floats, index: Integers, first: Integers, size: Integers, inside_mm: Floats
) -> tuple[Floats, tuple[float, float], float, bool]:
    """Give what `Rim` holds: `z_mm` and `inside_mm` are of the ends' points, the others as `rim_of` says."""
    heights, spread, upright = rim_heights(inside_mm, z_mm, first, size, _HEIGHT_STD_MM)
    told = upright[np.isfinite(upright)]
    is_dome = not (told.size > 0 and median_of(told) < _UPRIGHT_LEAST)
    # s and v within −1…1
    scale_s = max((place[:, 0].max() - place[:, 0].min()) / 2.0, 1.0)
    scale_v = max((place[:, 1].max() - place[:, 1].min()) / 2.0, 1.0)
    known = np.flatnonzero(np.isfinite(heights))
    if known.size < 4:
        # too few ends to say more than: somewhat below the lowest points that were seen
        level = 0.8 * median_of(z_mm[first])
        low = np.array([max(level, 0.0), 0.0, 0.0, 0.0])
        return low, (scale_s, scale_v), max(0.3 * level, 0.2), is_dome
    rows, rim, wide, base = np.ones((4, known.size)), heights[known], spread[known], np.empty(known.size)
    for k in range(known.size):
        at = index[first[known[k]]]
        rows[1, k], rows[3, k] = place[at, 0] / scale_s, place[at, 1] / scale_v
        rows[2, k] = rows[1, k] * rows[1, k]
        base[k] = 1.0 / (wide[k] ** 2 + _SPREAD_FLOOR_MM**2)
    base /= base.mean()
    found, weight, off = robust_fit(rows, rim, base, _RIDGE.copy(), _SCATTER_LEAST_MM, _ROUNDS)
    # what each end leaves open by itself is alike for all; what ends differ by averages out, the less so the
    # more a side's neighbours differ alike, as where the product is twisted
    scatter = (weight * off**2).sum()
    alike = (np.sqrt(weight[2:] * weight[:-2]) * off[2:] * off[:-2]).sum()
    alike = min(max(alike / scatter, 0.0), 1.0) if scatter > 0.0 else 0.0
    effective_ends = weight.sum() ** 2 / (weight**2).sum()  # ends of little weight hardly average out
    apart = max(effective_ends * (1.0 - alike) / (1.0 + alike), 1.0)
    std = np.sqrt(((weight * wide**2).sum() + scatter / apart) / weight.sum())
    return found, (scale_s, scale_v), max(std, 0.1), is_dome


_STEPS = 25  # of the rim's height, from the belt to an end's lowest point
_LEAST = 6  # points of an end: two more than its three unknowns and the scatter
_LEAST_ROOT_MM = 0.25  # a root's slope is infinite at 0: nearer the rim a misfit counts as it does here
_LEVEL_MM2 = 0.25  # a surface that falls by less than half a millimetre ends in an edge, as a box does


@float_kernel
def rim_heights(
    distance_mm: Floats, z_mm: Floats, first: Integers, size: Integers, std_mm: float
) -> tuple[Floats, Floats, Floats]:
    """Fit (z − rim)² = α·d + β·d², α ≥ 0, at each end, over rims from the belt to its lowest point.

    Parameters
    ----------
    distance_mm, z_mm : ndarray, shape (n,)
        Distance inside the outline, and height, of points of all ends, end by end, outermost first.
    first, size : ndarray, shape (ends,)
        Where each end's points begin, and how many there are.
    std_mm
        What a height's misfit is judged by.

    Returns
    -------
    rim, spread, upright : ndarray, shape (ends,)
        Mean height over what fits, weighed by how well, mm, and its standard deviation; which share of the
        fall over the end is α·d, as of a surface that meets the rim upright: a slope that meets it at an
        angle has β·d² alone, and a level top that ends in an edge nothing. NaN for an end of too few points.
    """
    ends = first.size
    rim, spread, upright = np.full(ends, np.nan), np.full(ends, np.nan), np.full(ends, np.nan)
    cost, height, straight = np.empty(_STEPS), np.empty(_STEPS), np.empty(_STEPS)
    for e in range(ends):
        a, n = first[e], size[e]
        if n < _LEAST:
            continue
        z, d = z_mm[a : a + n], distance_mm[a : a + n]
        lowest = max(z.min(), 0.0)
        # rims from the belt up to the lowest point
        for step in range(_STEPS):
            height[step] = lowest * step / (_STEPS - 1)
            misfit, share = _misfit(z, d, height[step])
            cost[step] = misfit / (std_mm * std_mm)
            straight[step] = share
        least = cost.min()
        total, mean, square = 0.0, 0.0, 0.0
        for step in range(_STEPS):
            # neighbouring rows err alike: some four rows tell as much as one
            likely = np.exp(-0.125 * (cost[step] - least))
            total += likely
            mean += likely * height[step]
            square += likely * height[step] ** 2
        rim[e] = mean / total
        # half a step more, since rims are tried in steps
        spread[e] = np.sqrt(max(square / total - rim[e] ** 2, 0.0)) + 0.5 * lowest / (_STEPS - 1)
        upright[e] = straight[cost.argmin()]
    return rim, spread, upright


@float_kernel
def _misfit(z: Floats, d: Floats, rim: float) -> tuple[float, float]:
    """Sum of squared misfits in height of the best α ≥ 0 and β for one rim height, mm²; share of α·d."""
    dd, dq, qq, du, qu = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(z.size):
        x = max(d[k], 0.0)
        u = (z[k] - rim) ** 2
        w = 1.0 / max(z[k] - rim, _LEAST_ROOT_MM) ** 2
        dd += w * x * x
        dq += w * x * x * x
        qq += w * x * x * x * x
        du += w * x * u
        qu += w * x * x * u
    # normal equations of α and β; α not below 0
    determinant = dd * qq - dq * dq
    alpha, beta = (0.0, 0.0) if dd <= 0.0 else (max(du / dd, 0.0), 0.0)
    if determinant > 1e-12 * dd * qq:
        alpha, beta = (du * qq - qu * dq) / determinant, (qu * dd - du * dq) / determinant
        if alpha < 0.0:
            alpha, beta = 0.0, max(qu / qq, 0.0)
    total = 0.0
    for k in range(z.size):
        x = max(d[k], 0.0)
        off = z[k] - rim - np.sqrt(max(alpha * x + beta * x * x, 0.0))
        total += off * off
    far = d.max()
    fall = alpha * far + abs(beta) * far * far
    return total, alpha * far / fall if fall > _LEVEL_MM2 else 0.0
