"""Which of a product's points a surface rests on: sure ones, near those around them, not too many.

False light lies centimetres off the points around it. Many points of a line are pooled to the middle of a
parabola through them; what is left, at most 150, is spread evenly over all.

It assumes that false light is rarer than true, and lies farther off than a flank is high. It fails where
false points stand together, more of them than true ones around.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.robust_fit import solve

_POINTS_MAX = 150
"""Points that count: the time grows with their cube, and 250 bring a volume no nearer to the truth."""
_POOLED_ROWS_MAX = 12
"""Rows of a line of which one point counts: over so many a line on a radius of 100 px is a parabola."""
_BEND_POINTS_MIN, _BEND_STD = 5, 1.5
"""Points on a line that tell its bend, and how much less sure its middle is than the points' mean."""
_LEAST_STD_MM = 1e-3
"""Of a point, beside its neighbours."""
_POINTS_MIN = 8
"""Six numbers of the quadratic are fitted."""
_UNSURE = 6.0
"""Of the median uncertainty, that a point's may be: dots that an edge has cut lie beside the surface."""
_AROUND = 12
"""Points around one, by which false ones are told: twice the numbers of a quadratic."""
_SOFT = 1e-3
"""Of one point's weight, with which a quadratic's numbers are held near zero."""
_OFF_MAX = 9.0
"""Of the median distance from theirs, that a point may lie off."""
_STEEPEST = 2.0
"""Of the distance to those around, that a point may lie off the median of their heights at least: rims rise
by the whole of it, false light lies twice and three times as far off."""
_OFF_SHARE = 0.6
"""Of the distance to those around, that a point may lie off a quadratic at least: at rims good ones lie up to
5 mm off at a distance of 9 mm, false light 7 to 28 mm."""
_FLAT_STD_MM = 0.05
"""Beside the points' own uncertainty: skin and print."""


class Chosen(NamedTuple):
    """Which of a product's points count, so that they need not be chosen anew when it has moved a little."""

    place: Integers
    """(n, 2) slice and place in it of each point that is pooled."""
    rows: int
    """Places of a slice that are pooled to one point."""
    order: Integers
    """(point,) order of the pooled points."""


@lru_cache(maxsize=8)
def points_of(profiles: Profiles, number: int, lines_min: int) -> tuple[Floats, Floats, Floats, Chosen]:
    """Give a product's points that count, their standard uncertainties, and where all of them lie.

    Parameters
    ----------
    profiles, number
        Points of the belt frame, and which product's are asked for.
    lines_min
        Lines that must show something of it.

    Returns
    -------
    xyz_mm, height_std_mm, every_xy_mm, chosen
        (point, 3), (point,), (seen point, 2) without any left out; and which points count.

    Raises
    ------
    StageError
        Too few points, or lines, lie on the product.
    """
    place = np.argwhere((profiles.product == number) & profiles.seen)
    xyz = profiles.xyz_mm[place[:, 0], place[:, 1]]
    known = np.isfinite(xyz).all(axis=1)
    place, xyz = place[known], xyz[known]
    std = profiles.height_std_mm[place[:, 0], place[:, 1]]
    if len(xyz) < _POINTS_MIN:
        raise StageError(f"{len(xyz)} points lie on the product, {_POINTS_MIN} are the least")
    # points stand slice by slice
    lines = np.count_nonzero(np.diff(place[:, 0], prepend=-1))
    if lines < lines_min:
        low, high = xyz.min(axis=0), xyz.max(axis=0)
        raise StageError(
            f"{lines} of the lines lie on the product, and a volume needs {lines_min}; its position is "
            f"X = {low[0]:.1f} to {high[0]:.1f} mm, Y = {low[1]:.1f} to {high[1]:.1f} mm, up to "
            f"Z = {high[2]:.1f} mm",
            hint="project more lines, or dots; a cross hair shows only a position",
        )
    every_xy = xyz[:, :2]
    std = np.nan_to_num(std, nan=_FLAT_STD_MM)
    sure = std <= _UNSURE * max(float(np.median(std)), _FLAT_STD_MM)
    place = place[sure]
    rows = rows_pooled(len(place))
    xyz, std, group = pooled(xyz[sure], std[sure], place, rows)
    near = np.flatnonzero(beside_neighbours(xyz))
    # the order of slices shall not matter, nor which of many points are left out
    order = near[np.lexsort(xyz[near].T)]
    order = order[np.unique(np.linspace(0, len(near) - 1, min(len(near), _POINTS_MAX)).astype(np.int64))]
    kept = np.zeros(len(xyz), np.bool_)
    kept[order] = True
    chosen = Chosen(place[kept[group]], rows, (np.cumsum(kept) - 1)[order])
    return xyz[order], np.hypot(std[order], _FLAT_STD_MM), every_xy, chosen


def same_points_of(profiles: Profiles, chosen: Chosen) -> tuple[Floats, Floats] | None:
    """Give the points and uncertainties as `points_of` does, of points that were chosen before.

    None where one of them has no place any more.
    """
    slice_, place = chosen.place.T
    xyz = profiles.xyz_mm[slice_, place]
    if not np.isfinite(xyz).all():
        return None
    std = np.nan_to_num(profiles.height_std_mm[slice_, place], nan=_FLAT_STD_MM)
    xyz, std, _ = pooled(xyz, std, chosen.place, chosen.rows)
    return xyz[chosen.order], np.hypot(std[chosen.order], _FLAT_STD_MM)


