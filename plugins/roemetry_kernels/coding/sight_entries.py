"""Traces as they cross the sight lines: one entry on each line, tied to the next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_TIE_LOOSE = 1.8
"""What even two ends that hardly point at each other are tied by."""


class Entries(NamedTuple):
    """Peaks as they stand on the sight lines: a trace has one entry on each line it crosses.

    Attributes
    ----------
    start
        (line + 1,) where each line's entries begin; they are sorted by u.
    peak, u
        (entry,) the peak, and its place on the line.
    before, after
        (entry,) the entry of the same trace on the line before and after, −1 for none.
    tie
        (entry,) what it costs to have another stripe than the entry before.
    """

    start: Integers
    peak: Integers
    u: Floats
    before: Integers
    after: Integers
    tie: Floats


@kernel
def entries_of(
    row: Integers, trace: Integers, piece: Integers, loose: Flags, line: Floats, u: Floats, lines: int,
    u_per_px: float,
    tie_whole: float, tie_cut: float, tie_gap: float, gap_lines: int,
) -> tuple[Integers, Integers, Floats, Integers, Integers, Floats]:  # fmt: skip
    """Put every trace once on each line that it crosses, and tie it to itself across lines.

    Parameters
    ----------
    row, trace, piece
        (peak,) row; trace; and which piece of the trace between cuts.
    loose
        (peak,) True where a piece may change its stripe from row to row.
    line, u
        (peak,) see `roemetry_kernels.coding.sight_lines`.
    lines
        Number of lines.
    u_per_px
        Change of u for a pixel.
    tie_whole, tie_cut, tie_gap
        Cost of a change of stripe within a piece, at a cut, and over a gap.
    gap_lines
        Longest gap that is tied over, lines.

    Returns
    -------
    tuple
        The fields of `Entries`.
    """
    peaks = row.shape[0]
    before, after = _neighbours(trace)
    # each peak answers for the lines nearer to it than to its trace's neighbours
    low = np.empty(peaks, np.int64)
    high = np.empty(peaks, np.int64)
    count = np.zeros(lines + 1, np.int64)
    for p in range(peaks):
        a = line[p] - 0.5 if before[p] < 0 else 0.5 * (line[p] + line[before[p]])
        b = line[p] + 0.5 if after[p] < 0 else 0.5 * (line[p] + line[after[p]])
        if (before[p] >= 0 and line[before[p]] > line[p]) or (after[p] >= 0 and line[after[p]] < line[p]):
            a = line[p] + 0.5 if before[p] < 0 else a
            b = line[p] - 0.5 if after[p] < 0 else b
        if a > b:
            a, b = b, a
        low[p] = max(0, int(np.ceil(a)))
        high[p] = min(lines - 1, int(np.ceil(b)) - 1)
        for e in range(low[p], high[p] + 1):
            count[e + 1] += 1
    start = np.cumsum(count)
    size = start[-1]
    peak = np.empty(size, np.int64)
    place = np.empty(size)
    fill = start[:-1].copy()
    for p in range(peaks):
        for e in range(low[p], high[p] + 1):
            k = fill[e]
            while k > start[e] and place[k - 1] > u[p]:
                place[k], peak[k] = place[k - 1], peak[k - 1]
                k -= 1
            place[k], peak[k] = u[p], p
            fill[e] += 1
    up, down, tie = _tied(
        start, peak, place, trace, piece, loose, u_per_px, tie_whole, tie_cut, tie_gap, gap_lines
    )
    return start, peak, place, up, down, tie


@kernel
def _neighbours(trace: Integers) -> tuple[Integers, Integers]:
    peaks = trace.shape[0]
    last = np.full(peaks + 1, -1, np.int64)
    before = np.full(peaks, -1, np.int64)
    after = np.full(peaks, -1, np.int64)
    for p in range(peaks):
        q = last[trace[p]]
        before[p] = q
        if q >= 0:
            after[q] = p
        last[trace[p]] = p
    return before, after


@kernel
def _tied(
    start: Integers, peak: Integers, place: Floats, trace: Integers, piece: Integers, loose: Flags,
    u_per_px: float, tie_whole: float, tie_cut: float, tie_gap: float, gap_lines: int,
) -> tuple[Integers, Integers, Floats]:  # fmt: skip
    size = peak.shape[0]
    up = np.full(size, -1, np.int64)
    down = np.full(size, -1, np.int64)
    tie = np.zeros(size)
    last = np.full(trace.shape[0] + 1, -1, np.int64)
    line_of = np.empty(size, np.int64)
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            line_of[i] = e
            j = last[trace[peak[i]]]
            if j >= 0 and line_of[j] == e - 1 and down[j] < 0:
                up[i], down[j] = j, i
                whole = piece[peak[i]] == piece[peak[j]] and not loose[peak[i]]
                tie[i] = tie_whole if whole else tie_cut
            last[trace[peak[i]]] = i
    # over gaps: from a beginning back to the end that points at it best
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            if up[i] >= 0:
                continue
            best, found = 1.0, -1
            for back in range(1, gap_lines + 1):
                if e - back < 0:
                    break
                for j in range(start[e - back], start[e - back + 1]):
                    if down[j] >= 0 or trace[peak[j]] == trace[peak[i]]:
                        continue
                    slope = 0.5 * (_slope(j, up, place, -1) + _slope(i, down, place, 1))
                    off = abs(place[j] + slope * back - place[i]) / u_per_px
                    if off / (1.5 + 0.25 * back) < best:
                        best, found = off / (1.5 + 0.25 * back), j
                if found >= 0:
                    break
            if found >= 0:
                up[i], down[found] = found, i
                tie[i] = _TIE_LOOSE + tie_gap * (1.0 - best)
    return up, down, tie


@kernel
def _slope(i: int, to: Integers, place: Floats, sign: int) -> float:
    """Change of u from line to line near an end, over up to six lines."""
    k, steps = i, 0
    while steps < 6 and to[k] >= 0:
        k = to[k]
        steps += 1
    return 0.0 if steps == 0 else sign * (place[k] - place[i]) / steps
