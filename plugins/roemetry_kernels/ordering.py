"""What the order of peaks along a row says about their stripes."""

from __future__ import annotations

import numpy as np
from numba import njit

from roemetry.arrays import Floats, Integers


@njit(cache=True, nogil=True)
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
