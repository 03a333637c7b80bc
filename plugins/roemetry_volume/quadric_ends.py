"""The quadric through a product's outer slices, and what lies beyond the outermost of them.

Model. In three outer slices the heights follow (z − r)² = Q(x, y), Q of second degree, as those of
ellipsoids, balls and caps do (`quadric_end`); what is below it beyond the outermost slice is the end.

Assumed: the end is a part of the body that the three slices show. It fails where it is not: residuals, the
outer slice's area or the size tell, nothing is given, and the slices' taper counts alone
(`roemetry_volume.slice_rules`).
"""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers, Labels
from roemetry_kernels.compiling import float_kernel
from roemetry_volume.slice_table import (
    AREA,
    AT,
    COUNT,
    FIRST_ROW,
    LAST_ROW,
    LOOSE,
    TOP,
    WALL,
    WIDTH,
    three_outer,
)

VOLUME, LENGTH, SHADOW, RIM_MM, RESIDUAL_MM = range(5)
"""What `quadric_end` gives: volume beyond the outer slice (mm³) and how far it reaches (mm); what the slices
count too much because leaning light passes over the end, negative (mm³); height of the rim; how far off the
quadric the points lie (mm). All are NaN where no quadric closes there."""

_UNIT_MM = 10.0  # of the local frame: numbers near 1 keep the normal equations sound
_GROUPS = 20  # of points, along a slice
_TERMS = 7  # of the equation: z and six of Q
_NODES = 12  # of the midpoint rule along the end, which is smooth but for its tip
_BEYOND = 1.15  # of the farthest the end may reach: a quadric still open there does not close
_AREA_OFF = 0.3  # of the outer slice: a quadric whose section differs by more is another body
_LARGER = 1.25
"""Than all that was seen, in height or half-width: no end grows so much unseen. A larger bound changes
nothing on 66 images, for the section tells, too; at 1.0 volumes change by up to 1.8 %."""


@float_kernel
def quadric_end(
    xyz_mm: Floats,
    product: Labels,
    seen: Flags,
    row_px: Floats,
    plane: Floats,
    number: int,
    table: Floats,
    place: Integers,
    at_end: int,
    reach_mm: float,
    limited: bool,
) -> tuple[float, float, float, float, float]:
    """Fit (z − r)² = Q(x, y), Q of second degree, through three slices and take the volume beyond them.

    Every ellipsoid that stands or lies on the belt with a level rim is one, a ball and a cap of one, too. In
    the outer slices' own planes of light its sections are known, however those lean: towards the projector
    they fall faster, away from it slower than a parabola. There light that leans passes over the end; the
    slices' areas, summed over where the planes cut the belt, count what stands in its shadow as product.

    Parameters
    ----------
    xyz_mm, product, seen, row_px, plane : ndarray
        As in `Profiles`.
    number
        Number of the product.
    table, place
        Rows of `slice_areas` along rising rest X, and where each slice is in `Profiles`.
    at_end
        0 the first slice, 1 the last.
    reach_mm, limited
        Distance within which the end must lie, and whether there is a stripe that shows none.

    Returns
    -------
    tuple of float
        As named above.
    """
    nothing = (np.nan, np.nan, np.nan, np.nan, np.nan)
    three = three_outer(table[:, AT], at_end)
    sign = 1.0 if at_end == 1 else -1.0
    rows = np.array([place[three[0]], place[three[1]], place[three[2]]])
    ends = np.empty((3, 3))
    for k in range(3):
        mine = table[three[k]]
        ends[k, 0], ends[k, 1], ends[k, 2] = mine[FIRST_ROW], mine[LAST_ROW], mine[COUNT]
    outer, area_mm2 = rows[0], table[three[0], AREA]
    nx, ny, nz, d = plane[outer, 0], plane[outer, 1], plane[outer, 2], plane[outer, 3]
    # the Y of the outer slice's first point is the local frame's origin
    y_ref = np.nan
    for k in range(product.shape[1]):
        if product[outer, k] == number and seen[outer, k]:
            y_ref = xyz_mm[outer, k, 1]
            break
    if not table[three[0], COUNT] > 3.0 or np.isnan(y_ref):
        return nothing
    x_ref = (d - ny * y_ref) / nx
    means, count = _means(xyz_mm, product, seen, row_px, number, rows, ends, sign, x_ref, y_ref)
    if count < 2 * _TERMS:
        return nothing
    normal, right, tall = _normal_equations(means, count)
    c = _solved(normal, right)
    r = c[0]
    # (z − r)² off by e is z off by e / 2 (z − r)
    residual_mm = _UNIT_MM * _misfit(means, count, c) / (2.0 * max(abs(tall - r), 0.01))
    # closed along and across, with its rim below the points
    if not (c[4] < 0.0 and c[6] < 0.0 and r < tall):
        return nothing
    # Q in the local frame, where the plane of the outer slice is x = q·y + m·z
    q, m = -sign * ny / nx, -sign * nz / nx
    # z² = 2 r z + Q′ is (z − r)² = Q′ + r²
    c[1] += r * r
    if _is_larger(c, table):
        return nothing
    section = _section(c, m, q, 0.0)  # the area of the outer slice, or the quadric is another one
    if not abs(_UNIT_MM**2 * section - area_mm2) < _AREA_OFF * area_mm2:
        return nothing
    far = _BEYOND * reach_mm / _UNIT_MM
    if _is_there(c, m, q, far):
        return nothing
    # bisection for where the section vanishes
    low, high = 0.0, far
    for _ in range(24):
        middle = 0.5 * (low + high)
        if _is_there(c, m, q, middle):
            low = middle
        else:
            high = middle
    length = min(high, reach_mm / _UNIT_MM) if limited else high
    volume = _beyond(c, m, q, length, high)
    shadow = shadow_of(c, m, q, _fanning(plane, table, place))
    cubic = _UNIT_MM**3
    return cubic * volume, _UNIT_MM * length, cubic * shadow, _UNIT_MM * r, residual_mm


