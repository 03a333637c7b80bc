"""What lies beyond the outer slices: by a quadric where one fits, by the areas' taper, or half a spacing."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from roemetry.records import Product
from roemetry.records.arrays import Floats, Integers, Labels
from roemetry_kernels.compiling import kernel
from roemetry_volume import slice_rules as rules
from roemetry_volume.quadric_ends import edges_missed, quadric_end
from roemetry_volume.slice_rules import short_of
from roemetry_volume.slice_table import AREA, AT, FIRST_ROW, LAST_ROW, TOP, WALL, WIDTH, Slices

# chosen so that 95 % intervals hold the truth as often as they say: docs/reference/plugins/slice-pchip.md
_TAPER_STD = 0.11  # of a tapered cap's volume
_OPEN_TAPER_STD = 0.35  # the same with no stripe beyond that shows belt
_QUADRIC_STD = 0.12  # of a quadric's cap
_SHADOW_STD = 0.5  # of what leaning light counts too much behind an end, by the quadric
_RIM_STD = 0.3  # of that triangle below the rim, where no quadric tells it
_FITS_MM = 0.07  # a quadric that misses the points by so much is believed by half
_HARDLY = 0.02
_UPRIGHT = 0.75
_CLIFF = 0.4  # an outer slice that is so much smaller than the others say: a wall before it
_BLUNT_STD = 2.0 / math.sqrt(12.0)  # of a cap of half the way to the next stripe
_WALL_STD = 0.5 / math.sqrt(3.0)  # of the way that a plane leans over the height of an end wall
_OPEN_SPACINGS = 2.0
_OPEN_SHARE = 0.2  # of the product's lit length; beyond either, an open end's taper is not believed


Ends = Literal["taper", "hold", "none"]


class Cap(NamedTuple):
    """What lies beyond an outer slice.

    `kind` is one of `slice_rules`; `slope_mm` is dA/dt at the outer slice (NaN: no taper);
    `shadow_mm3` what leaning light makes the slices count too little at this end, or, negative, too much;
    `area_mm2` what the outer slice counts with: one that runs over the edge of an upright end as if whole;
    `bulge_mm3` what a quadric says that lies between it and the next one over the straight line from area to
    area, and `trust` how far to believe that.
    """

    volume_mm3: float
    length_mm: float
    slope_mm: float
    kind: float
    shadow_mm3: float
    std_mm3: float
    area_mm2: float
    bulge_mm3: float = 0.0
    trust: float = 0.0


class _Flat(NamedTuple):
    """An upright end: as `Cap`; and how far to believe it, from 0 to 1."""

    volume_mm3: float
    length_mm: float
    shadow_mm3: float
    std_mm3: float
    area_mm2: float
    trust: float


def cap_of(product: Product, slices: Slices, end: int, ends: Ends) -> Cap:
    """Give what lies beyond the first (`end` 0) or the last (1) slice."""
    if ends == "none":
        return Cap(0.0, 0.0, math.nan, rules.NO_CAP, 0.0, 0.0, float(slices.area_mm2[-end]))
    limited, within = slices.limited[end], _within(slices, end)
    area = float(slices.area_mm2[-end])
    taper = rules.cap(slices.t_mm, slices.area_mm2, end, within, limited)
    if ends == "hold":
        length = 0.5 * slices.reach_mm[end]
        volume = length * area
        std = _std(slices, end, taper, volume)
        return Cap(volume, length, math.nan, rules.BLUNT, 0.0, std, area)
    volume, length, slope, kind = taper
    found = Cap(volume, length, slope, kind, 0.0, _std(slices, end, taper, volume), area)
    flat = _flat(product, slices, end)
    if flat.trust > _HARDLY:
        found = _mixed(found, flat, rules.BLUNT)
    volume, length, shadow, bulge, trust = _by_quadric(product, slices, end, within)
    if trust < _HARDLY:
        return found
    own = math.hypot(_QUADRIC_STD * volume, _SHADOW_STD * shadow)
    mixed = _mixed(found, _Flat(volume, length, shadow, own, area, trust), rules.TAPERED)
    return mixed._replace(bulge_mm3=bulge, trust=trust)


def upright_ends(product: Product, slices: Slices) -> tuple[bool, bool]:
    """Say whether the slices show an upright end at low and at high X."""
    return _flat(product, slices, 0).trust > _UPRIGHT, _flat(product, slices, 1).trust > _UPRIGHT


def _mixed(one: Cap, other: _Flat, kind: float) -> Cap:
    """Believe the other by its trust."""
    trust, rest = other.trust, 1.0 - other.trust
    apart = other.volume_mm3 + other.shadow_mm3 - one.volume_mm3 - one.shadow_mm3
    return Cap(
        rest * one.volume_mm3 + trust * other.volume_mm3,
        rest * one.length_mm + trust * other.length_mm,
        one.slope_mm,
        kind if trust > 0.5 else one.kind,
        rest * one.shadow_mm3 + trust * other.shadow_mm3,
        math.hypot(rest * one.std_mm3, trust * other.std_mm3, math.sqrt(trust * rest) * apart),
        rest * one.area_mm2 + trust * other.area_mm2,
    )


def _flat(product: Product, slices: Slices, end: int) -> _Flat:
    """Give what lies beyond an outer slice if the product ends upright there."""
    profiles, view = product.profiles, product.view
    camera = math.nan if view is None else float(view.T_belt_camera[0, 3])
    if view is not None and view.telecentric:  # it stands above all of the product
        camera = 0.5 * float(slices.t_mm[0] + slices.t_mm[-1])
    found = flat_end(
        profiles.xyz_mm,
        profiles.product,
        profiles.row_px,
        product.number,
        slices.table,
        slices.place,
        end,
        slices.lean,
        slices.reach_mm[end],
        slices.limited[end],
        camera,
    )
    return _Flat(*found)


def _within(slices: Slices, end: int) -> float:
    """How far beyond the outer slice the end may lie, mm."""
    reach = slices.reach_mm[end]
    if slices.limited[end]:
        return reach
    return max(_OPEN_SPACINGS * reach, _OPEN_SHARE * float(slices.t_mm[-1] - slices.t_mm[0]))


def _by_quadric(
    product: Product, slices: Slices, end: int, within_mm: float
) -> tuple[float, float, float, float, float]:
    """Give volume, length, shadow and bulge of the cap by a quadric through three slices, and its trust.

    With the shadow goes what the slices miss at their own ends, now that the rim's height is known.
    """
    profiles = slices.profiles
    volume, length, shadow, bulge, rim_mm, off_mm = quadric_end(
        profiles.xyz_mm,
        profiles.product,
        profiles.seen,
        profiles.row_px,
        profiles.plane,
        product.number,
        slices.table,
        slices.place,
        end,
        within_mm,
        slices.limited[end],
    )
    trust = 1.0 / (1.0 + (off_mm / _FITS_MM) ** 10) if off_mm < 3.0 * _FITS_MM else 0.0
    if trust < _HARDLY:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    shadow += edges_missed(
        profiles.xyz_mm,
        profiles.product,
        profiles.row_px,
        product.number,
        slices.table,
        slices.place,
        end,
        slices.lean,
        max(rim_mm, 0.0),
    )
    return volume, length, shadow, bulge, trust


def _std(slices: Slices, end: int, taper: tuple[float, float, float, float], volume_mm3: float) -> float:
    """Say how far a cap of some volume may be off, mm³.

    Of a blunt end anything up to the next stripe is possible, and a wall that leaning light sees or not;
    of an open end without taper, that the product goes on as far as a taper would be believed. An area
    that is held although the slices taper is off by what the taper says otherwise. Where light leans over an
    end, its shadow below the rim counts, more or less; and there may be a wall before the outer slice.
    """
    outer = slices.table[-end].tolist()
    area, lean = outer[AREA], slices.lean[end]
    if taper[3] == rules.NO_CAP:
        std = _OPEN_SHARE * area * float(slices.t_mm[-1] - slices.t_mm[0])
    elif taper[3] == rules.TAPERED:
        share = _TAPER_STD if slices.limited[end] else _OPEN_TAPER_STD
        std = math.hypot(share * taper[0], taper[0] - volume_mm3)
    else:
        over_mm = abs(lean) * max(outer[TOP], 0.0)
        std = math.hypot(_BLUNT_STD * volume_mm3, _WALL_STD * over_mm * area)
    below_rim = 0.5 * max(-lean, 0.0) * outer[WALL] * outer[WIDTH]
    missing, expected = rules.short_of(slices.t_mm, slices.area_mm2, end)
    cliff = _cliff_std(slices, end, missing, expected) if missing > _CLIFF * expected else 0.0
    return math.hypot(std, _RIM_STD * below_rim, cliff)


def _cliff_std(slices: Slices, end: int, missing_mm2: float, expected_mm2: float) -> float:
    """Say how far off the volume may be because a wall stands just before an outer slice, mm³.

    The outer slice is then far smaller than the next ones say, and narrower rather than lower: light met the
    wall's edge at a slant. The wall is anywhere between the last two slices; leaning light sees it or not.
    """
    inner = -2 if end else 1
    outer, before = slices.table[-end], slices.table[inner]
    if outer[WIDTH] * before[TOP] >= before[WIDTH] * outer[TOP]:
        return 0.0
    spacing = abs(float(slices.t_mm[-end] - slices.t_mm[inner]))
    over_mm = abs(slices.lean[end]) * max(float(before[TOP]), 0.0)
    return math.hypot(spacing / math.sqrt(12.0) * missing_mm2, _WALL_STD * over_mm * expected_mm2)


VOLUME, LENGTH, SHADOW, STD, WHOLE, TRUST = range(6)
"""What `flat_end` gives: volume beyond the outer slice (mm³), less what that counts beyond the edge, if it
counts with `WHOLE` (mm²); how far it reaches (mm); what light that leans adds or takes off (mm³); standard
deviation (mm³); and how far to believe all that, 0 to 1."""

_LEVEL = 0.9, 0.97  # of the next slice's height: from where on an end may be flat, and is
_LEVEL_BOTH = 0.97, 0.99
_CUT = 0.02, 0.06  # of the width: from where on an outer slice runs over the edge, and does
_OTHER = 0.15, 0.4  # other cut over the longer one: an end is cut at one side where its edge is at a slant
_CUT_BOTH = 0.12, 0.2  # of the width: at both where light passes over a round body's end; rounded ends less
_HARDLY_WIDE = 0.2  # of the next slice's width: it need not be the top that such a slice shows
_SHORT = 0.4, 0.6
_LOW = 0.75  # of the next slice's highest point: the product falls
_SKEW = 0.58  # an edge turned by 30 degrees
_ROUNDED = 0.3  # of what leaning light passes over: the edge may be rounded off
_ROUND, _TOLD_SLICES = 1.0 / math.sqrt(3.0), 5
"""The same with fewer slices, which do not tell a level top from a ball's: all may be product, or none."""


