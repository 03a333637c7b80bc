"""Volume from areas at uneven places: cubics between the slices, and caps beyond the outer ones.

Model. Between slices A(t) is followed by a monotone cubic (`between_slices`) and integrated. Beyond an outer
slice a parabola through three outer areas falls to zero at some distance (`taper_of`): that is the cap's
volume and length. Where a quadric through the points of three outer slices closes beyond them and leaves
residuals of less than some hundredths of a millimetre (`quadric_ends`), it is believed instead, by a trust
that falls from 1 to 0 around that residual. Of an end that does not taper, and beyond which a stripe shows
belt, half of the way to that stripe is counted, and anything up to it is in the interval.

Assumed: beyond the outer slice the product goes on as it came. It fails at upright ends before the next
stripe (by up to half a spacing, which the interval says) and where leaning light passes over a tall body's
end without a quadric to say what stands in its shadow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.records import Product
from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import kernel
from roemetry_volume.quadric_ends import edges_missed, quadric_end
from roemetry_volume.slice_table import AREA, SQUARE, TOP, WALL, WIDTH, Slices, three_outer

NO_CAP, TAPERED, BLUNT = 0.0, 1.0, 2.0  # numbers, for kernels keep them beside lengths

WAIST = 0.35
"""A slice under that share of some on both sides of it is a waist."""

_BEYOND = 1.15
"""A taper that would reach so many times the way to the next stripe, which shows belt, is half believed.
Volumes from slices depend most on this: at 1.44 they change by up to 1.8 % (r.m.s. 0.6), at 0.92 by 0.5 %,
and their standard uncertainty by up to 82 %."""
_SURE = 16
"""How fast that belief falls: from 0.9 at 1.0 of the way to 0.1 at 1.3. A step would make volume and interval
jump with the noise."""

# chosen so that 95 % intervals hold the truth as often as they say: docs/reference/plugins/slice-pchip.md
_TAPER_STD = 0.11  # of a tapered cap's volume
_OPEN_TAPER_STD = 0.35  # the same with no stripe beyond that shows belt
_QUADRIC_STD = 0.12  # of a quadric's cap
_SHADOW_STD = 0.5  # of what leaning light counts too much behind an end, by the quadric
_RIM_STD = 0.3  # of that triangle below the rim, where no quadric tells it
_FITS_MM = 0.07  # a quadric that misses the points by so much is believed by half; ± 0.015: 0.4 % at most
_HARDLY = 0.02  # trust: less changes nothing that anyone could measure
_BLUNT_STD = 2.0 / math.sqrt(12.0)  # of a cap of half the way to the next stripe
_WALL_STD = 0.5 / math.sqrt(3.0)  # of the way that a plane leans over the height of an end wall
_LEVEL = 0.9
"""Of the next slice's height: an outer slice so high may have an upright end beyond it or before it, anywhere
up to the next stripes, and light that leans passes over that (a rectangle each). Intervals depend most
on this: at 0.72 some are 3.2 times as wide (r.m.s. 56 %), without the rule all 19 % narrower (r.m.s.)."""
_OPEN_SPACINGS = 2.0  # beyond the outer slice, and
_OPEN_SHARE = 0.2
"""Of the product's lit length; beyond either, an open end's taper is not believed. At 0.25 one open end is
believed that is not at 0.2: 1.3 % of that volume."""


class Cap(NamedTuple):
    """What lies beyond an outer slice.

    `kind` is `NO_CAP`, `TAPERED` or `BLUNT`; `slope_mm` is dA/dt at the outer slice (NaN: no taper);
    `shadow_mm3` what leaning light makes the slices count too little at this end, or, negative, too much.
    """

    volume_mm3: float
    length_mm: float
    slope_mm: float
    kind: float
    shadow_mm3: float
    std_mm3: float


def cap_of(product: Product, slices: Slices, end: int) -> Cap:
    """Give what lies beyond the first (`end` 0) or the last (1) slice."""
    limited, within = slices.limited[end], within_mm(slices, end)
    found = by_areas(slices, end, within)
    volume, length, shadow, rim_mm, off_mm = quadric_end(
        slices.profiles.xyz_mm,
        slices.profiles.product,
        slices.profiles.seen,
        slices.profiles.row_px,
        slices.profiles.plane,
        product.number,
        slices.table,
        slices.place,
        end,
        within,
        limited,
    )
    # falls smoothly, and is a half at `_FITS_MM`
    trust = 1.0 / (1.0 + (off_mm / _FITS_MM) ** 10) if off_mm < 3.0 * _FITS_MM else 0.0
    if trust < _HARDLY:
        return found
    # what the slices miss at their own ends, now that the rim's height is known
    shadow += edges_missed(
        slices.profiles.xyz_mm,
        slices.profiles.product,
        slices.profiles.row_px,
        product.number,
        slices.table,
        slices.place,
        end,
        slices.lean,
        max(rim_mm, 0.0),
    )
    own = math.hypot(_QUADRIC_STD * volume, _SHADOW_STD * shadow)
    return _mixed(Cap(volume, length, found.slope_mm, TAPERED, shadow, own), found, trust)


def by_areas(slices: Slices, end: int, within: float) -> Cap:
    """Give what the slices' areas say of an end."""
    outer, lean, limited = slices.table[-end].tolist(), slices.lean[end], slices.limited[end]
    area, reach = outer[AREA], slices.reach_mm[end]
    volume, length, slope, trust = taper_of(slices.t_mm, slices.area_mm2, end, within, limited)
    tapered = Cap(volume, length, slope, TAPERED, 0.0, (_TAPER_STD if limited else _OPEN_TAPER_STD) * volume)
    if trust > 0.0 and lean < 0.0 and not limited:
        tapered = _in_shadow(slices, end, within, tapered)
    # an upright end: light that leans passes over its height
    wall_mm3 = _WALL_STD * abs(lean) * max(outer[TOP], 0.0) * area
    half = 0.5 * reach * area
    blunt = Cap(half, 0.5 * reach, math.nan, BLUNT, 0.0, math.hypot(_BLUNT_STD * half, wall_mm3))
    if limited or trust > 0.0:
        found = _mixed(tapered, blunt, trust)
    else:
        span = float(slices.t_mm[-1] - slices.t_mm[0])
        found = Cap(0.0, 0.0, math.nan, NO_CAP, 0.0, _OPEN_SHARE * area * span)
    return found._replace(std_mm3=math.hypot(found.std_mm3, _ends_std(slices, end)))