@kernel
def beside_neighbours(xyz_mm: Floats) -> Flags:
    """Say which points lie near those around them: false light lies centimetres off.

    First near the median of their heights, for several may lie off together; then, the worst one first, near
    a quadratic through them, which flanks and rims follow to a fraction of the points' distance.
    """
    count = xyz_mm.shape[0]
    kept, fitted = np.ones(count, np.bool_), np.zeros(count, np.bool_)
    if count < 2 * _AROUND:
        return kept
    which, apart, off = np.empty((count, _AROUND), np.int64), np.empty(count), np.empty(count)
    for i in range(count):
        apart[i] = _nearest(xyz_mm, kept, i, which[i])
        off[i] = abs(median_of(xyz_mm[which[i], 2]) - xyz_mm[i, 2])
    kept = off <= max(_OFF_MAX * median_of(off), _STEEPEST * median_of(apart))
    while kept.sum() >= 2 * _AROUND:
        worst = -1
        for i in range(count):
            if not kept[i]:
                continue
            gone = False
            for j in which[i]:
                gone |= not kept[j]
            if gone:
                apart[i] = _nearest(xyz_mm, kept, i, which[i])
            if gone or not fitted[i]:
                off[i], fitted[i] = _off_quadratic(xyz_mm, i, which[i], apart[i]), True
            if worst < 0 or off[i] > off[worst]:
                worst = i
        if off[worst] <= max(_OFF_MAX * median_of(off[kept]), _OFF_SHARE * median_of(apart[kept])):
            break
        kept[worst] = False
    return kept


@kernel
def _nearest(xyz_mm: Floats, kept: Flags, i: int, which: Integers) -> float:
    """Find the kept points nearest to one, the nearest first; give their mean distance, mm."""
    far = np.full(_AROUND, np.inf)
    for j in range(xyz_mm.shape[0]):
        apart = (xyz_mm[i, 0] - xyz_mm[j, 0]) ** 2 + (xyz_mm[i, 1] - xyz_mm[j, 1]) ** 2
        # kept in the order of distance
        if apart >= far[-1] or j == i or not kept[j]:
            continue
        at = _AROUND - 1
        while at > 0 and far[at - 1] > apart:
            far[at], which[at] = far[at - 1], which[at - 1]
            at -= 1
        far[at], which[at] = apart, j
    return max(np.sqrt(far).mean(), 1e-6)


@kernel
def _off_quadratic(xyz_mm: Floats, i: int, which: Integers, apart_mm: float) -> float:
    """Give how far a point lies off a quadratic through those around it, mm."""
    # points of two lines alone leave some of the quadratic open: a little is taken off all of it
    normal, right, powers = _SOFT * np.eye(6), np.zeros(6), np.ones(6)
    for j in which:
        x, y = (xyz_mm[j, 0] - xyz_mm[i, 0]) / apart_mm, (xyz_mm[j, 1] - xyz_mm[i, 1]) / apart_mm
        powers[1], powers[2], powers[3], powers[4], powers[5] = x, y, x * x, x * y, y * y
        for a in range(6):
            right[a] += powers[a] * (xyz_mm[j, 2] - xyz_mm[i, 2])
            for b in range(a + 1):
                normal[a, b] += powers[a] * powers[b]
    solve(normal, right)
    # heights are counted from the point's own: the quadratic's first number is its distance
    return abs(right[0])


def rows_pooled(count: int) -> int:
    """Give how many places of a line are pooled to one point, of so many points on all lines."""
    return min(math.ceil(count / _POINTS_MAX), _POOLED_ROWS_MAX)


@kernel
def pooled(xyz_mm: Floats, std_mm: Floats, place: Integers, rows: int) -> tuple[Floats, Floats, Integers]:
    """Give one point for all of the same `rows` places of a line, and (n,) which one each is part of.

    `place` (n, 2) says which slice and which of its points each is, in this order. It is the middle of a
    parabola through them: their mean would lie under a surface that bulges, by a thousandth of a potato's
    height, and all of them do. Dots stand too far apart to be pooled.
    """
    if rows == 1:
        return xyz_mm, std_mm, np.arange(std_mm.size)
    found, std, count, end = np.empty_like(xyz_mm), np.empty_like(std_mm), 0, 0
    group = np.empty(std_mm.size, np.int64)
    while end < std.size:
        first, (slice_, part) = end, (place[end, 0], place[end, 1] // rows)
        while end < std.size and place[end, 0] == slice_ and place[end, 1] // rows == part:
            group[end] = count
            end += 1
        total, middle = 0.0, 0.0
        for k in range(first, end):
            weight = 1.0 / max(std_mm[k], _LEAST_STD_MM) ** 2
            total += weight
            middle += weight * place[k, 1]
        middle /= total
        second, third, fourth = 0.0, 0.0, 0.0
        mean, slope, square = np.zeros(3), np.zeros(3), np.zeros(3)
        for k in range(first, end):
            share, off = 1.0 / max(std_mm[k], _LEAST_STD_MM) ** 2 / total, place[k, 1] - middle
            second += share * off**2
            third += share * off**3
            fourth += share * off**4
            for n in range(3):
                mean[n] += share * xyz_mm[k, n]
                slope[n] += share * off * xyz_mm[k, n]
                square[n] += share * off**2 * xyz_mm[k, n]
        # of a parabola at the middle: its mean less what its bend adds, where there are points enough to tell
        bend = fourth - second**2 - (third**2 / second if second > 0.0 else 0.0)
        told = end - first >= _BEND_POINTS_MIN and bend > 0.0
        for n in range(3):
            found[count, n] = mean[n]
            if told:
                found[count, n] -= (square[n] - mean[n] * second - slope[n] * third / second) / bend * second
        std[count] = (_BEND_STD if told else 1.0) / math.sqrt(total)
        count += 1
    return found[:count].copy(), std[:count].copy(), group
