"""Segments: pieces of stripes between two places where they join or leave a rest line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.arrays import Flags, Integers
from roemetry.records import AMBIGUOUS, UNCODED, Peaks

_CLEARLY_LONGER = 3


@dataclass(frozen=True, eq=False, slots=True)
class SegmentTable:
    """First row, last row, number of rows and rest line (−1 none) of each segment."""

    first_row: Integers
    last_row: Integers
    rows: Integers
    line: Integers
    image_rows: int

    @classmethod
    def of(cls, peaks: Peaks, segment: Integers, segment_line: Integers) -> SegmentTable:
        """Make the table of (peak,) segment numbers and (segment,) rest lines."""
        count = segment_line.shape[0]
        first = np.full(count, peaks.image_size[0], np.int64)
        last = np.full(count, -1, np.int64)
        np.minimum.at(first, segment, peaks.row)
        np.maximum.at(last, segment, peaks.row)
        return cls(first, last, np.bincount(segment, minlength=count), segment_line, peaks.image_size[0])

    def anchored(self, end_rows: int, flicker_rows: int) -> Flags:
        """Say which segments are belt beyond doubt.

        They lie on a rest line and reach the image's top or bottom, or follow such a one on the same line
        after a flicker. A run on a rest line amid the image may be a body that happens to lie there: at a
        displacement of one stripe spacing a body crosses its neighbour's rest line twice.
        """
        anchored = np.zeros(self.line.size, np.bool_)
        for line in np.unique(self.line[self.line >= 0]):
            mine = np.flatnonzero(self.line == line)
            downwards = mine[np.argsort(self.first_row[mine])]
            reached = end_rows
            for segment in downwards:
                if self.first_row[segment] > reached:
                    break
                anchored[segment] = True
                reached = self.last_row[segment] + flicker_rows + 1
            reached = self.image_rows - 1 - end_rows
            for segment in downwards[::-1]:
                if self.last_row[segment] < reached:
                    break
                anchored[segment] = True
                reached = self.first_row[segment] - flicker_rows - 1
        return anchored


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
