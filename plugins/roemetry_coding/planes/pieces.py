"""Pieces of traces: where they lie on a rest line, where they are cut, and which stripes are there at all.

Model. Belt stays on its rest line; a body along another stripe's rest line lies slightly beside it.
A single peak scatters about the line by as much as a body may lie beside it; the mean of `_ROWS` peaks along
the trace scatters by a third of that. So a peak is on a rest line if the mean of those before it, or after
it, is, within what such means are off in the image's outer rows, where belt is expected; there, too, it is
seen by how much the belt's stripes have moved since they were calibrated. Traces are cut where they join or
leave a rest line, and for some rows before a belt's end amid the image, where a body may begin within the
tolerance: these ends have no rest line and may hold two stripes. Cutting too much is cheap, for the tie
across a cut is weak; cutting too little makes one stripe of two.

Assumes belt at the image's top and bottom. A body that lies within a mean's scatter of a rest line, for as
long as belt would, is taken for belt here; whether that can be is asked by `vetoes`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import median_of

ENDS = -2
"""Rest line of the ends that were cut off: not known."""
_AMID_SHARE = 0.5
"""What lies on a rest line amid the image only, and is shorter, may be the neighbour's body."""
_FOUND_ROWS_MIN = 10
"""From its first peak to its last one: of fewer rows a share says too little."""
_ROWS = 12
"""Peaks before, or after, one that are asked for their mean: it scatters by a third of what one does."""
_LEAST_ROWS = 6
"""Of fewer the mean says too little."""
_END_PEAKS_MIN = 10
"""Fewer peaks at the image's top or bottom do not say how far the belt's stripe has moved."""
_STILL = 0.3
"""How far a mean may always be off, of what a single peak may be: the scatter of a mean of 12."""
_SIGMAS = 4.5
"""How far a mean may be off, in its own scatter in the outer rows: one in 10⁵ is."""
_SEARCH = 1.5
"""Peaks farther off than so many times what a single one may be are of something else."""
_MAD_TO_STD = 1.4826
"""Of a normal distribution."""


class Pieces(NamedTuple):
    """Traces, cut where they join or leave a rest line; a piece is one stripe but for an end."""

    trace: Integers
    of: Integers
    """trace, of: (peak,) trace; piece of it."""
    line: Integers
    """(peak,) rest line that a peak lies on, together with those beside it in its trace; −1 for none."""
    rest: Integers
    """(piece,) rest line that it follows, −1 for none, `ENDS` for what was cut off at a belt's end."""
    home: Integers
    """(piece,) the rest line that it follows or was cut off from, −1 for none."""
    anchored: Flags
    """(piece,) True for belt that reaches the image's border."""
    light: Floats
    """(piece,) mean amplitude of its peaks over that of the peaks beside each, at most 1 for a peak."""


