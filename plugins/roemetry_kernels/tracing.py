"""Tracing peaks from row to row into fragments.

It assumes that a stripe moves from row to row by less than its distance from the next one. It fails where it
moves farther: it is cut there, or goes on as the other if each is nearest to the other.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel


@kernel
def trace_fragments(row_start: Integers, x_px: Floats, step_max_px: float) -> tuple[Integers, int]:
    """Join each peak to the nearest one of the next row, where that is mutual and near enough.

    Parameters
    ----------
    row_start
        (row + 1,) where each row's peaks begin.
    x_px
        (peak,) sorted by row, then x, px.
    step_max_px
        Largest step between rows, of positions rounded to whole pixels, px.

    Returns
    -------
    tuple
        (peak,) number of the fragment each peak belongs to, and the number of fragments. A fragment has
        one peak in each of consecutive rows.
    """
    peaks = x_px.shape[0]
    fragment = np.full(peaks, -1, np.int64)
    count = 0
    for row in range(row_start.shape[0] - 1):
        begin, end = row_start[row], row_start[row + 1]
        # what goes on with nothing begins a fragment
        for p in range(begin, end):
            if fragment[p] < 0:
                fragment[p] = count
                count += 1
        if row + 2 >= row_start.shape[0]:
            break
        next_end = row_start[row + 2]
        for p in range(begin, end):
            q = _nearest(x_px, end, next_end, x_px[p])
            if q < 0 or abs(np.rint(x_px[q]) - np.rint(x_px[p])) > step_max_px:
                continue
            # only where each is the other's nearest
            if _nearest(x_px, begin, end, x_px[q]) == p:
                fragment[q] = fragment[p]
    return fragment, count


@kernel
def nearest_rest(
    row: Integers, x_px: Floats, rest_px: Floats, tolerance_px: float
) -> tuple[Integers, Floats]:
    """Find the rest line each peak lies on.

    Parameters
    ----------
    row, x_px
        (peak,) place of the peaks, px.
    rest_px
        (stripe, row) rest lines, px, in increasing order of x in each row.
    tolerance_px
        How far from a rest line a peak may be to lie on it, px.

    Returns
    -------
    tuple
        (peak,) index of the nearest rest line if the peak lies on it, else −1; and the signed distance
        from the nearest rest line, px.
    """
    stripes = rest_px.shape[0]
    line = np.full(x_px.shape[0], -1, np.int64)
    distance = np.full(x_px.shape[0], np.nan)
    before, nearest, all_known = -1, 0, True
    for p in range(x_px.shape[0]):
        r = row[p]
        if r != before:
            before, nearest, all_known = r, 0, True
            for stripe in range(stripes):
                all_known &= not np.isnan(rest_px[stripe, r])
        if not all_known or x_px[p] < x_px[max(p - 1, 0)]:
            nearest = 0
        best = x_px[p] - rest_px[nearest, r]
        best = np.inf if np.isnan(best) else best
        # Where every line is known their distances fall and then rise: peaks to the right go on from there.
        for stripe in range(nearest + 1, stripes):
            off = x_px[p] - rest_px[stripe, r]
            if abs(off) < abs(best):
                best, nearest = off, stripe
            elif all_known:
                break
        distance[p] = best
        if abs(best) <= tolerance_px:
            line[p] = nearest
    return line, distance


@kernel
def cut_at_rest_lines(
    fragment: Integers, line: Integers, fragments: int, belt_rows_min: int, flicker_rows: int
) -> tuple[Integers, Integers]:
    """Cut fragments where they join or leave a rest line.

    Runs on a rest line shorter than `belt_rows_min` are taken as no run (a stripe crossing a line); gaps in
    a run up to `flicker_rows` are closed (noise).

    Parameters
    ----------
    fragment
        (peak,) fragment of each peak, peaks sorted by row.
    line
        (peak,) rest line each peak lies on, −1 for none.
    fragments
        Number of fragments.
    belt_rows_min, flicker_rows
        See above, rows.

    Returns
    -------
    tuple
        (peak,) segment of each peak; (segment,) rest line it lies on, −1 for none.
    """
    segment, segment_line, _, _ = cut_in_order(fragment, line, fragments, belt_rows_min, flicker_rows)
    return segment, segment_line


@kernel
def cut_in_order(
    fragment: Integers, line: Integers, fragments: int, belt_rows_min: int, flicker_rows: int
) -> tuple[Integers, Integers, Integers, Integers]:
    """Cut as `cut_at_rest_lines`, and give the peaks segment by segment, too.

    Gives (peak,) segment; (segment,) rest line; (peak,) peaks, sorted by segment, then row; and
    (segment + 1,) where each segment begins among those.
    """
    peaks = fragment.shape[0]
    length = np.zeros(fragments + 1, np.int64)
    for p in range(peaks):
        length[fragment[p] + 1] += 1
    # sorted by fragment, by counting
    start = np.cumsum(length)
    order, state = np.empty(peaks, np.int64), np.empty(peaks, np.int64)
    fill = start[:-1].copy()
    for p in range(peaks):
        at = fill[fragment[p]]
        order[at], state[at] = p, line[p]
        fill[fragment[p]] = at + 1
    segment = np.empty(peaks, np.int64)
    segment_line, segment_start = np.empty(peaks, np.int64), np.empty(peaks + 1, np.int64)
    run_line, run_start = np.empty(peaks, np.int64), np.empty(peaks + 1, np.int64)
    count = 0
    for f in range(fragments):
        first = count
        runs = _runs(state, start[f], start[f + 1], flicker_rows, run_line, run_start)
        for k in range(runs):
            # a run that is too short is on no line
            own = run_line[k] if run_start[k + 1] - run_start[k] >= belt_rows_min else -1
            if count == first or own != segment_line[count - 1]:
                segment_line[count], segment_start[count] = own, run_start[k]
                count += 1
            for at in range(run_start[k], run_start[k + 1]):
                segment[order[at]] = count - 1
    segment_start[count] = peaks
    return segment, segment_line[:count].copy(), order, segment_start[: count + 1].copy()


@kernel
def _runs(
    state: Integers, begin: int, end: int, flicker_rows: int, run_line: Integers, run_start: Integers
) -> int:
    """Write line and start of each run of one line, and the last one's end; gives the number of runs.

    What is on no line for a few rows between two runs of one line belongs to them.
    """
    count = 0
    for k in range(begin, end):
        if k > begin and state[k] == state[k - 1]:
            continue
        # back on the same line after a few rows
        again = count > 1 and run_line[count - 1] == -1 and run_line[count - 2] == state[k]
        if again and k - run_start[count - 1] <= flicker_rows:
            count -= 1
            continue
        run_line[count], run_start[count] = state[k], k
        count += 1
    run_start[count] = end
    return count


@kernel
def _nearest(x_px: Floats, begin: int, end: int, x: float) -> int:
    best, nearest = -1, np.inf
    for p in range(begin, end):
        off = abs(x_px[p] - x)
        if off < nearest:
            best, nearest = p, off
    return best
