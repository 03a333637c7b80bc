"""Belt lies still on its rest line; a body that lies along another stripe's does so a little beside it."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.ranking import median_of

_ROWS = 12
"""Peaks before, or after, one that are asked for their mean."""
_LEAST_ROWS = 6
"""Of fewer the mean says too little."""
_END_PEAKS_MIN = 10
_STILL = 0.3
"""How far a mean may always be off, of what a single peak may be."""
_SIGMAS = 4.5
_SEARCH = 1.5
"""Peaks farther off than so many times what a single one may be are of something else."""
_MAD_TO_STD = 1.4826


@kernel
def lying_still(
    row: Integers, x_px: Floats, trace: Integers, line: Integers, rest_px: Floats, tolerance_px: float,
    offset_px: float, outer: int,
) -> Integers:  # fmt: skip
    """Give (peak,) the rest line that it lies on together with those before, or after, it in its trace.

    Single peaks scatter about the line by as much as a body may lie beside it; the mean of some rows does
    not. How far it may be off is what it is in the image's outer rows, where belt is expected; there, too, it
    is seen by how much the belt's stripes have moved from the calibrated lines.

    Parameters
    ----------
    row, x_px, trace
        (peak,) row, in increasing order; place, px; trace.
    line
        (peak,) rest line that a peak lies on by itself, −1 for none.
    rest_px, tolerance_px, offset_px
        See `roemetry_kernels.coding.rest_lines.RestLines`.
    outer
        Rows at the image's top, and bottom, where belt is expected.
    """
    peaks, rows = row.shape[0], rest_px.shape[1]
    ends_px = _ends(row, x_px, line, rest_px, offset_px, outer)
    start, order = _along(trace)
    mean_px = np.full((peaks, 2), np.inf)
    told = np.zeros(peaks, np.bool_)
    for t in range(start.shape[0] - 1):
        for n in range(start[t], start[t + 1]):
            p = order[n]
            s = line[p]
            if s < 0:
                continue
            for side in range(2):
                total, count, m = 0.0, 0, n
                while start[t] <= m < start[t + 1] and count < _ROWS:
                    q = order[m]
                    at = row[q] / (rows - 1.0)
                    off_px = x_px[q] - rest_px[s, row[q]] - (1.0 - at) * ends_px[s, 0] - at * ends_px[s, 1]
                    if abs(off_px) > _SEARCH * tolerance_px:
                        break
                    total += off_px
                    count += 1
                    m += 2 * side - 1
                if count >= _LEAST_ROWS:
                    told[p] = True
                    mean_px[p, side] = abs(total / count)
    least_px = np.minimum(mean_px[:, 0], mean_px[:, 1])
    asked = told & ((row < outer) | (row >= rows - outer))
    still_px = _STILL * tolerance_px
    if asked.any():
        still_px = max(still_px, min(_SIGMAS * _MAD_TO_STD * median_of(least_px[asked]), tolerance_px))
    still = line.copy()
    for p in range(peaks):
        if told[p] and least_px[p] > still_px:
            still[p] = -1
    return still


@kernel
def _ends(
    row: Integers, x_px: Floats, line: Integers, rest_px: Floats, offset_px: float, outer: int
) -> Floats:
    """Give (stripe, 2) how far its belt lies beside its line at the image's top and bottom, px."""
    stripes, rows = rest_px.shape
    found = np.full((stripes, 2), offset_px)
    for side in range(2):
        here = (row < outer) if side == 0 else (row >= rows - outer)
        for s in range(stripes):
            mine = np.flatnonzero(here & (line == s))
            if mine.size >= _END_PEAKS_MIN:
                off_px = np.empty(mine.size)
                for k in range(mine.size):
                    off_px[k] = x_px[mine[k]] - rest_px[s, row[mine[k]]]
                found[s, side] = median_of(off_px)
    return found


@kernel
def _along(trace: Integers) -> tuple[Integers, Integers]:
    """Give (trace + 1,) where each trace begins among, and (peak,) the peaks, trace by trace."""
    traces = trace.max() + 1 if trace.shape[0] else 0
    start = np.zeros(traces + 1, np.int64)
    for p in range(trace.shape[0]):
        start[trace[p] + 1] += 1
    start = np.cumsum(start)
    order, fill = np.empty(trace.shape[0], np.int64), start[:-1].copy()
    for p in range(trace.shape[0]):
        order[fill[trace[p]]] = p
        fill[trace[p]] += 1
    return start, order