@kernel
def flat_end(
    xyz_mm: Floats,
    product: Labels,
    row_px: Floats,
    number: int,
    table: Floats,
    place: Integers,
    at_end: int,
    lean: tuple[float, float],
    reach_mm: float,
    limited: bool,
    camera_mm: float,
) -> tuple[float, float, float, float, float, float]:
    """Give what lies up to an upright end.

    The outer slice is then as high as the next one at the same places across the product. Is it as wide, too,
    the edge is anywhere up to the next stripe. Where it is cut at one side, or at both, its outermost points
    there lie on the edge: two of them tell the end's place, one of them does but for the slant, which is
    that across the product's sides, or anything that both neighbouring stripes allow. Is it hardly there
    while the next ones are all alike, the edge is anywhere between it and the next one.

    Light that leans counts a triangle behind an end in its shadow, and does not count it at an end that it
    meets unless a camera beyond the end sees that.

    Parameters
    ----------
    xyz_mm, product, row_px : ndarray
        As in `Profiles`.
    number
        Number of the product.
    table, place
        Rows of `slice_areas` along rising rest X, and where each slice is in `Profiles`; at least three.
    at_end
        0 the first slice, 1 the last.
    lean
        Of the planes of light of both outer slices: outwards for each millimetre upwards.
    reach_mm, limited
        Distance to the next stripe, and whether there is one.
    camera_mm
        X of the camera; NaN: not known.

    Returns
    -------
    tuple of float
        As named above.
    """
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    n = table.shape[0]
    step = 1 if at_end == 0 else -1
    o = 0 if at_end == 0 else n - 1
    i, j = o + step, o + 2 * step
    area, next_area = table[o, AREA], table[i, AREA]
    if not (next_area > 0.0 and area > 0.0):
        return nothing
    outwards = 1.0 if at_end == 1 else -1.0
    spacing = abs(table[o, AT] - table[i, AT])
    is_low = table[o, TOP] < _LOW * table[i, TOP]
    hardly = table[o, WIDTH] < _HARDLY_WIDE * table[i, WIDTH]
    if is_low and not hardly:
        return nothing
    points = np.empty((3, product.shape[1], 3))
    count = np.zeros(3, np.int64)
    low, high = np.zeros(3), np.zeros(3)
    low_x, high_x = np.zeros(3), np.zeros(3)
    for k in range(3):
        s = o + k * step
        count[k] = _gathered(
            points[k], xyz_mm, product, row_px, number, place[s], table[s, FIRST_ROW], table[s, LAST_ROW]
        )
        low[k], high[k], low_x[k], high_x[k] = _sides(points[k], count[k])
    raw, moment, square = _sums(points[1], count[1])
    if hardly:
        missing, whole = short_of(table[:, AT], table[:, AREA], at_end)
        trust = _ramp(missing / max(whole, 1e-9), _SHORT)
        narrow = table[o, WIDTH] * table[i, TOP] < table[i, WIDTH] * table[o, TOP]
        if not (trust > 0.0 and narrow):
            return nothing
        volume, std, length = -0.5 * spacing * whole, spacing * whole / math.sqrt(12.0), 0.0
    else:
        on = (table[o, AT] - table[i, AT]) / (table[i, AT] - table[j, AT])
        # the sides go on as from slice to slice
        shift = 0.5 * on * (low[1] + high[1] - low[2] - high[2])
        wider = 0.5 * on * (high[1] - low[1] - high[2] + low[2])
        ratio = _ratio(points, count, shift)
        low_cut, high_cut = low[0] - (low[1] + shift - wider), high[1] + shift + wider - high[0]
        cut, other, width = max(low_cut, high_cut), min(low_cut, high_cut), high[1] - low[1] + 2.0 * wider
        if not (ratio > _LEVEL[0] and width > 0.0):
            return nothing
        is_cut = _ramp(cut / width, _CUT)
        at_both = _ramp(other / max(cut, 0.1 * width), _OTHER)
        trust = (1.0 - at_both) * _ramp(ratio, _LEVEL) * (1.0 if limited else is_cut)
        trust += at_both * _ramp(ratio, _LEVEL_BOTH) * _ramp(cut / width, _CUT_BOTH)
        if not trust > 0.0:
            return nothing
        square *= ratio * ratio
        whole, length = max(ratio * next_area, area), 0.5 * reach_mm
        volume, std = 0.5 * reach_mm * area, reach_mm * area / math.sqrt(12.0)
        if is_cut > 0.0:
            # the edge, as X = at + slope·(y − cut's y), from the cut end to the lit one
            dark = low[0] if low_cut >= high_cut else high[0]
            lit = high[0] if low_cut >= high_cut else low[0]
            at = outwards * (low_x[0] if low_cut >= high_cut else high_x[0])
            across = max(abs(lit - dark), 0.01 * width)
            steepest = min(spacing / max(cut, 1e-9), reach_mm / across if limited else np.inf, _SKEW)
            square_on = -outwards * (shift / (table[o, AT] - table[i, AT])) * (1.0 if lit > dark else -1.0)
            slope = min(max(square_on, 0.0), steepest)
            slope_std = steepest / math.sqrt(12.0)
            both = outwards * (high_x[0] if low_cut >= high_cut else low_x[0])
            slope += at_both * ((both - at) / across - slope)
            slope_std *= 1.0 - at_both
            middle = 0.5 * (across - cut + max(other, 0.0))
            edge = at + slope * middle
            begin = outwards * moment / raw
            far = edge - begin
            rise = 1.0 + (ratio - 1.0) * min(far / spacing, 1.5)
            up_to = 0.5 * (1.0 + rise) * raw * far + 0.5 * _lean_at(lean, table, i, at_end) * square
            up_to_std = abs(middle) * slope_std * raw
            # what the rules give between both slices, and the light's triangle
            counted = 0.5 * (next_area + whole) * spacing
            triangle = 0.5 * lean[at_end] * square
            volume += is_cut * (up_to - triangle - counted - volume)
            std += is_cut * (up_to_std - std)
            whole = area + is_cut * (whole - area)
        else:
            whole = area
    unseen, unseen_std = _unseen(table, o, lean[at_end], reach_mm, outwards, camera_mm)
    triangle = 0.5 * lean[at_end] * square
    rounded = _ROUNDED if n >= _TOLD_SLICES else _ROUND
    shadow = unseen * triangle - _counted(table, lean, at_end)
    return (
        volume,
        length,
        shadow,
        math.sqrt(std * std + (rounded * unseen * triangle) ** 2 + (unseen_std * triangle) ** 2),
        whole,
        trust,
    )