def _in_shadow(slices: Slices, end: int, within: float, tapered: Cap) -> Cap:
    """Give the taper of an open end that light passes over: the mean of `tapered` and an upright one.

    Below the outer slice, which leans over the end, lies the end's own shadow, and the product may end in
    it. So for the second, what is below the slice and beyond its surface is taken off, ½|lean|·∫ z² dy, and
    the product goes on from the surface, by the taper of the seen areas at the places where the slices meet
    it on average. Where no stripe beyond shows belt, the first is too large for steep ends (skeins of two
    rigs by another renderer: +1.0 to +6.2 % of the volume), the second too small for gentle ones (16 skeins
    of two simulators: −0.1 to −2.7 %, but for one of +1.8 %).
    """
    plane = slices.profiles.plane[slices.place]
    area = slices.area_mm2 - slices.loose_mm2
    # ∫ z² dy over the area of the same points: without what is filled over missing rows
    x = slices.t_mm - plane[:, 2] / plane[:, 0] * slices.table[:, SQUARE] / (area - slices.filled_mm2)
    if not (np.diff(x) > 0.0).all():
        return tapered
    inside = abs(float(x[-end] - slices.t_mm[-end]))
    volume, length, _, trust = taper_of(x, area, end, within + inside, False)
    if not trust > 0.0:
        return tapered
    shadow = -0.5 * abs(slices.lean[end]) * float(slices.table[-end, SQUARE])
    # a cap's length counts from where the outer plane meets the belt
    length, std = max(length - inside, 0.0), _OPEN_TAPER_STD * volume
    upright = Cap(volume, length, tapered.slope_mm, TAPERED, shadow, std)
    return _mixed(upright, tapered, 0.5)


def _mixed(one: Cap, other: Cap, trust: float) -> Cap:
    """Give the mean of two caps, the first of which is right with some probability, and its uncertainty."""
    rest, apart = 1.0 - trust, one.volume_mm3 + one.shadow_mm3 - other.volume_mm3 - other.shadow_mm3
    return Cap(
        trust * one.volume_mm3 + rest * other.volume_mm3,
        trust * one.length_mm + rest * other.length_mm,
        one.slope_mm if trust > 0.0 else other.slope_mm,
        one.kind if trust > 0.5 else other.kind,
        trust * one.shadow_mm3 + rest * other.shadow_mm3,
        # of a mixture: both variances, and that of the choice
        math.sqrt(trust * one.std_mm3**2 + rest * other.std_mm3**2 + trust * rest * apart**2),
    )


