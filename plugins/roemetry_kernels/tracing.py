"""Tracing peaks from row to row into fragments."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats, Integers
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
    peaks = fragment.shape[0]
    length = np.zeros(fragments + 1, np.int64)
    for p in range(peaks):
        length[fragment[p] + 1] += 1
    start = np.cumsum(length)
    order = np.empty(peaks, np.int64)
    fill = start[:-1].copy()
    for p in range(peaks):
        order[fill[fragment[p]]] = p
        fill[fragment[p]] += 1
    segment = np.empty(peaks, np.int64)
    segment_line = np.empty(peaks, np.int64)
    count = 0
    for f in range(fragments):
        begin, end = start[f], start[f + 1]
        state = np.empty(end - begin, np.int64)
        for k in range(begin, end):
            state[k - begin] = line[order[k]]
        _close_flicker(state, flicker_rows)
        _drop_short(state, belt_rows_min)
        for k in range(end - begin):
            if k == 0 or state[k] != state[k - 1]:
                segment_line[count] = state[k]
                count += 1
            segment[order[begin + k]] = count - 1
    return segment, segment_line[:count].copy()


@kernel
def _nearest(x_px: Floats, begin: int, end: int, x: float) -> int:
    best, nearest = -1, np.inf
    for p in range(begin, end):
        off = abs(x_px[p] - x)
        if off < nearest:
            best, nearest = p, off
    return best


@kernel
def _close_flicker(state: Integers, flicker_rows: int) -> None:
    last = -1
    for k in range(state.shape[0]):
        if state[k] < 0:
            continue
        if last >= 0 and state[last] == state[k] and k - last - 1 <= flicker_rows:
            for between in range(last + 1, k):
                state[between] = state[k]
        last = k


@kernel
def _drop_short(state: Integers, belt_rows_min: int) -> None:
    begin = 0
    for k in range(1, state.shape[0] + 1):
        if k == state.shape[0] or state[k] != state[begin]:
            if k - begin < belt_rows_min:
                for short in range(begin, k):
                    state[short] = -1
            begin = k
