"""What lies beyond the outer slices: by a quadric where one fits, by the areas' taper, or half a spacing.

Model. A parabola through three outer areas falls to zero at some distance (`slice_rules.cap`): that is the
cap's volume and length. Where a quadric through the points of three outer slices closes beyond them and
leaves residuals of less than some hundredths of a millimetre (`quadric_ends`), it is believed instead, by a
trust that falls from 1 to 0 around that residual. Of an end that does not taper, and beyond which a stripe
shows belt, half of the way to that stripe is counted, and anything up to it is in the interval.

Assumed: beyond the outer slice the product goes on as it came. It fails at upright ends before the next
stripe (by up to half a spacing, which the interval says) and where leaning light passes over a tall body's
end without a quadric to say what stands in its shadow.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from roemetry.records import Product
from roemetry_volume import slice_rules as rules
from roemetry_volume.quadric_ends import edges_missed, quadric_end
from roemetry_volume.slice_table import AREA, TOP, WALL, WIDTH, Slices

# chosen so that 95 % intervals hold the truth as often as they say: docs/reference/plugins/slice-pchip.md
_TAPER_STD = 0.11  # of a tapered cap's volume
_OPEN_TAPER_STD = 0.35  # the same with no stripe beyond that shows belt
_QUADRIC_STD = 0.12  # of a quadric's cap
_SHADOW_STD = 0.5  # of what leaning light counts too much behind an end, by the quadric
_RIM_STD = 0.3  # of that triangle below the rim, where no quadric tells it
_FITS_MM = 0.07  # a quadric that misses the points by so much is believed by half
_HARDLY = 0.02  # trust: less changes nothing that anyone could measure
_BLUNT_STD = 2.0 / math.sqrt(12.0)  # of a cap of half the way to the next stripe
_WALL_STD = 0.5 / math.sqrt(3.0)  # of the way that a plane leans over the height of an end wall
_OPEN_SPACINGS = 2.0
_OPEN_SHARE = 0.2  # of the product's lit length; beyond either, an open end's taper is not believed


Ends = Literal["taper", "hold", "none"]


class Cap(NamedTuple):
    """What lies beyond an outer slice.

    `kind` is one of `slice_rules`; `slope_mm` is dA/dt at the outer slice (NaN: no taper);
    `shadow_mm3` what leaning light makes the slices count too little at this end, or, negative, too much.
    """

    volume_mm3: float
    length_mm: float
    slope_mm: float
    kind: float
    shadow_mm3: float
    std_mm3: float


def cap_of(product: Product, slices: Slices, end: int, ends: Ends) -> Cap:
    """Give what lies beyond the first (`end` 0) or the last (1) slice."""
    if ends == "none":
        return Cap(0.0, 0.0, math.nan, rules.NO_CAP, 0.0, 0.0)
    limited, within = slices.limited[end], _within(slices, end)
    taper = rules.cap(slices.t_mm, slices.area_mm2, end, within, limited)
    if ends == "hold":
        length = 0.5 * slices.reach_mm[end]
        volume = length * float(slices.area_mm2[-end])
        return Cap(volume, length, math.nan, rules.BLUNT, 0.0, _std(slices, end, taper, volume))
    volume, length, slope, kind = taper
    found = Cap(volume, length, slope, kind, 0.0, _std(slices, end, taper, volume))
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
    apart = volume + shadow - found.volume_mm3
    rest = 1.0 - trust
    return Cap(
        rest * found.volume_mm3 + trust * volume,
        rest * found.length_mm + trust * length,
        slope,
        rules.TAPERED if trust > 0.5 else kind,
        trust * shadow,
        math.hypot(rest * found.std_mm3, trust * own, math.sqrt(trust * rest) * apart),
    )


def _within(slices: Slices, end: int) -> float:
    """How far beyond the outer slice the end may lie, mm."""
    reach = slices.reach_mm[end]
    if slices.limited[end]:
        return reach
    return max(_OPEN_SPACINGS * reach, _OPEN_SHARE * float(slices.t_mm[-1] - slices.t_mm[0]))


def _std(slices: Slices, end: int, taper: tuple[float, float, float, float], volume_mm3: float) -> float:
    """Say how far a cap of some volume may be off, mm³.

    Of a blunt end anything up to the next stripe is possible, and a wall that leaning light sees or not;
    of an open end without taper, that the product goes on as far as a taper would be believed. An area
    that is held although the slices taper is off by what the taper says otherwise. Where light leans over an
    end, its shadow below the rim counts, more or less.
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
    return math.hypot(std, _RIM_STD * below_rim)