def within_mm(slices: Slices, end: int) -> float:
    """How far beyond the outer slice the end may lie, mm."""
    reach = slices.reach_mm[end]
    if slices.limited[end]:
        return reach
    return max(_OPEN_SPACINGS * reach, _OPEN_SHARE * float(slices.t_mm[-1] - slices.t_mm[0]))


def _ends_std(slices: Slices, end: int) -> float:
    """Say how far the outer slices' own ends may mislead, mm³.

    Where light leans over an end, its shadow below the rim counts, more or less; and a slice as high as its
    neighbour may have an upright end on either side of it.
    """
    outer, before = slices.table[-end].tolist(), slices.table[-2 if end else 1].tolist()
    lean = slices.lean[end]
    below_rim = 0.5 * max(-lean, 0.0) * outer[WALL] * outer[WIDTH]
    wall = 0.0
    if outer[TOP] > _LEVEL * before[TOP]:
        whole = max(outer[AREA], before[AREA])
        wall = math.hypot(slices.reach_mm[end] * whole, abs(lean) * outer[TOP] * whole) / math.sqrt(12.0)
    return math.hypot(_RIM_STD * below_rim, wall)


@kernel
def between_slices(t: Floats, area: Floats) -> float:
    """Give the volume from the first to the last slice, mm³, by Fritsch and Butland's cubics.

    Parameters
    ----------
    t : ndarray of float64, shape (n,)
        Places of the slices, mm, rising.
    area : ndarray of float64, shape (n,)
        Their areas, mm².
    """
    slopes = np.zeros(t.size)
    _pchip_slopes(t, area, slopes)
    return _integral(t, area, slopes)


@kernel
def by_spline(t: Floats, area: Floats, ends: Floats) -> float:
    """Give the same by a cubic spline, with dA/dt at its `ends` (2,), not-a-knot where that is NaN."""
    slopes = np.zeros(t.size)
    _spline_slopes(t, area, ends, slopes)
    return _integral(t, area, slopes)


@kernel
def _integral(t: Floats, area: Floats, slopes: Floats) -> float:
    """Integrate cubics by their values and slopes at the slices."""
    volume = 0.0
    for i in range(t.size - 1):
        h = t[i + 1] - t[i]
        # the trapezoid, and what the slopes bend it by
        volume += 0.5 * h * (area[i] + area[i + 1])
        volume += h * h * (slopes[i] - slopes[i + 1]) / 12.0
    return volume


@kernel
def taper_of(
    t: Floats, area: Floats, at_end: int, reach_mm: float, limited: bool
) -> tuple[float, float, float, float]:
    """Give what lies beyond an outer slice by the slices' taper.

    A parabola through three outer areas falls to zero at some distance ρ. The areas of an ellipsoid are such
    a parabola. Where they fall ever less towards the end (a point) a straight line does. The three lie some
    tenth of the product apart: of slices closer than that, noise would lead the way.

    Parameters
    ----------
    t, area : ndarray of float64, shape (n,)
        Places (mm, rising) and areas (mm²).
    at_end
        0 the first slice, 1 the last.
    reach_mm
        Distance to the next stripe beyond.
    limited
        Whether that stripe is there, and shows no product.

    Returns
    -------
    volume, length, slope, trust : float
        mm³; mm; dA/dt at the outer slice, mm; share by which the taper is believed: of a limited end that
        would reach `_BEYOND` of the way to the next stripe, half. Nothing is believed where nothing tapers.
    """
    i, j, k = three_outer(t, at_end)
    first = area[i]
    x1, x2 = abs(t[j] - t[i]), abs(t[k] - t[i])
    # area inwards: first + g·x + c·x²
    d1, d2 = (area[j] - first) / x1, (area[k] - first) / x2
    c = (d2 - d1) / (x2 - x1)
    g = d1 - c * x1
    if c > 0.0:
        c, g = 0.0, d1
    sign = 1.0 if at_end == 0 else -1.0
    root = np.inf
    if c < 0.0:
        root = (-g + np.sqrt(g * g - 4.0 * c * first)) / (-2.0 * c)
    elif g > 0.0:
        root = first / g
    over = root / (_BEYOND * reach_mm)
    trust = 1.0 / (1.0 + over**_SURE) if limited else 1.0 if over <= 1.0 else 0.0
    if not trust >= _HARDLY:
        return 0.0, 0.0, np.nan, 0.0
    length = min(root, reach_mm) if limited else root
    volume = length * (first - 0.5 * g * length + c * length * length / 3.0)
    return volume, length, sign * g, trust


