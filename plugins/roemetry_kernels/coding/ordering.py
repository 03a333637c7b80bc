"""What the order of peaks along a row says about their stripes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel


@kernel
def vote_by_order(
    row_start: Integers,
    x_px: Floats,
    segment: Integers,
    label: Integers,
    rest_px: Floats,
    displacement_min_px: Floats,
    displacement_max_px: Floats,
) -> tuple[Integers, Integers]:
    """Let each row vote on which stripes each segment may be.

    On an opaque surface lit and seen from above, stripes keep their order along a row. Between a peak of the
    known stripe a and one of the known stripe b, k unknown peaks in order can only be stripes between a
    and b, the j-th of them no less than a + 1 + j and no more than b − (k − j). Where k fills the room, each
    is certain.

    Parameters
    ----------
    row_start, x_px
        Peaks by row, px.
    segment
        (peak,) segment of each peak; −1 leaves the peak out.
    label
        (segment,) known stripe of a segment, −1 unknown.
    rest_px
        (stripe, row) rest lines of the stripes that may be chosen, px.
    displacement_min_px, displacement_max_px
        (stripe,) range of possible displacements from the rest line, px.

    Returns
    -------
    tuple
        (segment, stripe) rows in which the segment may be the stripe; (segment,) rows that voted.
        A row that contradicts itself does not vote.
    """
    stripes = rest_px.shape[0]
    segments = label.shape[0]
    votes = np.zeros((segments, stripes), np.int64)
    voters = np.zeros(segments, np.int64)
    for row in range(row_start.shape[0] - 1):
        left = -1
        p = row_start[row]
        end = row_start[row + 1]
        while p < end:
            # the block of unknown peaks p … q − 1 that ends at the next known one
            q, unknown = p, 0
            while q < end and (segment[q] < 0 or label[segment[q]] < 0):
                if segment[q] >= 0:
                    unknown += 1
                q += 1
            right = stripes if q == end else label[segment[q]]
            if right <= left:
                break  # known stripes out of order: this row contradicts itself from here on
            if 0 < unknown <= right - left - 1:
                j = 0
                for u in range(p, q):
                    s = segment[u]
                    if s < 0:
                        continue
                    voters[s] += 1
                    for stripe in range(left + 1 + j, right - (unknown - j) + 1):
                        off = x_px[u] - rest_px[stripe, row]
                        if displacement_min_px[stripe] <= off <= displacement_max_px[stripe]:
                            votes[s, stripe] += 1
                    j += 1
            left = right
            p = q + 1
    return votes, voters


@kernel
def doubtful_by_order(
    row_start: Integers, segment: Integers, label: Integers, stripes: int
) -> NDArray[np.bool_]:
    """Mark known peaks whose rows show too many peaks on one side and too few on the other.

    If a body lies on its right neighbour's rest line and is taken for it, then to its left one stripe is
    missing and to its right there is one peak too many. In such a row every known peak between the place
    with too many and the nearest place with too few may be off by one.

    Parameters
    ----------
    row_start
        (row + 1,) where each row's peaks begin.
    segment
        (peak,) segment of each peak; −1 leaves the peak out.
    label
        (segment,) known stripe of a segment, −1 unknown.
    stripes
        Number of stripes that may be chosen.

    Returns
    -------
    ndarray
        (peak,) True for a known peak that may be another stripe.
    """
    doubtful = np.zeros(segment.shape[0], np.bool_)
    most = 0
    for row in range(row_start.shape[0] - 1):
        most = max(most, row_start[row + 1] - row_start[row])
    peak = np.empty(most + 1, np.int64)  # the known peaks of a row
    spare = np.empty(most + 1, np.int64)  # room left in the block before each known peak, and after the last
    for row in range(row_start.shape[0] - 1):
        count, unknown, left = 0, 0, -1
        for p in range(row_start[row], row_start[row + 1]):
            s = segment[p]
            if s < 0:
                continue
            if label[s] < 0:
                unknown += 1
                continue
            spare[count] = label[s] - left - 1 - unknown
            peak[count] = p
            count += 1
            left, unknown = label[s], 0
        spare[count] = stripes - left - 1 - unknown
        for block in range(count + 1):
            if spare[block] >= 0:
                continue
            other = block - 1
            while other >= 0 and spare[other] <= 0:
                other -= 1
            if other >= 0:
                doubtful[peak[other:block]] = True
            other = block + 1
            while other <= count and spare[other] <= 0:
                other += 1
            if other <= count:
                doubtful[peak[block:other]] = True
    return doubtful
