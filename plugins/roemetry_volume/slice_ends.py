"""What lies beyond the outer slices: by a quadric where one fits, by the areas' taper, or half a spacing."""

from __future__ import annotations

import math
from typing import NamedTuple

from roemetry.records import Product
from roemetry_volume.slice_kernels import slice_kernels
from roemetry_volume.slice_options import Ends
from roemetry_volume.slice_table import Slices

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
    rules = slice_kernels().rules
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
    found = slice_kernels().flat_end(
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
    quadric_end = slice_kernels().quadric_end
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
    shadow += slice_kernels().edges_missed(
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
    columns, _, rules = slice_kernels()[:3]
    outer = slices.table[-end].tolist()
    area, lean = outer[columns.AREA], slices.lean[end]
    if taper[3] == rules.NO_CAP:
        std = _OPEN_SHARE * area * float(slices.t_mm[-1] - slices.t_mm[0])
    elif taper[3] == rules.TAPERED:
        share = _TAPER_STD if slices.limited[end] else _OPEN_TAPER_STD
        std = math.hypot(share * taper[0], taper[0] - volume_mm3)
    else:
        over_mm = abs(lean) * max(outer[columns.TOP], 0.0)
        std = math.hypot(_BLUNT_STD * volume_mm3, _WALL_STD * over_mm * area)
    below_rim = 0.5 * max(-lean, 0.0) * outer[columns.WALL] * outer[columns.WIDTH]
    missing, expected = rules.short_of(slices.t_mm, slices.area_mm2, end)
    cliff = _cliff_std(slices, end, missing, expected) if missing > _CLIFF * expected else 0.0
    return math.hypot(std, _RIM_STD * below_rim, cliff)


def _cliff_std(slices: Slices, end: int, missing_mm2: float, expected_mm2: float) -> float:
    """Say how far off the volume may be because a wall stands just before an outer slice, mm³.

    The outer slice is then far smaller than the next ones say, and narrower rather than lower: light met the
    wall's edge at a slant. The wall is anywhere between the last two slices; leaning light sees it or not.
    """
    columns = slice_kernels().columns
    inner = -2 if end else 1
    outer, before = slices.table[-end], slices.table[inner]
    if outer[columns.WIDTH] * before[columns.TOP] >= before[columns.WIDTH] * outer[columns.TOP]:
        return 0.0
    spacing = abs(float(slices.t_mm[-end] - slices.t_mm[inner]))
    over_mm = abs(slices.lean[end]) * max(float(before[columns.TOP]), 0.0)
    return math.hypot(spacing / math.sqrt(12.0) * missing_mm2, _WALL_STD * over_mm * expected_mm2)
