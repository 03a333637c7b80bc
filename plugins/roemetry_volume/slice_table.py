"""A product's slices in the order in which they cut the belt, with what they stand for."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Product, Profiles
from roemetry.records.arrays import Floats, Integers
from roemetry_volume.slice_kernels import slice_kernels

LEAST_SLICES = 3
_CLEFT_SLICES = 3  # single skeins, dented and folded ones too, fall deep on one stripe at most
_SUNKEN_MM = 1.0


class Slices(NamedTuple):
    """Slices with points on the product, along rising rest X.

    Attributes
    ----------
    stripe : ndarray of int64, shape (n,)
        Stripe of each.
    t_mm, area_mm2, width_mm, loose_mm2, filled_mm2, open_mm2, held_mm : ndarray of float64, shape (n,)
        Rest X; area; extent along Y; of the area, what was bridged beyond the outermost points that were
        seen, and what a straight line fills over missing rows; what one over a hole would hold; half the ways
        to both neighbours.
    table : ndarray of float64, shape (n, 16)
        All columns of `roemetry_kernels.volume.slice_areas`.
    profiles, place
        The points, in the order of the rows, and where each slice is in them, shape (n,).
    reach_mm, limited : tuple
        At both ends: distance to the next stripe (the mean spacing where there is none), and whether there
        is one.
    lean : tuple
        Of the planes of light of both outer slices: how far they go outwards, away from the product, for each
        millimetre upwards; negative where they lean over it.
    missing : int
        Stripes between others on the product without a point.
    seen_mm3, joined_mm3, assumed_mm3 : float
        What was seen, what was bridged along a stripe, what stands over stripes without a point.
    most_filled_mm2, most_hole_mm, lowest_mm, rows_px
        Of all slices the largest area that a straight line fills, the largest length left out as a hole, the
        lowest height, and the first and last row.
    """

    stripe: Integers
    t_mm: Floats
    area_mm2: Floats
    width_mm: Floats
    loose_mm2: Floats
    filled_mm2: Floats
    open_mm2: Floats
    held_mm: Floats
    table: Floats
    profiles: Profiles
    place: Integers
    reach_mm: tuple[float, float]
    limited: tuple[bool, bool]
    lean: tuple[float, float]
    missing: int
    seen_mm3: float
    joined_mm3: float
    assumed_mm3: float
    most_filled_mm2: float
    most_hole_mm: float
    lowest_mm: float
    rows_px: tuple[float, float]


def slices_of(product: Product) -> Slices:
    """Cut a product into its slices.

    Raises
    ------
    StageError
        Fewer than three stripes lie on the product, it looks like two side by side, a slice lies below the
        belt, or a plane of light runs along X.
    """
    columns, order = slice_kernels()[:2]
    table, profiles = table_of(product.profiles, product.number)
    lit, held, whole, rows, by_column = order.in_order(table, profiles.stripe, profiles.frame, profiles.plane)
    if not lit.size:
        raise StageError("no stripe on the product", hint="there is nothing to sum; look at the coding")
    if lit.size < LEAST_SLICES:
        raise StageError(
            f"only {lit.size} {'stripe lies' if lit.size == 1 else 'stripes lie'} on the product: what is "
            "between and beyond is not known",
            hint="a finer fan of stripes, or a larger product",
        )
    told = whole.tolist()
    if told[order.UNKNOWN] >= 0.0:
        named = int(profiles.stripe[int(told[order.UNKNOWN])]) + 1
        raise StageError(f"the plane of stripe {named} runs along X: slices have no spacing there")
    if not told[order.LEAST_GAP] > 0.0:
        raise StageError("two slices lie at the same place", hint="one slice for each stripe and frame")
    stripe = profiles.stripe[lit]
    if told[order.CLOVEN] >= _CLEFT_SLICES:
        _refuse_cloven(int(told[order.CLOVEN]), lit.size)
    if told[order.LEAST_AREA] < 0.0:
        _refuse_sunken(rows, stripe)
    ends = [told[order.BEFORE], told[order.AFTER]]
    limited = [not math.isnan(end) for end in ends]
    before, after = (end if known else told[order.USUAL] for end, known in zip(ends, limited, strict=True))
    return Slices(
        stripe=stripe,
        t_mm=by_column[columns.AT],
        area_mm2=by_column[columns.AREA],
        width_mm=by_column[columns.WIDTH],
        loose_mm2=by_column[columns.LOOSE],
        filled_mm2=by_column[columns.FILLED],
        open_mm2=by_column[columns.OPEN],
        held_mm=held,
        table=rows,
        profiles=profiles,
        place=lit,
        reach_mm=(before, after),
        limited=(limited[0], limited[1]),
        lean=(told[order.LEANS[0]], told[order.LEANS[1]]),
        missing=int(told[order.MISSING]),
        seen_mm3=told[order.SEEN_MM3],
        joined_mm3=told[order.JOINED_MM3],
        assumed_mm3=told[order.ASSUMED_MM3],
        most_filled_mm2=told[order.MOST_FILLED],
        most_hole_mm=told[order.MOST_HOLE],
        lowest_mm=told[order.LOWEST],
        rows_px=(told[order.UPPERMOST], told[order.LOWERMOST]),
    )


def _refuse_cloven(deep: int, slices: int) -> None:
    """Refuse what falls deep between two humps on so many stripes that it is hardly one product."""
    share = slice_kernels().order.CLEFT_SHARE
    if deep >= slices / 3.0:
        raise StageError(
            f"on {deep} of {slices} stripes the surface falls by over {share:.0%} between two humps: two "
            "products side by side, coded as one, have no volume in common",
            hint="keep products apart on the belt",
        )


def _refuse_sunken(rows: Floats, stripe: Integers) -> None:
    """Refuse a product of which a slice lies below the belt as a whole."""
    from roemetry_kernels.volume.slice_areas import AREA, WIDTH

    depth = -rows[:, AREA] / np.maximum(rows[:, WIDTH], 1e-9)
    worst = int(depth.argmax())
    if depth[worst] > _SUNKEN_MM:
        raise StageError(
            f"the slice of stripe {int(stripe[worst]) + 1} lies {depth[worst]:.1f} mm below the belt: no "
            "product does",
            hint="look at the coding, the calibration and the belt's zero",
        )


def table_of(profiles: Profiles, number: int) -> tuple[Floats, Profiles]:
    """Give the kernel's table; points in any order are put into that of the rows first, and given back so."""
    slice_areas = slice_kernels().columns.slice_areas
    for _ in range(2):
        table: Floats
        table, ordered = slice_areas(
            profiles.xyz_mm,
            profiles.product,
            profiles.seen,
            profiles.row_px,
            profiles.plane,
            profiles.frame,
            number,
        )
        if ordered:
            break
        profiles = _in_rows(profiles)
    return table, profiles


def _in_rows(profiles: Profiles) -> Profiles:
    order = np.argsort(profiles.row_px, axis=1, kind="stable")

    def moved(values: Any) -> Any:
        return np.take_along_axis(values, order, axis=1)

    return replace(
        profiles,
        xyz_mm=np.take_along_axis(profiles.xyz_mm, order[:, :, None], axis=1),
        product=moved(profiles.product),
        seen=moved(profiles.seen),
        x_px=moved(profiles.x_px),
        row_px=moved(profiles.row_px),
        height_std_mm=moved(profiles.height_std_mm),
    )