@kernel
def relative_light(row_start: Integers, amplitude: Floats) -> Floats:
    """Give (peak,) amplitude over the median of the two peaks on either side in its row, at most 1.

    1 where nothing lies beside a peak and where no amplitude is known. `row_start` is (row + 1,).
    """
    found = np.ones(amplitude.shape[0])
    beside = np.empty(4)
    for row in range(row_start.shape[0] - 1):
        first, end = row_start[row], row_start[row + 1]
        for p in range(first, end):
            many = 0
            for q in range(max(first, p - 2), min(end, p + 3)):
                if q != p:
                    beside[many] = amplitude[q]
                    many += 1
            if many > 0:
                # the mean of the two middle ones of up to four
                for k in range(1, many):  # so few are sorted where they stand
                    one, m = beside[k], k
                    while m > 0 and beside[m - 1] > one:
                        beside[m] = beside[m - 1]
                        m -= 1
                    beside[m] = one
                middle = 0.5 * (beside[(many - 1) // 2] + beside[many // 2])
                # brighter than its neighbours says nothing: at most 1
                if amplitude[p] < middle:
                    found[p] = amplitude[p] / middle
    return found


@kernel
def presence_of(
    line: Floats, piece: Integers, piece_line: Integers, enters: Floats, leaves: Floats, lines: int,
    rows_full: int, rows_min: int, end_lines: int, lost: float,
) -> Floats:  # fmt: skip
    """Give (line, stripe) how surely a stripe's belt is there to be seen, 0 to 1.

    Parameters
    ----------
    line
        (peak,) see `roemetry_coding.planes.lines`.
    piece, piece_line
        (peak,) piece; (piece,) rest line that it follows, below 0 for none.
    enters, leaves
        (stripe,) lines at which the rest line enters and leaves the image.
    lines
        Number of lines.
    rows_full, rows_min
        Peaks on the rest line that make a stripe certain; with fewer than the second it is not there.
    end_lines
        A stripe's belt may begin or end this far from the image's border.
    lost
        Where it does not reach so far: what is left of its presence there.
    """
    stripes = enters.shape[0]
    seen = np.zeros(stripes)
    first, last = np.full(stripes, np.inf), np.full(stripes, -np.inf)
    for p in range(line.shape[0]):
        s = piece_line[piece[p]]
        if s >= 0:
            seen[s] += 1.0
            first[s], last[s] = min(first[s], line[p]), max(last[s], line[p])
    presence = np.zeros((lines, stripes))
    for s in range(stripes):
        # too few peaks on its line: bodies cross it for as many
        if seen[s] < rows_min:
            continue
        low, high = min(enters[s], leaves[s]), max(enters[s], leaves[s])
        # neither end reaches the border, and it is short: a neighbour's body, one spacing up
        amid = first[s] - low > end_lines and high - last[s] > end_lines
        if amid and seen[s] < _AMID_SHARE * (high - low):
            continue
        for e in range(lines):
            # beyond where its belt ends, unless that is near the border
            off = (e < first[s] and first[s] - low > end_lines) or (
                e > last[s] and high - last[s] > end_lines
            )
            presence[e, s] = min(seen[s] / rows_full, 1.0) * (lost if off else 1.0)
    return presence


@kernel
def found_share(row: Integers, line: Integers, stripes: int, rows: int, outer: int) -> Floats:
    """Give (stripe,) the share of rows in which a stripe's light is found on belt that nothing covers.

    Nothing covers the belt at the image's top, or at its bottom: the better of the two is taken, each from
    the stripe's first peak there to its last one. 1 where neither shows enough of it to tell.

    Parameters
    ----------
    row, line
        (peak,) row; rest line it lies on, −1 for none.
    stripes, rows
        Number of rest lines and of image rows.
    outer
        Number of rows that are the top, and of those that are the bottom.
    """
    found = np.zeros((2, stripes))
    first, last = np.full((2, stripes), rows), np.full((2, stripes), -1)
    for p in range(row.shape[0]):
        s = line[p]
        # only the image's top and bottom
        if s < 0 or outer <= row[p] < rows - outer:
            continue
        part = 0 if row[p] < outer else 1
        found[part, s] += 1.0
        first[part, s], last[part, s] = min(first[part, s], row[p]), max(last[part, s], row[p])
    share = np.ones(stripes)
    for s in range(stripes):
        best = 0.0
        for part in range(2):
            long = last[part, s] - first[part, s] + 1
            if long >= _FOUND_ROWS_MIN:
                # more than one peak a row at most counts as all rows
                best = max(best, found[part, s] / long)
        if best > 0.0:
            share[s] = min(best, 1.0)
    return share


@kernel
def between_bare(row: Integers, line: Integers, stripes: int, rows: int, rows_min: int) -> Flags:
    """Mark peaks on a rest line where the rest lines on either side show nothing.

    What hides both may lie under this one, too, displaced by just a whole spacing.

    Parameters
    ----------
    row, line
        (peak,) row; rest line it lies on, −1 for none.
    stripes, rows
        Number of rest lines and of image rows.
    rows_min
        A rest line is bare where nothing lies on it for so many rows on end.
    """
    bare = np.zeros((stripes, rows), np.bool_)
    last = np.full(stripes, -1, np.int64)
    # behind the peaks, one more round for each line closes its last gap
    for p in range(row.shape[0] + stripes):
        r = row[p] if p < row.shape[0] else rows
        s = line[p] if p < row.shape[0] else p - row.shape[0]
        if s < 0:
            continue
        if r - last[s] > rows_min:
            bare[s, last[s] + 1 : r] = True
        last[s] = r
    found = np.zeros(row.shape[0], np.bool_)
    for p in range(row.shape[0]):
        s = line[p]
        # the outer lines have a neighbour on one side only
        if 0 < s < stripes - 1:
            found[p] = bare[s - 1, row[p]] and bare[s + 1, row[p]]
    return found


@kernel
def cut_ends(
    row: Integers, piece: Integers, line: Integers, rows: int, end_rows: int, border_rows: int
) -> tuple[Integers, Integers, Flags, Integers]:
    """Cut the ends off pieces that lie on a rest line and end amid the image.

    There a body that begins on the rest line, within its tolerance, may have been taken along.

    Parameters
    ----------
    row, piece
        (peak,) row and piece, peaks sorted by row.
    line
        (piece,) rest line a piece lies on, −1 for none.
    rows
        Image rows.
    end_rows
        What is cut off, rows.
    border_rows
        A piece that begins or ends this near to the image's border is not cut there.

    Returns
    -------
    tuple
        (peak,) new pieces; (piece,) the rest line of each, `ENDS` for ends; (piece,) True for what is left of
        a piece that reaches the image's border; (piece,) the rest line it was, or was cut off from.
    """
    pieces = line.shape[0]
    first = np.full(pieces, rows, np.int64)
    last = np.full(pieces, -1, np.int64)
    for p in range(row.shape[0]):
        first[piece[p]] = min(first[piece[p]], row[p])
        last[piece[p]] = max(last[piece[p]], row[p])
    number = np.full((pieces, 3), -1, np.int64)
    found = np.empty(row.shape[0], np.int64)
    on = np.empty(3 * pieces, np.int64)
    anchored, home = np.zeros(3 * pieces, np.bool_), np.empty(3 * pieces, np.int64)
    count = 0
    for p in range(row.shape[0]):
        f, part = piece[p], 0
        if line[f] >= 0:
            # a belt that begins amid the image, or ends there: the rows next to that end
            if first[f] > border_rows and row[p] < first[f] + end_rows:
                part = 1
            elif last[f] < rows - 1 - border_rows and row[p] > last[f] - end_rows:
                part = 2
        # each of the three parts gets a number when it is first met
        if number[f, part] < 0:
            number[f, part] = count
            on[count] = line[f] if part == 0 else ENDS
            home[count] = line[f]
            anchored[count] = part == 0 and (first[f] <= border_rows or last[f] >= rows - 1 - border_rows)
            count += 1
        found[p] = number[f, part]
    return found, on[:count].copy(), anchored[:count].copy(), home[:count].copy()


@kernel
def on_rest_line(
    row: Integers, x_px: Floats, trace: Integers, line: Integers, rest_px: Floats, tolerance_px: float,
    offset_px: float, outer: int,
) -> Integers:  # fmt: skip
    """Give (peak,) the rest line that it lies on together with those before, or after, it in its trace.

    Single peaks scatter about the line by as much as a body may lie beside it; the mean of some rows does
    not. How far it may be off is what it is in the image's outer rows, where belt is expected; there, too, it
    is seen by how much the belt's stripes have moved from the calibrated lines. What goes through a line
    from one side to the other within a few rows does not lie on it: a body's edge, where it meets a
    neighbour's belt, does that.

    Parameters
    ----------
    row, x_px, trace
        (peak,) row, in increasing order; place, px; trace.
    line
        (peak,) rest line that a peak lies on by itself, −1 for none.
    rest_px, tolerance_px, offset_px
        See `roemetry_kernels.rest_lines.RestLines`.
    outer
        Rows at the image's top, and bottom, where belt is expected.
    """
    peaks, rows = row.shape[0], rest_px.shape[1]
    # how far the whole belt has moved, linearly between top and bottom
    ends_px = _offsets_at_ends(row, x_px, line, rest_px, offset_px, outer)
    start, order = _along(trace)
    mean_px = np.full((peaks, 2), np.inf)
    told = np.zeros(peaks, np.bool_)
    for t in range(start.shape[0] - 1):
        for n in range(start[t], start[t + 1]):
            p = order[n]
            s = line[p]
            if s < 0:
                continue
            # the peaks before and the peaks behind, itself included
            for side in range(2):
                total, count, m = 0.0, 0, n
                while start[t] <= m < start[t + 1] and count < _ROWS:
                    q = order[m]
                    at = row[q] / (rows - 1.0)
                    off_px = x_px[q] - rest_px[s, row[q]] - (1.0 - at) * ends_px[s, 0] - at * ends_px[s, 1]
                    # something else has begun: the mean ends here
                    if abs(off_px) > _SEARCH * tolerance_px:
                        break
                    total += off_px
                    count += 1
                    m += 2 * side - 1
                if count >= _LEAST_ROWS:
                    told[p] = True
                    mean_px[p, side] = abs(total / count)
    # the better side: at an edge one side is belt, the other not
    least_px = np.minimum(mean_px[:, 0], mean_px[:, 1])
    asked = told & ((row < outer) | (row >= rows - outer))
    still_px = _STILL * tolerance_px
    if asked.any():
        # as far as means of belt are off in this image, but no farther than a single peak may be
        still_px = max(still_px, min(_SIGMAS * _MAD_TO_STD * median_of(least_px[asked]), tolerance_px))
    still = line.copy()
    for p in range(peaks):
        if told[p] and least_px[p] > still_px:
            still[p] = -1
    for t in range(start.shape[0] - 1):
        n = start[t]
        while n < start[t + 1]:
            s, begin = still[order[n]], n
            while n < start[t + 1] and still[order[n]] == s:
                n += 1
            # a short run amid a trace; long ones, and those at the trace's ends, are belt
            if s < 0 or n - begin >= _LEAST_ROWS or begin == start[t] or n == start[t + 1]:
                continue
            before, after = order[begin - 1], order[n]
            # the trace crosses the line: on one side before, on the other behind
            if (x_px[before] < rest_px[s, row[before]]) == (x_px[after] > rest_px[s, row[after]]):
                still[order[begin:n]] = -1
    return still


@kernel
def _offsets_at_ends(
    row: Integers, x_px: Floats, line: Integers, rest_px: Floats, offset_px: float, outer: int
) -> Floats:
    """Give (stripe, 2) how far its belt lies beside its line at the image's top and bottom, px."""
    stripes, rows = rest_px.shape
    # without enough peaks: what the whole image says
    found, count = np.full((stripes, 2), offset_px), np.zeros((stripes, 2), np.int64)
    off_px = np.empty((stripes, 2, 0))
    # counted first, then gathered
    for counts in (True, False):
        for p in range(row.size):
            s, side = line[p], 0 if row[p] < outer else 1
            if s < 0 or outer <= row[p] < rows - outer:
                continue
            if not counts:
                off_px[s, side, count[s, side]] = x_px[p] - rest_px[s, row[p]]
            count[s, side] += 1
        if counts:
            off_px = np.empty((stripes, 2, count.max() if count.size else 0))
            count[:] = 0
    for s in range(stripes):
        for side in range(2):
            if count[s, side] >= _END_PEAKS_MIN:
                found[s, side] = median_of(off_px[s, side, : count[s, side]])
    return found


@kernel
def _along(trace: Integers) -> tuple[Integers, Integers]:
    """Give (trace + 1,) where each trace begins among, and (peak,) the peaks, trace by trace."""
    traces = trace.max() + 1 if trace.shape[0] else 0
    start = np.zeros(traces + 1, np.int64)
    for p in range(trace.shape[0]):
        # counting sort by trace; peaks come by row and stay so
        start[trace[p] + 1] += 1
    start = np.cumsum(start)
    order, fill = np.empty(trace.shape[0], np.int64), start[:-1].copy()
    for p in range(trace.shape[0]):
        order[fill[trace[p]]] = p
        fill[trace[p]] += 1
    return start, order
