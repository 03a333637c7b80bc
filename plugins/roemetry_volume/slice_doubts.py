"""What a reader of a volume from slices must know."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roemetry.records import Product, Reason
from roemetry_volume.slice_kernels import slice_kernels
from roemetry_volume.slice_table import Slices

_UNSEARCHED_ROWS = 1  # at the image's top and bottom: extractors may leave them out
_BELOW_MM = 1.0


def reasons_of(product: Product, slices: Slices, caps: Sequence[float] = ()) -> tuple[Reason, ...]:
    """Give the doubts that the slices raise, and what was done about each.

    Parameters
    ----------
    product, slices
        The product and its slices.
    caps
        Kinds of the caps at both ends, for estimators that have such.
    """
    columns, _, rules = slice_kernels()[:3]
    table, calibration = slices.table, product.calibration
    reasons = []
    if slices.missing:
        many = slices.missing
        reasons.append(
            Reason(
                "dead-stripe",
                f"{many} {'stripe' if many == 1 else 'stripes'} between others on the product "
                f"{'shows' if many == 1 else 'show'} nothing; the slices beside were joined over the gap",
            )
        )
    if slices.most_filled_mm2 > 0.0:
        where = _named(slices.stripe[table[:, columns.FILLED] > 0.0])
        reasons.append(
            Reason(
                "gap-in-slice",
                f"rows neither seen nor bridged (stripe {where}); joined by a straight line, as interpolated",
            )
        )
    if slices.most_hole_mm > 0.0:
        hole = table[:, columns.HOLE]
        reasons.append(
            Reason(
                "hole",
                f"the surface falls away and rises again over up to {hole.max():.1f} mm (stripe "
                f"{_named(slices.stripe[hole > 0.0])}): a hole, or two products; nothing is counted there",
            )
        )
    if slices.lowest_mm < -_BELOW_MM:
        low = table[:, columns.LOW]
        reasons.append(
            Reason(
                "below-belt",
                f"points lie up to {-low.min():.1f} mm below the belt (stripe "
                f"{_named(slices.stripe[low < -_BELOW_MM])}); they are counted with their sign",
            )
        )
    if (waist := rules.waist(slices.area_mm2)) >= 0:
        reasons.append(
            Reason(
                "waist",
                f"the slice of stripe {slices.stripe[waist] + 1} has under {rules.WAIST:.0%} of the area on "
                "both sides of it: perhaps two products that touch, measured as one",
            )
        )
    first, last = slices.rows_px
    if first <= _UNSEARCHED_ROWS or last >= calibration.image_size[0] - 1 - _UNSEARCHED_ROWS:
        reasons.append(
            Reason("cut-by-edge", "the product reaches the image's first or last row; it may go on beyond"),
        )
    if any(kind == rules.BLUNT for kind in caps):
        reasons.append(
            Reason(
                "blunt-end",
                "the outer slices do not taper: the end lies anywhere up to the next stripe, "
                "and half of that way is counted",
            )
        )
    if not all(slices.limited) and caps:
        by_taper = not any(kind == rules.NO_CAP for kind in caps)
        reasons.append(
            Reason(
                "beyond-outer-stripes",
                "the product reaches beyond the outer stripes; what lies beyond "
                + ("follows the slices' taper" if by_taper else "is not in the number"),
            )
        )
    return tuple(reasons)


def _named(stripes: np.ndarray) -> str:
    return ", ".join(str(int(stripe) + 1) for stripe in stripes)