@float_kernel
def _means(
    xyz_mm: Floats, product: Labels, seen: Flags, row_px: Floats, number: int, rows: Integers,
    ends: Floats, sign: float, x_ref: float, y_ref: float,
) -> tuple[Floats, int]:  # fmt: skip
    """Give means over neighbouring points of the terms of z² = 2r·z + Q′, of z², their weights and slices."""
    means = np.zeros((3 * (2 * _GROUPS + 1), _TERMS + 3))
    count = 0
    for which in range(rows.size):
        i = rows[which]
        first, last = ends[which, 0], ends[which, 1]
        size = max(int(ends[which, 2]) // _GROUPS, 1)
        mean = means[count]
        held = 0
        for k in range(product.shape[1]):
            if row_px[i, k] > last:
                break
            if not (product[i, k] == number and seen[i, k] and row_px[i, k] >= first):
                continue
            x, y = sign * (xyz_mm[i, k, 0] - x_ref) / _UNIT_MM, (xyz_mm[i, k, 1] - y_ref) / _UNIT_MM
            z = xyz_mm[i, k, 2] / _UNIT_MM
            mean[0] += 2.0 * z
            mean[1] += 1.0
            mean[2] += x
            mean[3] += y
            mean[4] += x * x
            mean[5] += x * y
            mean[6] += y * y
            mean[7] += z * z
            held += 1
            if held < size:
                continue
            for a in range(_TERMS + 1):
                mean[a] /= held
            mean[_TERMS + 1] = size / (3.0 * ends[which, 2])
            mean[_TERMS + 2] = which
            count += 1
            if count == means.shape[0]:
                return means, count
            mean = means[count]
            held = 0
        mean[:] = 0.0
    return means, count


@float_kernel
def _normal_equations(means: Floats, count: int) -> tuple[Floats, Floats, float]:
    """Sum up the normal equations, each slice weighing 1/3; also the mean z."""
    normal, right = np.zeros((_TERMS, _TERMS)), np.zeros(_TERMS)
    tall = 0.0
    for k in range(count):
        mean = means[k]
        share = mean[_TERMS + 1]
        for a in range(_TERMS):
            for b in range(a + 1):
                normal[a, b] += share * mean[a] * mean[b]
            right[a] += share * mean[a] * mean[_TERMS]
        tall += share * 0.5 * mean[0]
    return normal, right, tall


@float_kernel
def _misfit(means: Floats, count: int, c: Floats) -> float:
    """Root mean square by which the points lie off, in z², less the noise that neighbours do not share."""
    square, noise = 0.0, 0.0
    before, slice_before = 0.0, -1.0
    for k in range(count):
        off = means[k, _TERMS]
        for a in range(_TERMS):
            off -= c[a] * means[k, a]
        square += means[k, _TERMS + 1] * off * off
        # half of the squared difference of neighbours is noise
        if means[k, _TERMS + 2] == slice_before:
            noise += 0.5 * means[k, _TERMS + 1] * (off - before) ** 2
        before, slice_before = off, means[k, _TERMS + 2]
    return math.sqrt(max(square - noise, 0.0))


@float_kernel
def _solved(normal: Floats, right: Floats) -> Floats:
    """Solve by Cholesky's factors of the lower triangle, which it overwrites; a touch of damping."""
    n = right.size
    for i in range(n):
        normal[i, i] += 1e-10
    for j in range(n):
        for k in range(j):
            normal[j, j] -= normal[j, k] * normal[j, k]
        normal[j, j] = math.sqrt(max(normal[j, j], 1e-14))
        for i in range(j + 1, n):
            for k in range(j):
                normal[i, j] -= normal[i, k] * normal[j, k]
            normal[i, j] /= normal[j, j]
    found = right.copy()
    for i in range(n):
        for k in range(i):
            found[i] -= normal[i, k] * found[k]
        found[i] /= normal[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            found[i] -= normal[k, i] * found[k]
        found[i] /= normal[i, i]
    return found


@float_kernel
def _is_larger(c: Floats, table: Floats) -> bool:
    """Whether the quadric, where it is highest, is far higher or wider than the product: another body's."""
    top, width = 0.0, 0.0
    for i in range(table.shape[0]):
        top, width = max(top, table[i, TOP]), max(width, table[i, WIDTH])
    # Q at its summit, and its fall across there
    det = 4.0 * c[4] * c[6] - c[5] * c[5]
    if not det > 0.0:
        return True
    x, y = (c[5] * c[3] - 2.0 * c[6] * c[2]) / det, (c[5] * c[2] - 2.0 * c[4] * c[3]) / det
    summit = c[1] + 0.5 * (c[2] * x + c[3] * y)
    across = 2.0 * math.sqrt(max(summit, 0.0) / -c[6])
    high = c[0] + math.sqrt(max(summit, 0.0))
    return _UNIT_MM * high > _LARGER * top or _UNIT_MM * across > 2.0 * _LARGER * width


@float_kernel
def _is_there(c: Floats, m: float, q: float, at: float) -> bool:
    """Whether the section with x = at + q·y + m·z has an area."""
    begin, end, _, _, _, _, _ = _extent(c, m, q, at)
    return end > begin


@float_kernel
def _section(c: Floats, m: float, q: float, at: float) -> float:
    """Area, down to the belt, of the section with x = at + q·y + m·z, where the surface is over its rim."""
    begin, end, middle, half, b0, b1, d2 = _extent(c, m, q, at)
    if not end > begin:
        return 0.0
    area = (end - begin) * (b0 + 0.5 * b1 * (begin + end))
    area += math.sqrt(-d2) * (_half_disc(end - middle, half) - _half_disc(begin - middle, half))
    return area / (1.0 - c[4] * m * m)


@float_kernel
def _extent(
    c: Floats, m: float, q: float, at: float
) -> tuple[float, float, float, float, float, float, float]:
    """From where to where along y it is; with z = (b0 + b1·y + √D)/a the middle and half of D's roots."""
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    r, low = c[0], max(c[0], 0.0)
    a = 1.0 - c[4] * m * m
    # D is of second degree in y
    b0, b1 = r + 0.5 * m * (c[2] + 2.0 * c[4] * at), 0.5 * m * (2.0 * c[4] * q + c[5])
    g0 = r * r - (c[1] + at * (c[2] + at * c[4]))
    g1 = -(q * (c[2] + 2.0 * c[4] * at) + c[3] + c[5] * at)
    g2 = -(c[4] * q * q + c[5] * q + c[6])
    d0, d1, d2 = b0 * b0 - a * g0, 2.0 * b0 * b1 - a * g1, b1 * b1 - a * g2
    if not d2 < 0.0:
        return nothing
    middle = -0.5 * d1 / d2
    top = d0 + 0.5 * d1 * middle
    if not top > 0.0:
        return nothing
    half = math.sqrt(top / -d2)
    begin, end = middle - half, middle + half
    # where the section comes down to its lowest height before it turns back
    at_low = at + m * low
    f0 = c[1] + at_low * (c[2] + at_low * c[4]) - (low - r) ** 2
    f1 = q * (c[2] + 2.0 * c[4] * at_low) + c[3] + c[5] * at_low
    centre = 0.5 * f1 / g2
    chord = (f0 + 0.5 * f1 * centre) / g2
    if (b0 + b1 * begin) / a < low:
        if not chord > 0.0:
            return nothing
        begin = max(centre - math.sqrt(chord), begin)
    if (b0 + b1 * end) / a < low:
        if not chord > 0.0:
            return nothing
        end = min(centre + math.sqrt(chord), end)
    return begin, end, middle, half, b0, b1, d2


@float_kernel
def _half_disc(u: float, half: float) -> float:
    """∫√(half² − u²) du from 0."""
    share = min(max(u / half, -1.0), 1.0)
    return 0.5 * half * half * (share * math.sqrt(1.0 - share * share) + math.asin(share))


@float_kernel
def _beyond(c: Floats, m: float, q: float, length: float, root: float) -> float:
    """Integrate the section from 0 to a length, in √(root − x), in which it is smooth at the root."""
    begin, end = math.sqrt(max(root - length, 0.0)), math.sqrt(root)
    step = (end - begin) / _NODES
    total = 0.0
    for k in range(_NODES):
        # two points after Gauss in each part
        for place in (0.21132486540518712, 0.7886751345948129):
            s = begin + (k + place) * step
            total += 0.5 * step * 2.0 * s * _section(c, m, q, root - s * s)
    return total


@float_kernel
def _fanning(plane: Floats, table: Floats, place: Integers) -> float:
    """How much dX/dz of the planes of light changes along rest X, per unit."""
    n = table.shape[0]
    first, last = place[0], place[n - 1]
    change = plane[first, 2] / plane[first, 0] - plane[last, 2] / plane[last, 0]
    return _UNIT_MM * change / (table[n - 1, AT] - table[0, AT])


_LINES = 16  # Gauss-Chebyshev nodes across the end
_ROUNDS = 4  # of a fixed point: the light's lean changes little along an end


@float_kernel
def shadow_of(c: Floats, m: float, q: float, fanning: float) -> float:
    """What leaning light sees of the end in its own shadow, less than nothing; nothing if it leans outwards.

    Line by line along x: behind the place where the ray grazes, the slices count the triangle below the ray;
    of that the product fills a part, and the same rim on the near side, which no camera above sees, another.
    Beside the product's middle the ray grazes nearer to the projector, and leans less there.

    Parameters
    ----------
    c : ndarray, shape (7,)
        (z − c₀)² = c₁ + c₂x + c₃y + c₄x² + c₅xy + c₆y².
    m, q, fanning
        The outer slice's plane of light is x = q·y + m·z; how m changes along x.

    Returns
    -------
    float
        Volume, in the units of the quadric.
    """
    if not m < 0.0:
        return 0.0
    r, low, k = c[0], max(c[0], 0.0), -c[4]
    u0, u1, u2 = c[1] + c[2] * c[2] / (4.0 * k), c[3] + 0.5 * c[2] * c[5] / k, c[6] + 0.25 * c[5] * c[5] / k
    if not u2 < 0.0:
        return 0.0
    middle = -0.5 * u1 / u2
    top = u0 + 0.5 * u1 * middle
    if not top > 0.0:
        return 0.0
    half, root = math.sqrt(top / -u2), math.sqrt(k)
    total = 0.0
    for node in range(_LINES):
        # nodes in the angle: both ends' roots are smooth in it
        turn = math.pi * ((node + 0.5) / _LINES - 0.5)
        s, y = math.sqrt(top) * math.cos(turn), middle + half * math.sin(turn)
        centre = 0.5 * (c[2] + c[5] * y) / k
        lean, along, up = -m, 0.0, 0.0
        for _ in range(_ROUNDS):
            # where the ray grazes, as sine and cosine of the ellipse's angle from its top
            up = lean * root / math.sqrt(1.0 + lean * lean * k)
            along = 1.0 / math.sqrt(1.0 + lean * lean * k)
            at = centre + s / root * along + lean * (r + s * up) - q * y
            lean = max(-(m + fanning * at), 0.0)
        height = r + s * up
        if height <= low or not lean > 0.0:
            continue
        graze = math.acos(up)
        foot, foot_sine, foot_cosine = 0.5 * math.pi, 1.0, 0.0
        if r < 0.0:
            foot_cosine = min(-r / s, 1.0)
            foot, foot_sine = math.acos(foot_cosine), math.sqrt(1.0 - foot_cosine * foot_cosine)
        if foot <= graze:
            continue
        body = r * s / root * (foot_sine - along)
        body += 0.5 * s * s / root * (foot - graze + foot_sine * foot_cosine - along * up)
        # of the triangle below the ray the product fills a part
        off = body - 0.5 * lean * (height * height - low * low)
        total += off * half * math.cos(turn) * math.pi / _LINES
    return total


_APART = 3  # points: near enough for a parabola, far enough for noise
_FARTHEST = 8.0
"""Of the points' distance: more than the camera does not see of a steep rim. At 6.4 volumes change by up to
0.8 %; without the bound by up to 20 %."""


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
    # how fast planes of light open along X
    opening = (lean[0] + lean[1]) / (table[n - 1, AT] - table[0, AT])
    points = np.empty((product.shape[1], 2))
    total = 0.0
    for k in range(n):
        # slices of this end's half; of an odd number the middle one counts half
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
        if count > 4 * _APART and table[k, LOOSE] == 0.0:  # else what is beyond is in the area already
            missed += _beyond_slice(points, 0, 1, rim_mm) + _beyond_slice(points, count - 1, -1, rim_mm)
        total += mine * held * missed
    return total


@float_kernel
def _beyond_slice(points: Floats, first: int, step: int, rim_mm: float) -> float:
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
