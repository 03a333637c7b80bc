"""Which pieces of the traced stripes are belt beyond doubt, and how pieces of one trace hang together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.records import AMBIGUOUS, Peaks
from roemetry.records.arrays import Flags, Integers
from roemetry_kernels.coding.ordering import doubtful_by_order
from roemetry_kernels.coding.tracing import cut_at_rest_lines

_END_ROWS = 12
"""Rows at the image's ends within which a belt segment must begin: a product never reaches so far."""
_BELT_ROWS_MIN = 6
"""Rows of a run on a rest line: a body that crosses the line stays on it for fewer."""
_FLICKER_ROWS = 3
"""Rows that may be missing from a run: speckle takes single peaks."""
_DOUBTFUL_ROWS_MIN = 3
"""Rows whose order speaks against a run before it is cut: single rows have false peaks."""
_LIVE_ROWS_MIN = 15
"""Rows of a run amid the image by which a stripe without ends counts as lit."""
_PASSES_MAX = 4
"""Passes of cutting; each finds what the one before laid bare."""


@dataclass(frozen=True, eq=False, slots=True)
class Belt:
    """Traces cut into segments where they join or leave a rest line.

    Attributes
    ----------
    segment
        (peak,) segment of each peak. Segments of one trace are numbered in the order of its rows.
    fragment, rows
        (segment,) the trace a segment is a piece of; its length, rows.
    anchored
        (segment,) True for belt beyond doubt.
    on_line
        (segment,) True for a piece that lies on some rest line.
    live
        (live,) stripes that have belt, or may have; the others are dead.
    known
        (segment,) index into `live` of an anchored segment's stripe, −1 for the others.
    """

    segment: Integers
    fragment: Integers
    rows: Integers
    anchored: Flags
    on_line: Flags
    live: Integers
    known: Integers

    def continued(self, label: Integers) -> Integers:
        """Settle pieces on a rest line amid the image by what their trace is before and after them.

        Parameters
        ----------
        label
            (segment,) index into `live`, −1 unknown, `AMBIGUOUS` given up.

        Returns
        -------
        ndarray
            (segment,) labels. A piece between two pieces of one stripe is that stripe: the trace crosses
            the rest line of another. A piece whose trace is another stripe on the one side it is known is
            given up: it may be either.
        """
        found = label.copy()
        for k in np.flatnonzero(self.on_line & ~self.anchored):
            before = self._neighbour(label, int(k), int(k) - 1)
            after = self._neighbour(label, int(k), int(k) + 1)
            if before >= 0 and before == after:
                found[k] = before
            elif label[k] >= 0 and max(before, after) >= 0 and label[k] not in (before, after):
                found[k] = AMBIGUOUS
        return found

    def _neighbour(self, label: Integers, here: int, there: int) -> int:
        inside = 0 <= there < label.size and self.fragment[there] == self.fragment[here]
        return int(label[there]) if inside else -1


def belt_of(peaks: Peaks, fragment: Integers, fragments: int, line: Integers, stripes: int) -> Belt:
    """Cut traces at rest lines and find the belt.

    A run on a rest line is belt beyond doubt if it reaches the image's top or bottom and no row speaks
    against it. A body at a displacement of one stripe spacing lies on its neighbour's rest line, often right
    where that neighbour's belt ends; then its rows show a peak too many on one side and one too few on the
    other, and there the run is cut.

    Parameters
    ----------
    peaks
        The frame's peaks.
    fragment, fragments
        (peak,) trace of each peak, and their number.
    line
        (peak,) rest line each peak lies on, −1 for none.
    stripes
        Number of rest lines.
    """
    doubted = np.zeros(len(peaks), np.bool_)
    for _ in range(_PASSES_MAX):
        # a doubted peak is cut from its run by a line number that no anchor can have
        cut_line = np.where(doubted & (line >= 0), line + stripes, line)
        segment, segment_line = cut_at_rest_lines(
            fragment, cut_line, fragments, _BELT_ROWS_MIN, _FLICKER_ROWS
        )
        rows = np.bincount(segment, minlength=segment_line.size)
        anchored = _anchored(peaks, segment, np.where(segment_line < stripes, segment_line, -1))
        live = _live(segment_line, anchored, rows, stripes)
        known = np.where(anchored, np.searchsorted(live, segment_line), -1)
        doubtful = doubtful_by_order(peaks.row_start, segment, known, live.size) & ~doubted
        often = np.bincount(segment[doubtful], minlength=rows.size) >= _DOUBTFUL_ROWS_MIN
        doubtful &= often[segment]
        if not doubtful.any():
            break
        doubted |= doubtful
    of = np.empty(rows.size, np.int64)
    of[segment] = fragment
    return Belt(segment, of, rows, anchored, segment_line >= 0, live, known)


def _live(segment_line: Integers, anchored: Flags, rows: Integers, stripes: int) -> Integers:
    """Give the stripes that may be lit: with belt, or with a longer run on their rest line amid the image.

    Such a run may be another's body; but a stripe whose ends are missing must not be given to another.
    """
    if not anchored.any():
        return np.empty(0, np.int64)
    line = segment_line % stripes
    mine = (segment_line >= 0) & (anchored | (rows >= _LIVE_ROWS_MIN))
    return np.unique(line[mine])


def _anchored(peaks: Peaks, segment: Integers, line: Integers) -> Flags:
    """Say which segments on a rest line reach the image's top or bottom, if need be over a flicker."""
    count = line.size
    first = np.full(count, peaks.image_size[0], np.int64)
    last = np.full(count, -1, np.int64)
    np.minimum.at(first, segment, peaks.row)
    np.maximum.at(last, segment, peaks.row)
    anchored = np.zeros(count, np.bool_)
    for number in np.unique(line[line >= 0]):
        mine = np.flatnonzero(line == number)
        downwards = mine[np.argsort(first[mine])]
        reached = _END_ROWS
        for k in downwards:
            if first[k] > reached:
                break
            anchored[k] = True
            reached = last[k] + _FLICKER_ROWS + 1
        reached = peaks.image_size[0] - 1 - _END_ROWS
        for k in downwards[::-1]:
            if last[k] < reached:
                break
            anchored[k] = True
            reached = first[k] - _FLICKER_ROWS - 1
    return anchored
