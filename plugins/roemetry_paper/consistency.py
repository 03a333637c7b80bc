"""Making codes consistent: a stripe has one peak a row, and stripes keep their order."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Integers
from roemetry.records import AMBIGUOUS, UNCODED, Peaks

_CLEARLY_LONGER = 3


def drop_doubles(peaks: Peaks, stripe: Integers, line: Integers, segment_rows: Integers) -> Integers:
    """Leave each stripe at most one peak a row.

    Where a row shows a stripe on the belt and on the product, the product's edge runs through that row and
    both are right: the brighter one stays. Of two others the one of the clearly longer segment stays and
    the other is refused; where neither is clearly longer, both are.

    Parameters
    ----------
    peaks
        The frame's peaks.
    stripe
        (peak,) stripe, `UNCODED` or `AMBIGUOUS`.
    line
        (peak,) rest line each peak lies on, −1 for none.
    segment_rows
        (peak,) length of the segment each peak is of, rows.
    """
    coded = np.flatnonzero(stripe >= 0)
    cell = peaks.row[coded] * (int(stripe.max(initial=0)) + 1) + stripe[coded]
    order = np.lexsort((-segment_rows[coded], cell))
    sorted_cell, sorted_peak = cell[order], coded[order]
    result = stripe.copy()
    for k in np.flatnonzero(sorted_cell[1:] == sorted_cell[:-1]):
        longer, shorter = sorted_peak[k], sorted_peak[k + 1]
        if (line[longer] == stripe[longer]) != (line[shorter] == stripe[shorter]):
            darker = shorter if peaks.amplitude[shorter] <= peaks.amplitude[longer] else longer
            result[darker] = UNCODED
            continue
        result[shorter] = AMBIGUOUS
        if segment_rows[longer] < _CLEARLY_LONGER * segment_rows[shorter]:
            result[longer] = AMBIGUOUS
    return result


def keep_order(peaks: Peaks, stripe: Integers) -> Integers:
    """Refuse peaks of a row whose stripes do not increase from left to right."""
    coded = np.flatnonzero(stripe >= 0)
    same_row = peaks.row[coded[1:]] == peaks.row[coded[:-1]]
    wrong = np.flatnonzero(same_row & (stripe[coded[1:]] <= stripe[coded[:-1]]))
    result = stripe.copy()
    result[coded[wrong]] = AMBIGUOUS
    result[coded[wrong + 1]] = AMBIGUOUS
    return result
