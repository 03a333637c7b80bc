"""Belt that may as well be the level top of a body one label height high."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_LOOK_BACK = 4
_BROKEN = 20.0
_HIGH_SHARE = 0.5
"""A body that is taken into account is at least this share of a label height high."""
_SIDE_PEAKS_MIN = 6
_SAME_STDS = 3.0
_MAD_TO_STD = 1.4826


@kernel
def level_instead(
    start: Integers, peak: Integers, low: Integers, count: Integers, offset: Integers, height: Floats,
    label_mm: Floats, best: Integers, on_line: Integers, pair: Integers, pair_start: Integers,
    surface: NDArray[np.float32], unseen: NDArray[np.float32], before: Floats, after: Floats,
    weight_surface: float, weight_unseen: float, there: Floats, dearer_max: float, peaks: int,
) -> Flags:  # fmt: skip
    """Mark (peak,) belt, and what goes on from it, that could be a body's, one stripe on, hardly dearer.

    Where a stripe is not seen beside a body, the next ones, one or several, are taken for the neighbours'
    stripes on a level body: the stripe that is not seen is then on its other side. Some of them lie on their
    rest lines, the others may be bodies already.

    Parameters
    ----------
    start, peak
        See `roemetry_kernels.coding.sight_entries.Entries`.
    low, count, offset, height, label_mm
        See `roemetry_kernels.coding.label_costs.Labels`.
    best
        (entry,) chosen node.
    on_line
        (peak,) rest line a peak lies on, −1 for none.
    pair, pair_start, surface, unseen, before, after
        See `roemetry_kernels.coding.label_costs.Steps`.
    weight_surface, weight_unseen
        See `roemetry_kernels.coding.label_sweeps.swept`.
    there
        (stripe,) how surely a stripe is there at all: what gives no light is no stripe that is not seen.
    dearer_max
        Cost, a sight line, up to which the other way of seeing it counts.
    peaks
        Number of peaks.
    """
    found = np.zeros(peaks, np.bool_)
    kept = np.empty(peak.shape[0], np.int64)
    stripe = np.empty(peak.shape[0], np.int64)
    for e in range(start.shape[0] - 1):
        size = 0
        for i in range(start[e], start[e + 1]):
            k = best[i] - offset[i]
            if k < count[i]:
                kept[size], stripe[size] = i, low[i] + k
                size += 1
        for by in (-1, 1):
            for n in range(size):
                j = n + by  # on the side that the stripes would move to, and off the belt
                if not 0 <= j < size or (stripe[n] - stripe[j]) * -by < 2:
                    continue
                if on_line[peak[kept[j]]] == stripe[j] or not _any_there(there, stripe[n], stripe[j]):
                    continue
                for to in range(by, stripe[j] - stripe[n], by):
                    cost, m, belts = 0.0, n, 0
                    while True:
                        p = kept[m]
                        belts += on_line[peak[p]] == stripe[m]
                        k = stripe[m] + to - low[p]
                        if k < 0 or k >= count[p]:
                            break
                        node = offset[p] + k
                        if height[node] < _HIGH_SHARE * label_mm[node]:
                            break
                        i = m - by  # the next stripe on the other side
                        cost += _side(
                            m, m + by, to, to if m != n else 0, kept, stripe, size, start[e], low, count,
                            offset, pair, pair_start[e], surface, unseen, before, after, weight_surface,
                            weight_unseen,
                        )  # fmt: skip
                        ended = cost + _side(
                            m, i, to, 0, kept, stripe, size, start[e], low, count, offset, pair,
                            pair_start[e], surface, unseen, before, after, weight_surface, weight_unseen,
                        )  # fmt: skip
                        if belts > 0 and ended < dearer_max:
                            for t in range(min(m, n), max(m, n) + 1):
                                found[peak[kept[t]]] = True
                        if not 0 <= i < size or (stripe[i] - stripe[m]) * -by != 1:
                            break
                        m = i
    return found


def goes_through(piece: Integers, off_px: Floats, found: Flags) -> Flags:
    """Mark (peak,) what was found on pieces that lie before it, in it and after it at the same place.

    A body would have to be exactly one label height high to show nothing where it begins and ends.

    Parameters
    ----------
    piece
        (peak,) piece of its trace.
    off_px
        (peak,) way from its rest line, px.
    found
        (peak,) what `level_instead` says, in the order of rows.
    """
    through = np.zeros(found.shape, np.bool_)
    for one in np.unique(piece[found]):
        members = np.flatnonzero(piece == one)
        inside = found[members]
        first, last = np.flatnonzero(inside)[[0, -1]]
        if min(first, members.size - 1 - last) < _SIDE_PEAKS_MIN:
            continue
        off, sides = off_px[members], np.arange(members.size)
        sides = (sides < first) | (sides > last)
        there, beside = off[inside], off[sides]
        spread = [_MAD_TO_STD * np.median(np.abs(part - np.median(part))) for part in (there, beside)]
        std = np.sqrt(spread[0] ** 2 / there.size + spread[1] ** 2 / beside.size)
        through[members] = abs(np.median(there) - np.median(beside)) <= _SAME_STDS * std
    return through & found


@kernel
def _any_there(there: Floats, one: int, other: int) -> bool:
    """Say whether light of any stripe between two is there at all."""
    return bool((there[min(one, other) + 1 : max(one, other)] > 0.0).any())


@kernel
def on_end(row: Integers, piece: Integers, found: Flags, rows_min: int, rows_between: int) -> Flags:
    """Mark (peak,) what was found on so many rows of its piece on end.

    Parameters
    ----------
    row, piece
        (peak,) row, in increasing order; piece of its trace.
    found
        (peak,) what is asked.
    rows_min
        Fewer rows are as many as a break along a stripe may have.
    rows_between
        So many rows between may be missing.
    """
    last = np.full(piece.max() + 1, -(rows_between + 2), np.int64)
    run_of = np.full(piece.max() + 1, -1, np.int64)
    run, first = np.full(row.shape[0], -1, np.int64), np.empty(row.shape[0], np.int64)
    length = np.zeros(row.shape[0], np.int64)
    runs = 0
    for p in range(row.shape[0]):
        f = piece[p]
        if not found[p]:
            continue
        if row[p] - last[f] > rows_between + 1:
            run_of[f], first[runs] = runs, row[p]
            runs += 1
        run[p], last[f] = run_of[f], row[p]
        length[run[p]] = row[p] - first[run[p]] + 1
    kept = np.zeros(row.shape[0], np.bool_)
    for p in range(row.shape[0]):
        kept[p] = run[p] >= 0 and length[run[p]] >= rows_min
    return kept


@kernel
def _side(
    m: int, j: int, to: int, to_other: int, kept: Integers, stripe: Integers, size: int, first: int,
    low: Integers, count: Integers, offset: Integers, pair: Integers, pair_first: int,
    surface: NDArray[np.float32], unseen: NDArray[np.float32], before: Floats, after: Floats,
    weight_surface: float, weight_unseen: float,
) -> float:  # fmt: skip
    """What it changes, towards neighbour j or the image's border there, that m is moved to another stripe."""
    p = kept[m]
    k = stripe[m] - low[p]
    if j < 0:
        return weight_unseen * (before[offset[p] + k + to] - before[offset[p] + k])
    if j >= size:
        return weight_unseen * (after[offset[p] + k + to] - after[offset[p] + k])
    h = stripe[j] - low[kept[j]]
    if j < m:
        was = _pair(kept[j], p, h, k, first, count, pair, pair_first, surface, unseen, weight_surface,
                    weight_unseen)  # fmt: skip
        now = _pair(kept[j], p, h + to_other, k + to, first, count, pair, pair_first, surface, unseen,
                    weight_surface, weight_unseen)  # fmt: skip
    else:
        was = _pair(p, kept[j], k, h, first, count, pair, pair_first, surface, unseen, weight_surface,
                    weight_unseen)  # fmt: skip
        now = _pair(p, kept[j], k + to, h + to_other, first, count, pair, pair_first, surface, unseen,
                    weight_surface, weight_unseen)  # fmt: skip
    return now - was


@kernel
def _pair(
    q: int, p: int, h: int, k: int, first: int, count: Integers, pair: Integers, pair_first: int,
    surface: NDArray[np.float32], unseen: NDArray[np.float32], weight_surface: float, weight_unseen: float,
) -> float:  # fmt: skip
    """Cost of two neighbours, of their hth and kth possible stripe."""
    if p - q > _LOOK_BACK:
        return _BROKEN
    n, at = pair_first, p - first
    whole = min(at, _LOOK_BACK)
    n += whole * (whole - 1) // 2 + max(at - _LOOK_BACK, 0) * _LOOK_BACK
    n += q - max(first, p - _LOOK_BACK)
    c = pair[n, 2] + k * count[q] + h
    return min(weight_surface * surface[c] + weight_unseen * unseen[c], _BROKEN)