@kernel
def _ramp(value: float, limits: tuple[float, float]) -> float:
    return min(max((value - limits[0]) / (limits[1] - limits[0]), 0.0), 1.0)


@kernel
def _lean_at(lean: tuple[float, float], table: Floats, slice_: int, at_end: int) -> float:
    """Lean of an inner slice's plane, outwards at this end, by a straight line between both outer ones."""
    share = (table[slice_, AT] - table[0, AT]) / (table[table.shape[0] - 1, AT] - table[0, AT])
    along = -lean[0] * (1.0 - share) + lean[1] * share
    return along if at_end == 1 else -along


@kernel
def _counted(table: Floats, lean: tuple[float, float], at_end: int) -> float:
    """What this end's half of the slices count for walls as high as their own ends, mm³."""
    n = table.shape[0]
    opening = (lean[0] + lean[1]) / (table[n - 1, AT] - table[0, AT])
    total = 0.0
    for k in range(n):
        mine = min(max(0.5 * n - (k if at_end == 0 else n - 1 - k), 0.0), 1.0)
        held = 0.5 * (table[min(k + 1, n - 1), AT] - table[max(k - 1, 0), AT])
        total += mine * held * table[k, WIDTH] * table[k, WALL]
    return 0.5 * opening * total


@kernel
def _unseen(
    table: Floats, outer: int, lean: float, reach_mm: float, outwards: float, camera_mm: float
) -> tuple[float, float]:
    """How much of the triangle at the end the slices do not hold: mean and standard deviation."""
    if lean <= 0.0:
        return 1.0, 0.0
    if np.isnan(camera_mm):
        return 0.5, 0.5
    edge = table[outer, AT] + outwards * (lean * table[outer, TOP] + 0.5 * reach_mm)
    if (camera_mm - edge) * outwards > 0.0:
        return 0.0, 0.0
    return 1.0, 0.0


