"""From labelled peaks to a dense stripe map: belt or product, short gaps bridged, products numbered.

Gaps that are short enough are bridged by straight lines. Points off the rest lines that hang together along
and across stripes are one product, or, if they are few, dirt. Thin ends are judged by the side to which
products displace stripes, which is one in a frame. It fails where two products touch: they are one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.records import AMBIGUOUS, UNLABELLED, Peaks, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers, Labels
from roemetry.stages import StageOptions
from roemetry_kernels.compiling import kernel
from roemetry_kernels.rest_lines import RestLines


class BridgingOptions(StageOptions):
    """Gaps and sizes: the options of every coder that lays its peaks out by `bridged`."""

    longest_gap_rows: int = Field(
        default=20, ge=0, description="longest gap along a stripe that is bridged by a straight line, rows"
    )
    smallest_product_points: int = Field(
        default=40, ge=1, description="bodies with fewer points, taken together, are dirt on the belt"
    )


_REACH_TOLERANCES = 3.0
"""A run off the belt is product by itself only if it gets this many tolerances away from its rest line."""


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
    """Lay labelled peaks out over (stripe, row) and bridge short gaps by straight lines (section 3.3).

    Parameters
    ----------
    peaks
        The frame's peaks.
    stripe
        (peak,) stripe, `UNLABELLED` or `AMBIGUOUS`.
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
        labelled = np.flatnonzero(stripe >= 0)
        laid.peak_stripe[labelled[dirt[stripe[labelled], peaks.row[labelled]]]] = UNLABELLED
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


_PRODUCT_ROWS_MIN = 3  # of a stripe off the belt: less is noise or dirt
_THIN_ROWS_MIN, _THIN_SEEN_SHARE = 8, 0.5
"""Points of a run near the belt that may be product, and their share of its rows: of belt stripes that a
product's lit side cuts, the scraps fill a seventh of the rows, of thin ends two thirds or more."""


class Layout(NamedTuple):
    """Coded points over (stripe, row)."""

    x_px: Floats
    x_std_px: Floats
    margin: Floats
    """x_px, x_std_px, margin: (stripe, row) what is known of each point, gaps bridged; NaN where there is
    none."""
    seen: Flags
    """(stripe, row) True where there is a peak."""
    peak_stripe: Labels
    """(peak,) stripe in few bits."""
    product: Labels
    """(stripe, row) product's number, 0 on the belt, −1 where nothing is known and for dirt."""
    dirt: Flags
    """(stripe, row) True for what lies off the belt and is too small for a product."""
    between: Flags
    refused: int
    """between, refused: (stripe, row) True where a refused peak may belong; and the number of those peaks."""


@kernel
def laid_out(
    row: Integers, x_px: Floats, x_std_px: Floats, stripe: Integers, margin: Floats, refused: int,
    rest_px: Floats, tolerance_px: float, reach_px: float, longest_gap_rows: int, smallest: int,
) -> tuple[Floats, Floats, Floats, Flags, Labels, Labels, Flags, Flags, int]:  # fmt: skip
    """Lay labelled peaks out over (stripe, row); of two in one cell the last one counts.

    Parameters
    ----------
    row, x_px, x_std_px, stripe, margin
        (peak,) what is known of each; `stripe` below 0 is not labelled, `refused` is refused.
    refused
        See above.
    rest_px, tolerance_px, reach_px, longest_gap_rows
        See `off_belt_and_bridged`.
    smallest
        See `numbered`.

    Returns
    -------
    tuple
        The fields of `Layout`.
    """
    shape = rest_px.shape
    laid_x_px, laid_std_px, laid_margin = np.empty(shape), np.empty(shape), np.empty(shape)
    seen = np.zeros(shape, np.bool_)
    peak_stripe = np.empty(row.size, np.int16)
    laid_x_px[:] = laid_std_px[:] = laid_margin[:] = np.nan
    for p in range(row.shape[0]):
        s, r = stripe[p], row[p]
        peak_stripe[p] = s
        if s >= 0:
            laid_x_px[s, r], laid_std_px[s, r] = x_px[p], x_std_px[p]
            laid_margin[s, r], seen[s, r] = margin[p], True
    off_belt = off_belt_and_bridged(laid_x_px, rest_px, tolerance_px, reach_px, longest_gap_rows)
    product, dirt = numbered(laid_x_px, off_belt, smallest)
    between, count = cells_between(row, x_px, stripe, refused, rest_px)
    return laid_x_px, laid_std_px, laid_margin, seen, peak_stripe, product, dirt, between, count


