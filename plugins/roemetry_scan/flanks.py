"""Flanks that neither camera nor light sees, followed from what is seen of them.

Behind a product, as the camera looks, lies a shadow in which no line is seen; steep sides lose points as
well. A flank is taken for a conic over a rim at the height r,

    (z − r)² = a + b·x + c·x²,

with x outwards from the last point that is seen: exact for ellipsoids, and near for what bulges from a rim.
It is with the rim's height from the other side, where belt is seen right beside it, fitted to the last
points, first along the belt (each image row through all slices), then along each slice, and followed to where
it ends on the rim, from where a visible volume has a wall, but not beyond where belt is seen. What is flat up
to where it is lost is a wall. Gaps within a slice are joined by straight lines. Points that were followed are
not `seen`.
"""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers, Labels
from roemetry_kernels.compiling import float_kernel, inlined

POINTS = 30
"""Points that tell how a flank goes on, at most."""
_POINTS_MIN, _REACH = 6, 0.3
"""So many at least, and no farther in than this share of the last point's height: foods are conics only near
their rim. With lines 1.2 mm apart, 30 points are half a product, and volumes came out 1.8 % off instead of
0.2 % (24 products, seed 500)."""
_RIM_PRIOR = 1e-5
"""Weight of a rim on the belt, of one point's equation: it decides where noise alone would."""
_RIM_ROWS_MIN = 10
"""Image rows that tell a product's rim, at least: belt is seen right beside them, and they bend."""
_DIM_MOST = 4
"""Points in a row that grazing light may lose between a product and the belt: on a translucent ball of 40 mm
under lines 0.6 mm apart there are up to three."""
_RIM_ROWS_OTHERS = 30
"""Rows beside those of the outermost line that tell it without these, at least: three groups."""
_RIM_GROUPS = 7
"""Of neighbouring rows, whose usual values tell how sections end from side to side."""
_DENSE = 5.0
"""Slices so many points apart tell rim and reach better than the end of each slice does. With lines 2 mm
apart, eight points or more, eggs were off by 0.5 % (mean absolute) with them, 0.3 % without (seed 31500)."""
_SEEN_MIN, _REACH_MIN = 2, 0.6
"""Points of a row that must be seen below the height at which it is lost behind; the least reach."""
_HALVINGS = 12
"""Of the way from the belt to a row's outer point, to its rim: 0.01 mm for 40 mm."""
_AREA_STEPS = 20
"""Of a conic whose area is summed: the root at its end is then right to a thousandth of the area."""
_POOLED = 3
"""Neighbours on either side whose mean stands for a point: noise of single ones bends the conic."""
_BESIDE = 5
"""Rows on either side that tell how far a row's flank may reach: a millimetre or two, over which outlines are
straight enough."""
_FLAT = 1.02
"""The highest of them is so much higher than the last, or nothing bends."""


def followed(xyz_mm: Floats, label: Labels, plane: Floats) -> tuple[Floats, Labels, Flags, Floats, Floats]:
    """Give points and labels with the flanks that are not seen, which points these are, rims, and doubts.

    Rims as `Profiles.rim_mm`: NaN where slices lie too far apart to tell; doubts as `Profiles.flank_rel_std`.

    Parameters
    ----------
    xyz_mm, label, plane
        As in `Profiles`: over the belt, with belt and products told apart.
    """
    none, many = np.zeros(label.shape, np.bool_), int(label.max(initial=0))
    rims, by_row = rims_of(xyz_mm, label, none, many)
    dense = usual_step(xyz_mm, 0) <= _DENSE * usual_step(xyz_mm, 1)
    reach = reach_of(xyz_mm, label, none, by_row) if dense else np.ones(by_row.shape)
    points, number, added = followed_to(xyz_mm, label, plane, rims, by_row, reach)
    doubt = doubt_of(xyz_mm, label, none, by_row, reach)
    return points, number, added, rims if dense else np.full(rims.shape, np.nan), doubt


