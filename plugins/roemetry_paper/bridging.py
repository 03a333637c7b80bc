"""From coded peaks to a dense stripe map: belt or product, short gaps bridged, products numbered."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers, Labels
from roemetry.records import AMBIGUOUS, BELT, NOTHING, UNCODED, Peaks, Reason, StripeMap
from roemetry_paper.rest_lines import RestLines

_PRODUCT_ROWS_MIN = 3
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
    shape = rest.x_px.shape
    coded = stripe >= 0
    cells = stripe[coded], peaks.row[coded]
    x_px, x_std_px, margins = (np.full(shape, np.nan) for _ in range(3))
    x_px[cells] = peaks.x_px[coded]
    x_std_px[cells] = peaks.x_std_px[coded]
    margins[cells] = margin[coded]
    seen = np.isfinite(x_px)
    distance_px = np.where(np.isnan(rest.x_px), np.inf, np.abs(x_px - rest.x_px))
    off_belt = seen & (distance_px > rest.tolerance_px)
    for s in range(shape[0]):
        _drop_shallow(off_belt[s], seen[s], distance_px[s], _REACH_TOLERANCES * rest.tolerance_px)
        _bridge(x_px[s], seen[s], off_belt[s], longest_gap_rows)
    known = np.isfinite(x_px)
    if np.isfinite(rest.x_px).any():
        product, dirt = _numbered(off_belt, known, smallest_product_points)
    else:
        product, dirt = np.where(known, 1, NOTHING).astype(np.int16), np.zeros_like(known)
    said = list(reasons)
    peak_stripe = stripe.copy()
    if dirt.any():
        said.append(
            Reason("dirt", f"{int((dirt & seen).sum())} points off the belt are too few for a product")
        )
        for values in (x_px, x_std_px, margins):
            values[dirt] = np.nan
        peak_stripe[coded] = np.where(dirt[cells], UNCODED, stripe[coded])
        seen &= ~dirt
    ambiguous = _ambiguous_cells(peaks, stripe, rest)
    count = int((stripe == AMBIGUOUS).sum())
    if count:
        said.append(
            Reason(
                "ambiguous", f"{count} peaks could not be given to one stripe with certainty and are left out"
            )
        )
    return StripeMap(
        x_px=x_px,
        x_std_px=x_std_px,
        product=product,
        seen=seen,
        margin=margins,
        ambiguous=ambiguous,
        rest_px=rest.x_px,
        peak_stripe=peak_stripe.astype(np.int16),
        reasons=tuple(said),
    )


def _drop_shallow(off_belt: Flags, seen: Flags, distance_px: Floats, reach_px: float) -> None:
    """Take runs off the belt back to it that are too short or nowhere far from it (in place).

    Where a product's shadow cuts a belt stripe lengthwise, its peak shifts by a pixel or two.
    """
    rows = np.flatnonzero(seen)
    values = np.concatenate([[False], off_belt[rows], [False]])
    edges = np.flatnonzero(np.diff(values.astype(np.int8)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        run = rows[begin:end]
        if run.size < _PRODUCT_ROWS_MIN or distance_px[run].max() < reach_px:
            off_belt[run] = False


def _bridge(x_px: Floats, seen: Flags, off_belt: Flags, longest_gap_rows: int) -> None:
    """Fill gaps between seen points of one stripe (in place); a gap beside a product belongs to it."""
    rows = np.flatnonzero(seen)
    gaps = np.flatnonzero(np.diff(rows) > 1)
    for k in gaps:
        before, after = rows[k], rows[k + 1]
        if after - before - 1 > longest_gap_rows:
            continue
        between = np.arange(before + 1, after)
        x_px[between] = np.interp(between, (before, after), (x_px[before], x_px[after]))
        off_belt[between] = off_belt[before] or off_belt[after]


def _numbered(off_belt: Flags, known: Flags, smallest: int) -> tuple[Labels, Flags]:
    """Number connected points off the belt 1…n from left to right; give (stripe, row) numbers and dirt.

    Neighbours are the same stripe's next row and the next stripe's same row. What is not seen joins what
    lies off the belt on both sides of it, along the stripe or across.
    """
    import cv2

    filled = off_belt.copy()
    if off_belt.shape[0] > 2:
        filled[1:-1] |= ~known[1:-1] & off_belt[:-2] & off_belt[2:]
    for s in range(off_belt.shape[0]):
        rows = np.flatnonzero(known[s])
        for k in np.flatnonzero(np.diff(rows) > 1):
            before, after = rows[k], rows[k + 1]
            filled[s, before:after] |= off_belt[s, before] and off_belt[s, after]
    _, labels = cv2.connectedComponents(filled.astype(np.uint8), connectivity=4, ltype=cv2.CV_16U)
    sizes = np.bincount(labels[off_belt], minlength=int(labels.max()) + 1)
    sizes[0] = 0
    big = np.flatnonzero(sizes >= smallest)
    by_place = sorted(big, key=lambda label: float(np.argwhere(labels == label)[:, 0].mean()))
    product = np.where(known, BELT, NOTHING).astype(np.int16)
    product[off_belt] = NOTHING
    for number, label in enumerate(by_place, start=1):
        product[(labels == label) & off_belt] = number
    return product, off_belt & (product == NOTHING)


def _ambiguous_cells(peaks: Peaks, stripe: Integers, rest: RestLines) -> Flags:
    """Mark the cells a refused peak may belong to: the stripes whose rest lines are its nearest two."""
    cells = np.zeros(rest.x_px.shape, np.bool_)
    if np.isnan(rest.x_px).all():
        return cells
    refused = np.flatnonzero(stripe == AMBIGUOUS)
    if refused.size:
        right = (rest.x_px[:, peaks.row[refused]] < peaks.x_px[refused]).sum(axis=0)
        for near in (right - 1, right):
            inside = (near >= 0) & (near < rest.x_px.shape[0])
            cells[near[inside], peaks.row[refused][inside]] = True
    return cells