@kernel
def off_belt_and_bridged(
    x_px: Floats, rest_px: Floats, tolerance_px: float, reach_px: float, longest_gap_rows: int
) -> Flags:
    """Say which points lie off the belt, and bridge short gaps by straight lines, in place.

    A run lies on one side of its rest line. One that is too short is taken back to the belt, and so is one
    that is nowhere far from it: where a product's shadow cuts a belt stripe lengthwise, its peak shifts by a
    pixel or two, away from where products displace it; where a product's lit side cuts one, only scraps of it
    are left. A near run that is neither and lies along product on the next stripe is where that thins out
    (`_keep_thin`). A gap beside a product is its.

    Parameters
    ----------
    x_px
        (stripe, row) seen points, NaN elsewhere; bridged ones are filled in.
    rest_px
        (stripe, row) rest lines; NaN where none is known: then every point is off the belt.
    tolerance_px
        How far from its rest line a point still lies on the belt, px.
    reach_px
        How far a run must get away from its rest line to be product by itself, px.
    longest_gap_rows
        Longer gaps stay empty, rows.

    Returns
    -------
    ndarray
        (stripe, row) True off the belt.
    """
    stripes, rows = x_px.shape
    off_belt, near = np.zeros((stripes, rows), np.bool_), np.zeros((stripes, rows), np.bool_)
    seen = np.empty(rows, np.int64)
    rising, any_near = 0, False
    for s in range(stripes):
        count = 0
        for row in range(rows):
            if not np.isnan(x_px[s, row]):
                seen[count] = row
                count += 1
                off_belt[s, row] = not abs(x_px[s, row] - rest_px[s, row]) <= tolerance_px
        begin = 0
        while begin < count:
            if not off_belt[s, seen[begin]]:
                begin += 1
                continue
            end, farthest, sign = begin, 0.0, 0
            while end < count and off_belt[s, seen[end]]:
                off = x_px[s, seen[end]] - rest_px[s, seen[end]]
                if off * sign < 0.0:
                    break  # the other side of the belt: what a shadow shifts there is not the product's end
                farthest = max(farthest, np.inf if np.isnan(off) else abs(off))
                sign += 1 if off > 0.0 else -1 if off < 0.0 else 0
                end += 1
            if end - begin < _PRODUCT_ROWS_MIN or farthest < reach_px:
                dense = end - begin >= _THIN_SEEN_SHARE * (seen[end - 1] + 1 - seen[begin])
                thin = end - begin >= _THIN_ROWS_MIN and dense
                any_near |= thin
                for k in range(begin, end):
                    off_belt[s, seen[k]], near[s, seen[k]] = False, thin
            else:
                # which way products displace stripes here
                rising += sign
            begin = end
    if any_near and rising != 0:
        _keep_thin(x_px, rest_px, off_belt, near, 1.0 if rising > 0 else -1.0)
    for s in range(stripes):
        before = -1
        for row in range(rows):
            if np.isnan(x_px[s, row]):
                continue
            if before >= 0 and 1 < row - before <= longest_gap_rows + 1:
                slope = (x_px[s, row] - x_px[s, before]) / (row - before)
                for between in range(before + 1, row):
                    x_px[s, between] = x_px[s, before] + slope * (between - before)
                    off_belt[s, between] = off_belt[s, before] or off_belt[s, row]
            before = row
    return off_belt


@kernel
def _keep_thin(x_px: Floats, rest_px: Floats, off_belt: Flags, near: Flags, side: float) -> None:
    """Put near runs off the belt, in place, that go on where the next stripe's product thins out.

    Outwards from either side, so that one kept run may hold the next.

    Parameters
    ----------
    x_px, rest_px
        (stripe, row) points and rest lines, px.
    off_belt
        (stripe, row) True on product; kept runs are added.
    near
        (stripe, row) True on dense runs that are nowhere far from the belt.
    side
        Sign of x − rest line on product.
    """
    stripes, rows = x_px.shape
    for step in (1, -1):
        for k in range(1, stripes):
            s = k if step > 0 else stripes - 1 - k
            row = 0
            while row < rows:
                if not near[s, row]:
                    row += 1
                    continue
                begin, count, right, beside = row, 0, 0, 0
                while row < rows and (near[s, row] or np.isnan(x_px[s, row])):
                    if near[s, row]:
                        count += 1
                        right += side * (x_px[s, row] - rest_px[s, row]) > 0.0
                        beside += off_belt[s - step, row]
                    row += 1
                # all on the product's side, and beside product in more than half of the rows
                if right == count < 2 * beside:
                    for r in range(begin, row):
                        off_belt[s, r] |= near[s, r]