def usual_step(xyz_mm: Floats, axis: int) -> float:
    """Give the usual distance of neighbours along slices' order (0) or along a slice (1), mm."""
    some = xyz_mm[:, :: max(1, xyz_mm.shape[1] // 64)] if axis == 0 else xyz_mm[:: max(1, len(xyz_mm) // 64)]
    steps = np.sqrt((np.diff(some[..., :2], axis=axis) ** 2).sum(axis=2))
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    return float(np.median(steps)) if steps.size else 1.0


def followed_to(
    xyz_mm: Floats, label: Labels, plane: Floats, rims: Floats, by_row: Floats, reach: Floats
) -> tuple[Floats, Labels, Flags]:
    """Do what `followed` does, to rims as `rims_of` gives them, and as far as `reach_of` says."""
    points, number = np.array(xyz_mm), np.array(label)
    added = np.zeros(number.shape, np.bool_)
    _along_belt(points, number, added, plane, by_row, reach)
    _along_slices(points, number, added, plane, rims)
    _join(points, number, added, plane)
    return points, number, added


@float_kernel
def conic(
    d: Floats, z: Floats, count: int, most: float, rim: float
) -> tuple[float, float, float, float, float]:
    """Give the conic of a flank beyond its last seen point: r, a, b, c, and its length, 0 where it falls off.

    Parameters
    ----------
    d, z
        Of the last seen points, the outermost first: distance inwards from it (d[0] = 0), and height, mm.
    count
        How many there are.
    most
        How far out the belt is seen, mm.
    rim
        Height of the rim where the other side has told it, mm; NaN: it is fitted.
    """
    z0 = z[0]
    none = 0.0, 0.0, 0.0, 0.0, 0.0
    long, high = d[count - 1], 0.0
    for k in range(count):
        high = max(high, z[k])
    # what is flat up to where it is lost falls off as a wall does
    if count < _POINTS_MIN or not high > _FLAT * z0 or not z0 > 0.0:
        return none
    # z² = 2 r z + a + b·x + c·x² with x outwards, all in the size of what is seen
    rows, sums = np.zeros((4, 4)), np.zeros(4)
    for k in range(count):
        x, h = -d[k] / long, z[k] / high
        of = (2.0 * h, 1.0, x, x * x)
        for m in range(4):
            sums[m] += of[m] * h * h
            for n in range(4):
                rows[m, n] += of[m] * of[n]
    rows[0, 0] += _RIM_PRIOR * count
    fit = np.linalg.solve(rows, sums)
    r = min(max(fit[0] if math.isnan(rim) else rim / high, 0.0), 0.95 * z0 / high)
    for m in range(1, 4):
        sums[m] -= rows[m, 0] * r
    if r != fit[0]:  # a rim below the belt, or above what is seen
        fit[1:] = np.linalg.solve(rows[1:, 1:].copy(), sums[1:].copy())
    if fit[3] > 0.0:  # a hyperbola, which turns upwards again before it comes to the rim: at most a parabola
        fit[3] = 0.0
        fit[1:3] = np.linalg.solve(rows[1:3, 1:3].copy(), sums[1:3].copy())
    a, b, c = fit[1] + r * r, fit[2], fit[3]
    # the curve goes through the last point
    a = (z0 / high - r) ** 2
    inside = b * b - 4.0 * a * c
    end = most / long
    if b < 0.0 or c < 0.0:
        root = -2.0 * a / (b - math.sqrt(inside)) if inside >= 0.0 else end
        if root > 0.0:
            end = min(end, root)
    # back from the sizes to mm: (z − r)² = a + b·x + c·x²
    square = high * high
    return r * high, a * square, b * square / long, c * square / (long * long), end * long


@float_kernel
def _along_belt(xyz: Floats, label: Labels, added: Flags, plane: Floats, rims: Floats, reach: Floats) -> None:
    """Follow each image row from slice to slice, both ways, no farther than the rows beside it tell."""
    slices, points = label.shape
    for way in (1, -1):
        ends = np.full(rims.shape, np.nan)
        for known in (False, True):
            for k in range(points):
                i = 0 if way == 1 else slices - 1
                while 0 <= i < slices:
                    ahead = i + way
                    if label[i, k] > 0 and 0 <= ahead < slices and label[ahead, k] < 0:
                        number = label[i, k]
                        rim, far = rims[number, k], reach[number, k]
                        i = _fill(xyz, label, added, plane, rim, far, ends, known, i, k, way, 0)
                    else:
                        i = ahead


@float_kernel
def _along_slices(xyz: Floats, label: Labels, added: Flags, plane: Floats, rims: Floats) -> None:
    """Follow each slice on both sides."""
    slices, points = label.shape
    ends = np.empty((0, 0))
    for i in range(slices):
        for way in (1, -1):
            k = 0 if way == 1 else points - 1
            while 0 <= k < points:
                ahead = k + way
                if label[i, k] > 0 and 0 <= ahead < points and label[i, ahead] < 0:
                    k = _fill(xyz, label, added, plane, rims[label[i, k]], 1.0, ends, True, i, k, 0, way)
                else:
                    k = ahead


@float_kernel
def rims_of(xyz: Floats, label: Labels, added: Flags, products: int, first: int = 1) -> tuple[Floats, Floats]:
    """Give (product + 1,) the height of each one's rim, and (product + 1, row) that of its sections by rows.

    NaN where belt is seen right beside too few of them, or too few of these bend. The rim is the height at
    which the conics of rows' outer points end where the rows do, on the mean over rows: the edge of one row
    lies anywhere between its last line and the first line of belt. Lengths are averaged, not rims: a conic is
    longer by about as much as its rim is lower, while a rim rises as the root of what an edge is off. The
    last point is left out: of a sheet of light that reaches beyond the rim only its upper part is seen, which
    lifts that point by up to 0.3 mm. With `first` 0 it counts, too.

    Only the side counts on which fewer points are missing between product and belt. On the other one the belt
    reappears behind a shadow, which says nothing of an edge; thin products have short ones.

    What a row shows lies in a plane that leans towards the camera, the more the farther to the side. Its
    section of a body ends above the body's rim there; the slices' planes, which stand upright, end at that of
    the middle half of the rows.

    Rows that are flat up to where they end tell nothing. Pooled with neighbours that bend, they would bend a
    little, and tell a rim that is far too high: only rows count that bend by themselves. Groups of rows tell
    a rim if `_RIM_ROWS_MIN` of them bend. Between groups it is interpolated, over those that tell none, too;
    where the middle half tells none, its rim is the mean of what is interpolated there.
    """
    points = label.shape[1]
    rims, by_row = np.full(products + 1, np.nan), np.full((products + 1, points), np.nan)
    row, edge = np.zeros((2, points), np.int64), np.zeros((2, points), np.int64)
    belt, unseen = np.zeros((2, points), np.int64), np.zeros((2, points), np.int64)
    for number in range(1, products + 1):
        count, missing = np.zeros(2, np.int64), np.full(2, np.inf)
        for side in range(2):
            n = 0
            for k in range(points):
                edge[side, n], belt[side, n] = _outermost(label, added, number, k, 1 - 2 * side)
                row[side, n], unseen[side, n] = k, abs(edge[side, n] - belt[side, n]) - 1
                n += belt[side, n] >= 0
            if n > 0:
                count[side], missing[side] = n, np.median(unseen[side, :n])
        side = 0 if missing[0] <= missing[1] else 1
        many, way = count[side], 1 - 2 * side
        if many < _RIM_ROWS_MIN or missing[side] > _DIM_MOST:
            continue
        rows, edges, belts = row[side, :many], edge[side, :many], belt[side, :many]
        far = slice(0, count[1 - side])
        beyond = _beyond_last(xyz, rows, edges, belts, unseen[side, :many], way)
        if missing[1 - side] > _DIM_MOST:  # there is a shadow; else the distance to the belt is a spacing
            beyond += _cut_off(xyz, rows, belts, row[1 - side, far], edge[1 - side, far], belt[1 - side, far])
        groups = min(_RIM_GROUPS, many // _RIM_ROWS_MIN)
        at, told = np.empty(groups), np.empty(groups)
        # without the rows under the outermost line; where none of the others tells, with them
        told[:] = math.nan
        for used in (_without_outermost(beyond, belts, way), beyond):
            if not np.isfinite(told).any():
                beyond = used
                for g in range(groups):
                    part = slice(g * many // groups, (g + 1) * many // groups)
                    at[g] = np.mean(rows[part])
                    told[g] = _rim_of_rows(xyz, label, added, rows[part], edges[part], used[part], way, first)
        tells = np.isfinite(told)
        if not tells.any():
            continue
        by_row[number] = np.interp(np.arange(points), at[tells], told[tells])
        part = slice(many // 4, many - many // 4)
        rims[number] = _rim_of_rows(xyz, label, added, rows[part], edges[part], beyond[part], way, first)
        if math.isnan(rims[number]):
            rims[number] = np.mean(by_row[number][rows[part]])
    return rims, by_row


@inlined
def _outermost(label: Labels, added: Flags, number: int, k: int, way: int) -> tuple[int, int]:
    """Give the slices of a row's outermost point and of the belt beside it, from where `way` leads inwards.

    The belt's is −1 where the scan ends before it, or another product stands there.
    """
    slices, belt = label.shape[0], -1
    for n in range(slices):
        m = n if way == 1 else slices - 1 - n
        if label[m, k] == 0:
            belt = m
        elif label[m, k] > 0 and not added[m, k]:
            if label[m, k] == number:
                return m, belt
            belt = -1
    return 0, -1


@inlined
def _beyond_last(
    xyz: Floats, row: Integers, edge: Integers, belt: Integers, unseen: Integers, way: int
) -> Floats:
    """Give (row,) how far rows go on beyond their last points, up to a spacing inside the belt, mm.

    Seen from above, the edge is a smooth curve that crosses from one spacing of lines to the next between two
    rows: over a run of rows with their belt in one line it goes from the spacing's outer end to its inner
    one, or back. Where it comes to its outermost it lies anywhere in one spacing: half-way on the mean.
    """
    beyond, many = np.empty(row.size), row.size
    begin = 0
    while begin < many:
        end = begin
        while end < many and belt[end] == belt[begin]:
            end += 1
        # how many lines farther in the belt lies before the run and after it; 0 at an end
        before = way * (belt[begin - 1] - belt[begin]) if begin > 0 else 0
        after = way * (belt[end] - belt[begin]) if end < many else 0
        slope = 0
        if before * after < 0:
            slope = 1 if after > 0 else -1
        for n in range(begin, end):
            share = 0.5 + slope * (0.5 - (n + 0.5 - begin) / (end - begin))
            to_belt = abs(xyz[belt[n], row[n], 0] - xyz[edge[n], row[n], 0])
            beyond[n] = to_belt * (unseen[n] + share) / (unseen[n] + 1.0)
        begin = end
    return beyond


@inlined
def _without_outermost(beyond: Floats, belt: Integers, way: int) -> Floats:
    """Leave out (NaN) the rows whose belt begins in the outermost line, unless the others are too few.

    Their edge lies anywhere in one spacing of lines, and all of them have that error in common.
    """
    outermost = np.min(way * belt)
    first, last = belt.size, -1
    for n in range(belt.size):
        if way * belt[n] == outermost:
            first, last = min(first, n), n
    left = beyond.copy()
    if belt.size - (last + 1 - first) >= _RIM_ROWS_OTHERS:
        left[first : last + 1] = math.nan
    return left


@inlined
def _cut_off(
    xyz: Floats, row: Integers, belt: Integers, far_row: Integers, far_edge: Integers, far_belt: Integers
) -> Floats:
    """Give (row,) how much farther out the first light on the belt lies than its sheet's middle, mm.

    Of a sheet whose middle meets the product, what passes beside it still shows on the belt. As no more than
    a part of the sheet it seems to lie below the belt; it lies on it, where its line of sight does. How
    oblique that is, the shadow on the other side says, whose length is seen, and the height at its beginning:
    without one nothing does, and light is taken as it is seen.
    """
    long_mm, high_mm = 0.0, 0.0
    for n in range(far_row.size):
        long_mm += abs(xyz[far_belt[n], far_row[n], 0] - xyz[far_edge[n], far_row[n], 0])
        high_mm += xyz[far_edge[n], far_row[n], 2]
    oblique = long_mm / high_mm if high_mm > 0.0 else 0.0
    farther = np.empty(row.size)
    for n in range(row.size):
        farther[n] = -xyz[belt[n], row[n], 2] * oblique
    return farther


@float_kernel
def _rim_of_rows(
    xyz: Floats, label: Labels, added: Flags, row: Integers, edge: Integers, beyond: Floats, way: int,
    first: int,
) -> float:  # fmt: skip
    """Give the height at which the conics of rows' outer points end where the rows do, on the mean, mm.

    0 where they slope down to the belt, NaN where fewer than `_RIM_ROWS_MIN` bend.
    """
    slices, many = label.shape[0], row.size
    d, z = np.empty((many, POINTS)), np.empty((many, POINTS))
    count, end, high = np.zeros(many, np.int64), np.zeros(many), 0.0
    for n in range(many):
        k, m, start = row[n], edge[n], edge[n] + first * way
        inner = start + way
        if not 0 <= inner < slices or label[start, k] != label[m, k] or label[inner, k] != label[m, k]:
            continue
        if math.isnan(beyond[n]):
            continue
        end[n] = abs(xyz[start, k, 0] - xyz[m, k, 0]) + beyond[n]
        near = _last_points(xyz, label, added, start, k, -way, 0, d[n], z[n])
        high = max(high, z[n, 0])
        for j in range(near):
            # the row itself bends, not only those pooled with it
            if xyz[start + j * way, k, 2] > _FLAT * xyz[start, k, 2]:
                count[n] = near
    low = rim = 0.0
    for _ in range(_HALVINGS + 1):
        longer, told = 0.0, 0
        for n in range(many):
            length = conic(d[n], z[n], count[n], 2.0 * end[n], rim)[4]
            if length > 0.0:
                longer += length - end[n]
                told += 1
        if told < _RIM_ROWS_MIN:
            return math.nan
        if rim == 0.0 and longer <= 0.0:
            return 0.0
        low, high = (rim, high) if longer > 0.0 else (low, rim)
        rim = 0.5 * (low + high)
    return rim


@inlined
def _usual(values: Floats) -> float:
    """Give the mean without the lowest and the highest tenth."""
    ordered = np.sort(values)
    tenth = ordered.size // 10
    return float(np.mean(ordered[tenth : ordered.size - tenth]))


@float_kernel
def reach_of(xyz: Floats, label: Labels, added: Flags, by_row: Floats) -> Floats:
    """Give (product + 1, row) how far flanks reach, in lengths of their conics, by the side that is seen.

    Behind a product, each row is lost at some height. On the side towards the camera the same row is seen
    down to the rim: a conic through what lies above that height there, compared with where the row truly
    ends, says how far this product's sections are from conics: foods that bulge more fall off sooner. 1 where
    too few rows tell, and at most: what ends in a point on the one side hardly does so on the other.
    """
    points = label.shape[1]
    products = by_row.shape[0] - 1
    told, at, count = (
        np.empty((products + 1, points)),
        np.empty((products + 1, points)),
        np.zeros(products + 1, np.int64),
    )
    d, z = np.empty(POINTS), np.empty(POINTS)
    for k in range(points):
        for number in range(1, products + 1):
            way, edge, lost = _seen_side(label, added, number, k)
            if way == 0 or math.isnan(by_row[number, k]):
                continue
            i = edge
            while i != lost and label[i, k] == number and xyz[i, k, 2] < xyz[lost, k, 2]:
                i += way
            if label[i, k] != number or abs(i - edge) < _SEEN_MIN:
                continue
            many = _last_points(xyz, label, added, i, k, -way, 0, d, z)
            rim = by_row[number, k]
            length = conic(d, z, many, 10.0 * xyz[i, k, 2], rim)[4]
            above, next_above = xyz[edge, k, 2] - rim, xyz[edge + way, k, 2] - rim
            beyond = 0.0  # from the outermost point to the rim heights grow as a root does
            if next_above > above > 0.0:
                step = abs(xyz[edge + way, k, 0] - xyz[edge, k, 0])
                beyond = min(step * above * above / (next_above * next_above - above * above), step)
            if length > 0.0:
                told[number, count[number]] = (abs(xyz[i, k, 0] - xyz[edge, k, 0]) + beyond) / length
                at[number, count[number]] = k
                count[number] += 1
    reach = np.ones((products + 1, points))
    for number in range(1, products + 1):
        if count[number] >= _RIM_ROWS_MIN:
            reach[number] = _by_groups(at[number], told[number], count[number], points)
            for k in range(points):
                reach[number, k] = min(max(reach[number, k], _REACH_MIN), 1.0)
    return reach


@inlined
def _seen_side(label: Labels, added: Flags, number: int, k: int) -> tuple[int, int, int]:
    """Give the way inwards from the side of a row that is seen, its last slice there, and that behind.

    Seen: belt is right beside it, while the row is lost on the other side; else the way is 0.
    """
    slices = label.shape[0]
    first, last = -1, -1
    for i in range(slices):
        if label[i, k] == number and not added[i, k]:
            first, last = i if first < 0 else first, i
    if first < 1 or last >= slices - 1:
        return 0, first, last
    lost_before, lost_behind = label[first - 1, k] < 0, label[last + 1, k] < 0
    if lost_before == lost_behind:
        return 0, first, last
    way, edge, lost = (1, first, last) if lost_behind else (-1, last, first)
    return way if label[edge - way, k] == 0 else 0, edge, lost


@float_kernel
def doubt_of(xyz: Floats, label: Labels, added: Flags, by_row: Floats, reach: Floats) -> Floats:
    """Give (product + 1,) how far off areas under followed flanks are, relative, by the side that is seen.

    As in `reach_of`, a conic through what lies above the height at which the row is lost behind is followed
    down the other side, as far as `reach` says, and its area compared with what is seen there. Single rows
    tell too little, for an edge lies anywhere between two lines; so rows are taken together in groups, and
    the groups' root mean square is given: bulges that are no conics add to it, whichever way they go. It
    holds for a body that is as irregular behind as in front. NaN where too few rows tell.
    """
    points = label.shape[1]
    products = by_row.shape[0] - 1
    seen, told = np.empty((products + 1, points)), np.empty((products + 1, points))
    count = np.zeros(products + 1, np.int64)
    d, z = np.empty(POINTS), np.empty(POINTS)
    for k in range(points):
        for number in range(1, products + 1):
            way, edge, lost = _seen_side(label, added, number, k)
            if way == 0:
                continue
            i, area = edge, 0.5 * xyz[edge, k, 2] * abs(xyz[edge, k, 0] - xyz[edge - way, k, 0])
            while i != lost and label[i, k] == number and xyz[i, k, 2] < xyz[lost, k, 2]:
                after = i + way
                if label[after, k] == number:
                    area += 0.5 * (xyz[i, k, 2] + xyz[after, k, 2]) * abs(xyz[after, k, 0] - xyz[i, k, 0])
                i = after
            if label[i, k] != number or i == edge:
                continue
            many = _last_points(xyz, label, added, i, k, -way, 0, d, z)
            r, a, b, c, length = conic(d, z, many, 10.0 * xyz[i, k, 2], by_row[number, k])
            if length <= 0.0:
                continue
            conics = 0.0
            for step in range(_AREA_STEPS):
                at = (step + 0.5) / _AREA_STEPS * length
                conics += (r + math.sqrt(max(a + b * at + c * at * at, 0.0))) * length / _AREA_STEPS
            seen[number, count[number]], told[number, count[number]] = area, conics * reach[number, k]
            count[number] += 1
    doubt = np.full(products + 1, np.nan)
    for number in range(1, products + 1):
        groups, many = min(_RIM_GROUPS, count[number] // _RIM_ROWS_MIN), count[number]
        if groups == 0:
            continue
        total = 0.0
        for g in range(groups):
            part = slice(g * many // groups, (g + 1) * many // groups)
            off = np.sum(seen[number, part]) - np.sum(told[number, part])
            total += (off * groups / np.sum(told[number, :many])) ** 2
        doubt[number] = math.sqrt(total / groups)
    return doubt


@float_kernel
def _by_groups(at: Floats, values: Floats, many: int, points: int) -> Floats:
    """Give (row,) neighbouring rows' usual values, straight between the middles of their groups."""
    groups = min(_RIM_GROUPS, many // _RIM_ROWS_MIN)
    row, usual = np.empty(groups), np.empty(groups)
    for g in range(groups):
        part = slice(g * many // groups, (g + 1) * many // groups)
        row[g], usual[g] = np.mean(at[part]), _usual(values[part])
    return np.interp(np.arange(points), row, usual)


@inlined
def _on_conic(away: float, length: float, reach: float) -> float:
    """Give where on its conic a flank that reaches another length is at a place: alike at its beginning."""
    less = 1.0 - reach
    if abs(less) < 1e-9 or away >= reach * length:
        return away
    return length * (1.0 - math.sqrt(max(1.0 - 4.0 * less * away / length, 0.0))) / (2.0 * less)


@float_kernel
def _last_points(
    xyz: Floats, label: Labels, added: Flags, i: int, k: int, way_i: int, way_k: int, d: Floats, z: Floats
) -> int:  # fmt: skip
    """Take the points that tell how a flank goes on: how far in they lie, and how high; their number."""
    slices, points = label.shape
    number, axis = label[i, k], 0 if way_i != 0 else 1
    count, m, n = 0, i, k
    while 0 <= m < slices and 0 <= n < points and label[m, n] == number and count < POINTS:
        if not added[m, n]:
            d[count] = abs(xyz[m, n, axis] - xyz[i, k, axis])
            if count >= _POINTS_MIN and d[count] > _REACH * xyz[i, k, 2]:
                break
            z[count] = _pooled(xyz, label, added, m, n, axis)
            count += 1
        m -= way_i
        n -= way_k
    return count


@float_kernel
def _pooled(xyz: Floats, label: Labels, added: Flags, m: int, n: int, axis: int) -> float:
    """Give the mean height of a point and of its neighbours across the way that is followed."""
    slices, points = label.shape
    total, count = xyz[m, n, 2], 1
    for far in range(1, _POOLED + 1):
        down, right = (0, far) if axis == 0 else (far, 0)
        a, b, c, d = m - down, n - right, m + down, n + right
        if a < 0 or b < 0 or c >= slices or d >= points:
            break
        both = label[a, b] == label[m, n] and label[c, d] == label[m, n]
        if not both or added[a, b] or added[c, d]:
            break
        total += xyz[a, b, 2] + xyz[c, d, 2]
        count += 2
    return total / count


@float_kernel
def _join(xyz: Floats, label: Labels, added: Flags, plane: Floats) -> None:
    """Join what is not seen between two points of one product in a slice by a straight line."""
    slices, points = label.shape
    for i in range(slices):
        last = -1
        for k in range(points):
            if label[i, k] < 0:
                continue
            if last >= 0 and k - last > 1 and label[i, k] > 0 and label[i, k] == label[i, last]:
                for m in range(last + 1, k):
                    share = (m - last) / (k - last)
                    y = xyz[i, last, 1] + share * (xyz[i, k, 1] - xyz[i, last, 1])
                    z = xyz[i, last, 2] + share * (xyz[i, k, 2] - xyz[i, last, 2])
                    xyz[i, m, 0] = (plane[i, 3] - plane[i, 1] * y - plane[i, 2] * z) / plane[i, 0]
                    xyz[i, m, 1], xyz[i, m, 2] = y, z
                    label[i, m], added[i, m] = label[i, k], True
            last = k


@float_kernel
def _fill(
    xyz: Floats,
    label: Labels,
    added: Flags,
    plane: Floats,
    rim: float,
    reach: float,
    ends: Floats,
    known: bool,
    i: int,
    k: int,
    way_i: int,
    way_k: int,
) -> int:  # fmt: skip
    """Follow a flank from a product's last point over what is not seen to the belt; give where that ends.

    Along the belt, `ends` (product + 1, row) is written where it is not `known` yet: the X at which flanks
    end, positive outwards. Where it is, the flank is followed, to a spacing of slices beyond the ends of the
    rows beside it at most: a row that skims the product's side hardly bends, and would be followed far beyond
    it. A row that does not bend at all, where most of those beside it do, ends where they end.
    """
    slices, points = label.shape
    number, axis = label[i, k], 0 if way_i != 0 else 1
    d, z = np.empty(POINTS), np.empty(POINTS)
    count = _last_points(xyz, label, added, i, k, way_i, way_k, d, z)
    far_i, far_k = i + way_i, k + way_k
    while 0 <= far_i < slices and 0 <= far_k < points and label[far_i, far_k] < 0:
        far_i += way_i
        far_k += way_k
    stop = far_i if axis == 0 else far_k
    if added[i, k]:
        return stop  # an edge that is itself no more than followed
    x0, y0, z0 = xyz[i, k, 0], xyz[i, k, 1], xyz[i, k, 2]
    if 0 <= far_i < slices and 0 <= far_k < points:
        if label[far_i, far_k] != 0:
            return stop
        x1, y1 = xyz[far_i, far_k, 0], xyz[far_i, far_k, 1]
    elif axis == 0:  # the scan ends in the shadow
        edge = far_i - way_i
        x1, y1 = (plane[edge, 3] - plane[edge, 1] * y0) / plane[edge, 0], y0
    else:
        return stop
    most = abs(x1 - x0) if axis == 0 else abs(y1 - y0)
    r, a, b, c, length = conic(d, z, count, most, rim)
    farthest = reach * length
    if axis == 0:
        step = plane[i + way_i, 3] / plane[i + way_i, 0] - plane[i, 3] / plane[i, 0]
        x0_out = math.copysign(1.0, step) * x0
        if not known:
            if length > 0.0:
                ends[number, k] = x0_out + farthest
            return stop
        beside = ends[number, max(k - _BESIDE, 0) : k + _BESIDE + 1]
        end = np.nanmedian(beside) - x0_out
        if length > 0.0:
            farthest = min(farthest, end + abs(step))
        elif end > 0.0 and z0 > rim and 2 * np.count_nonzero(np.isfinite(beside)) > beside.size:
            # flat as far as it is seen, where those beside it bend: the top of an ellipse
            r, a, b, reach, length, farthest = rim, (z0 - rim) ** 2, 0.0, 1.0, end, end
            c = -a / (end * end)
    if length <= 0.0:
        return stop
    m, n = i + way_i, k + way_k
    cells = abs(far_i - i) + abs(far_k - k)
    for step in range(1, cells):
        share = step / cells
        # seen from the camera, a point lies the nearer to the belt's place in this row the lower it is
        height, x, y = z0, x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        for _ in range(3):
            if axis == 0:
                y = y1 + (y0 - y1) * height / z0
                x = (plane[m, 3] - plane[m, 1] * y - plane[m, 2] * height) / plane[m, 0]
                away = abs(x - x0)
            else:
                x = (plane[m, 3] - plane[m, 1] * y - plane[m, 2] * height) / plane[m, 0]
                away = abs(y - y0)
            at = _on_conic(away, length, reach)
            height = r + math.sqrt(max(a + b * at + c * at * at, 0.0))
        if away < farthest and height > 0.0:
            xyz[m, n, 0], xyz[m, n, 1], xyz[m, n, 2] = x, y, height
            label[m, n], added[m, n] = number, True
        m += way_i
        n += way_k
    return stop