@kernel
def waist(area: Floats) -> int:
    """Give the number of the smallest slice that is far smaller than some on both sides of it, or −1."""
    n, found = area.size, -1
    right = area.copy()
    for k in range(n - 2, -1, -1):
        right[k] = max(right[k], right[k + 1])
    left = area[0]
    for k in range(1, n - 1):
        left = max(left, area[k])
        if area[k] < WAIST * min(left, right[k]) and (found < 0 or area[k] < area[found]):
            found = k
    return found


@kernel
def _pchip_slopes(t: Floats, area: Floats, slopes: Floats) -> None:
    n = t.size
    for i in range(1, n - 1):
        h, k = t[i] - t[i - 1], t[i + 1] - t[i]
        p, q = (area[i] - area[i - 1]) / h, (area[i + 1] - area[i]) / k
        if p * q > 0.0:
            # weighted harmonic mean of both sides' slopes
            one, two = 2.0 * k + h, k + 2.0 * h
            slopes[i] = (one + two) / (one / p + two / q)
    for end in range(2):
        i, j, m = (0, 1, 2) if end == 0 else (n - 1, n - 2, n - 3)
        h, k = t[j] - t[i], t[m] - t[j]
        p, q = (area[j] - area[i]) / h, (area[m] - area[j]) / k
        # of the parabola through three, limited so that the cubic stays monotone
        s = ((2.0 * h + k) * p - h * q) / (h + k)
        if s * p <= 0.0:
            s = 0.0
        elif p * q <= 0.0 and abs(s) > 3.0 * abs(p):
            s = 3.0 * p
        slopes[i] = s


@kernel
def _spline_slopes(t: Floats, area: Floats, ends: Floats, slopes: Floats) -> None:
    """Slopes of the cubic spline at its knots, by elimination down the tridiagonal system."""
    n = t.size
    below, middle, above, right = np.zeros(n), np.ones(n), np.zeros(n), np.zeros(n)
    for i in range(1, n - 1):
        h, k = t[i] - t[i - 1], t[i + 1] - t[i]
        below[i], middle[i], above[i] = k, 2.0 * (h + k), h
        right[i] = 3.0 * (k * (area[i] - area[i - 1]) / h + h * (area[i + 1] - area[i]) / k)
    for end in range(2):
        i, j, m = (0, 1, 2) if end == 0 else (n - 1, n - 2, n - 3)
        if not np.isnan(ends[end]):
            right[i] = ends[end]
            continue
        # not-a-knot; of three knots that is the parabola through them
        h, k = t[j] - t[i], t[m] - t[j]
        p, q = (area[j] - area[i]) / h, (area[m] - area[j]) / k
        if n == 3:
            right[i] = ((2.0 * h + k) * p - h * q) / (h + k)
            continue
        middle[i] = k
        right[i] = ((h + 2.0 * (h + k)) * k * p + h * h * q) / (h + k)
        if end == 0:
            above[i] = h + k
        else:
            below[i] = h + k
    # down the tridiagonal system, and back
    for i in range(1, n):
        share = below[i] / middle[i - 1]
        middle[i] -= share * above[i - 1]
        right[i] -= share * right[i - 1]
    slopes[n - 1] = right[n - 1] / middle[n - 1]
    for i in range(n - 2, -1, -1):
        slopes[i] = (right[i] - above[i] * slopes[i + 1]) / middle[i]


@kernel
def unevenness(t: Floats, area: Floats) -> float:
    """Give by how much volume single slices depart from the smooth course of the others, in quadrature, mm³.

    Each inner slice is compared with the cubic through two slices on either side, or, beside the outer
    ones, with the parabola through the three nearest others; of three slices with the line through two.
    """
    n = t.size
    total = 0.0
    for i in range(1, n - 1):
        if n == 3:
            low, high = i - 1, i + 2
        elif n == 4:
            low, high = 0, 4
        else:
            low = min(max(i - 2, 0), n - 4 if i == 1 or i == n - 2 else n - 5)
            high = low + (4 if i == 1 or i == n - 2 else 5)
        guess = 0.0
        for j in range(low, high):
            if j == i:
                continue
            # Lagrange's polynomial through the others, at the slice
            weight = 1.0
            for k in range(low, high):
                if k != j and k != i:
                    weight *= (t[i] - t[k]) / (t[j] - t[k])
            guess += weight * area[j]
        # the slice stands for half the ways to both neighbours
        off = 0.5 * (t[i + 1] - t[i - 1]) * (area[i] - guess)
        total += off * off
    return np.sqrt(total)