@kernel
def _gathered(
    points: Floats, xyz_mm: Floats, product: Labels, row_px: Floats, number: int,
    slice_: int, first: float, last: float,
) -> int:  # fmt: skip
    """Put the product's points of a slice in a row, but for those left out at its ends; say how many."""
    count = 0
    for k in range(product.shape[1]):
        if product[slice_, k] != number or not np.isfinite(xyz_mm[slice_, k, 2]):
            continue
        if first <= row_px[slice_, k] <= last:
            for axis in range(3):
                points[count, axis] = xyz_mm[slice_, k, axis]
            count += 1
    return count


@kernel
def _sides(points: Floats, count: int) -> tuple[float, float, float, float]:
    """Smallest and largest Y of a slice, and X there."""
    low, high, low_x, high_x = np.inf, -np.inf, 0.0, 0.0
    for k in range(count):
        if points[k, 1] < low:
            low, low_x = points[k, 1], points[k, 0]
        if points[k, 1] > high:
            high, high_x = points[k, 1], points[k, 0]
    return low, high, low_x, high_x


@kernel
def _sums(points: Floats, count: int) -> tuple[float, float, float]:
    """∫z, ∫x·z and ∫z² over Y of a slice."""
    area, moment, square = 0.0, 0.0, 0.0
    for k in range(1, count):
        half = 0.5 * abs(points[k, 1] - points[k - 1, 1])
        z, last_z = points[k, 2], points[k - 1, 2]
        area += half * (z + last_z)
        moment += half * (points[k, 0] * z + points[k - 1, 0] * last_z)
        square += half * (z * z + last_z * last_z)
    return area, moment, square


@kernel
def _ratio(points: Floats, count: Integers, shift: float) -> float:
    """Mean height of a slice over that of the next at the same places, moved along with the sides; or NaN."""
    outer, inner, last = points[0], points[1], count[1] - 1
    if last < 1:
        return np.nan
    # rows run one way across the product
    way = 1.0 if inner[last, 1] > inner[0, 1] else -1.0
    mine, theirs = 0.0, 0.0
    at = 0
    for k in range(count[0]):
        y = way * (outer[k, 1] - shift)
        if y < way * inner[0, 1]:
            continue
        while at <= last and way * inner[at, 1] < y:
            at += 1
        if at > last:
            break
        before = max(at - 1, 0)
        span = way * (inner[at, 1] - inner[before, 1])
        share = (y - way * inner[before, 1]) / span if span > 0.0 else 0.0
        mine += outer[k, 2]
        theirs += (1.0 - share) * inner[before, 2] + share * inner[at, 2]
    return mine / theirs if theirs > 0.0 else np.nan