@kernel
def numbered(x_px: Floats, off_belt: Flags, smallest: int) -> tuple[NDArray[np.int16], Flags]:
    """Number connected points off the belt 1…n from left to right.

    Neighbours are the same stripe's next row and the next stripe's same row. What is not seen joins what
    lies off the belt on both sides of it, along the stripe or across.

    Parameters
    ----------
    x_px
        (stripe, row) points, NaN where nothing is known.
    off_belt
        (stripe, row) True off the belt.
    smallest
        Groups of fewer points are dirt.

    Returns
    -------
    tuple
        (stripe, row) product's number, 0 on the belt, −1 where nothing is known and for dirt; and
        (stripe, row) True for dirt.
    """
    stripes, rows = x_px.shape
    product = np.empty((stripes, rows), np.int16)
    dirt = np.zeros((stripes, rows), np.bool_)
    stripe, begin, end = _runs(_joined(x_px, off_belt))
    runs = begin.size
    parent = np.arange(runs)
    # Runs of a stripe and of the next that have a row in common hang together.
    one = other = 0
    while one < runs and other < runs:
        if stripe[other] <= stripe[one]:
            other += 1
        elif stripe[other] > stripe[one] + 1 or end[one] <= begin[other]:
            one += 1
        else:
            if begin[one] < end[other]:
                _join(parent, one, other)
            if end[one] < end[other]:
                one += 1
            else:
                other += 1
    points, cells, place = np.zeros(runs, np.int64), np.zeros(runs, np.int64), np.zeros(runs)
    for k in range(runs):
        root = _root(parent, k)
        for row in range(begin[k], end[k]):
            points[root] += off_belt[stripe[k], row]
        cells[root] += end[k] - begin[k]
        place[root] += stripe[k] * (end[k] - begin[k])
    # From left to right; of the few products there are, the place of each is counted.
    number = np.zeros(runs, np.int16)
    least = max(smallest, 1)
    for k in range(runs):
        if points[k] >= least:
            at, before = place[k] / cells[k], 1
            for other in range(runs):
                if points[other] >= least:
                    away = place[other] / cells[other] - at
                    before += away < 0.0 or (away == 0.0 and other < k)
            number[k] = before
    for s in range(stripes):
        for row in range(rows):
            product[s, row] = -1 if np.isnan(x_px[s, row]) else 0
    for k in range(runs):
        mine, s = number[_root(parent, k)], stripe[k]
        for row in range(begin[k], end[k]):
            if off_belt[s, row]:
                product[s, row] = mine if mine > 0 else -1
                dirt[s, row] = mine == 0
    return product, dirt


@kernel
def _runs(filled: Flags) -> tuple[Integers, Integers, Integers]:
    """Give stripe, first row and row after the last of each run along a stripe."""
    stripes, rows = filled.shape
    room = stripes * (rows // 2 + 1)
    stripe, begin, end = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    count = 0
    for s in range(stripes):
        row = 0
        while row < rows:
            if not filled[s, row]:
                row += 1
                continue
            stripe[count], begin[count] = s, row
            while row < rows and filled[s, row]:
                row += 1
            end[count] = row
            count += 1
    return stripe[:count], begin[:count], end[:count]


@kernel
def cells_between(
    row: Integers, x_px: Floats, stripe: Integers, refused: int, rest_px: Floats
) -> tuple[Flags, int]:
    """Mark the cells a refused peak may belong to: the stripes whose rest lines are its nearest two.

    Gives (stripe, row) flags and the number of refused peaks.
    """
    stripes, rows = rest_px.shape
    cells = np.zeros((stripes, rows), np.bool_)
    count = 0
    for p in range(row.shape[0]):
        if stripe[p] != refused:
            continue
        count += 1
        right = 0
        for s in range(stripes):
            right += rest_px[s, row[p]] < x_px[p]
        if right > 0:
            cells[right - 1, row[p]] = True
        if right < stripes and not np.isnan(rest_px[right, row[p]]):
            cells[right, row[p]] = True
    return cells, count


@kernel
def _joined(x_px: Floats, off_belt: Flags) -> Flags:
    """Give what lies off the belt, with what is not seen between it."""
    stripes, rows = x_px.shape
    filled = off_belt.copy()
    # across the stripes first, then along them
    for s in range(1, stripes - 1):
        for row in range(rows):
            if np.isnan(x_px[s, row]) and off_belt[s - 1, row] and off_belt[s + 1, row]:
                filled[s, row] = True
    for s in range(stripes):
        last = -1
        for row in range(rows):
            if np.isnan(x_px[s, row]):
                continue
            if 0 <= last < row - 1 and off_belt[s, last] and off_belt[s, row]:
                filled[s, last:row] = True
            last = row
    return filled


@kernel
def _root(parent: Integers, cell: int) -> int:
    while parent[cell] != cell:
        # ways to the root are halved on the way
        parent[cell] = parent[parent[cell]]
        cell = parent[cell]
    return cell


@kernel
def _join(parent: Integers, one: int, other: int) -> None:
    a, b = _root(parent, one), _root(parent, other)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
