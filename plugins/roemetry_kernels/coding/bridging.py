"""From coded peaks to a dense stripe map: belt or product, short gaps bridged, products numbered."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from roemetry.records import AMBIGUOUS, UNCODED, Peaks, Reason, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.stages import StageOptions
from roemetry_kernels.coding.layout import Layout, laid_out
from roemetry_kernels.coding.rest_lines import RestLines


class BridgingOptions(StageOptions):
    """Gaps and sizes: the options of every coder that lays its peaks out by `bridged`."""

    longest_gap_rows: int = Field(
        default=20, ge=0, description="longest gap along a stripe that is bridged by a straight line, rows"
    )
    smallest_product_points: int = Field(
        default=40, ge=1, description="bodies with fewer points, taken together, are dirt on the belt"
    )


_REACH_TOLERANCES = 3.0
"""A run off the belt is product only if it gets this many tolerances away from its rest line."""


def bridged(
    peaks: Peaks,
    stripe: Integers,
    margin: Floats,
    rest: RestLines,
    *,
    longest_gap_rows: int,
    smallest_product_points: int,
    reasons: list[Reason],
) -> StripeMap:
    """Lay coded peaks out over (stripe, row) and bridge short gaps by straight lines (section 3.3).

    Parameters
    ----------
    peaks
        The frame's peaks.
    stripe
        (peak,) stripe, `UNCODED` or `AMBIGUOUS`.
    margin
        (peak,) margin of the stripe over the second best.
    rest
        Rest lines; a point within the tolerance of its own stripe's is belt. Where none is known, all is
        taken for one product.
    longest_gap_rows
        Longer gaps stay empty: not seen.
    smallest_product_points
        Connected points off the belt that are fewer are dirt: taken out, with a reason.
    reasons
        What the coding has to say so far.
    """
    laid = Layout(*laid_out(
        peaks.row, peaks.x_px, peaks.x_std_px, stripe, margin, AMBIGUOUS, rest.x_px, rest.tolerance_px,
        _REACH_TOLERANCES * rest.tolerance_px, longest_gap_rows, smallest_product_points,
    ))  # fmt: skip
    x_px, seen, product, dirt = laid.x_px, laid.seen, laid.product, laid.dirt
    # without any rest line every point is off the belt: one product, and nothing is dirt
    if not math.isfinite(rest.tolerance_px):
        product, dirt = np.where(np.isfinite(x_px), 1, -1).astype(np.int16), np.zeros_like(seen)
        laid.between[:] = False
    said = list(reasons)
    if np.count_nonzero(dirt):
        said.append(
            Reason("dirt", f"{int((dirt & seen).sum())} points off the belt are too few for a product")
        )
        for values in (x_px, laid.x_std_px, laid.margin):
            values[dirt] = np.nan
        coded = np.flatnonzero(stripe >= 0)
        laid.peak_stripe[coded[dirt[stripe[coded], peaks.row[coded]]]] = UNCODED
        seen &= ~dirt
    count = laid.refused
    if count:
        peaks_are = "1 peak could not be given to one stripe with certainty and is"
        if count > 1:
            peaks_are = f"{count} peaks could not be given to one stripe with certainty and are"
        said.append(Reason("ambiguous", f"{peaks_are} left out"))
    return StripeMap(
        x_px=x_px,
        x_std_px=laid.x_std_px,
        product=product,
        seen=seen,
        margin=laid.margin,
        ambiguous=laid.between,
        rest_px=rest.x_px,
        peak_stripe=laid.peak_stripe,
        reasons=tuple(said),
    )
