"""Runs of peaks that are one stripe, and what it costs to move several of them to the next stripe at once.

On a solved frame, entries of one trace with the same stripe make a run. What two runs cost each other, as
neighbours on sight lines or one behind the other along a trace, depends on their two stripes only. So the
whole frame is a small graph of runs, on which the cost of any change is exact. The change that is easily
mistaken for the truth is a shift of several runs by one stripe; a run is sure only as far as every such
shift that it is part of is dear.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.coding.label_strays import eased
from roemetry_kernels.compiling import kernel

_ASIDE = 1
"""Stripes on either side of its own that a run may move to."""
_WAYS = 2 * _ASIDE + 1
_OUT = _WAYS
"""What follows the ways of being a stripe: none of it."""
OUT = 1000
"""So many stripes on: left out."""
_SMALL_ENTRIES = 4
_END_ENTRIES = 12
"""A run with so few is left out before all behind it give way: to solve, and to ask what is sure."""
_DISORDER = 40.0
"""Cost of two neighbours out of order: more than to leave both out."""
_IMPOSSIBLE = 20.0
"""Cost of a stripe that an entry cannot be, and of neighbours too far apart to be compared."""


class Runs(NamedTuple):
    """Runs and their costs.

    Attributes
    ----------
    of
        (entry,) run, −1 where the entry is no stripe.
    stripe
        (run,) its stripe.
    own
        (run, way) cost by itself, for its stripe and the ones beside it, and for none of it.
    one, other
        (edge,) two runs that touch, the one to the left or above first.
    both
        (edge, way, way) what they cost each other.
    disorder
        (edge, way, way) number of sight lines on which that puts neighbours out of order.
    start, edge
        (run + 1,) where a run's edges begin; edges, run by run.
    first, last
        (run,) sight lines on which it begins and ends.
    size
        (run,) number of entries.
    """

    of: Integers
    stripe: Integers
    own: Floats
    one: Integers
    other: Integers
    both: Floats
    disorder: Integers
    start: Integers
    edge: Integers
    first: Integers
    last: Integers
    size: Integers


@kernel
def runs_of(
    start: Integers, peak: Integers, before_entry: Integers, tie: Floats, low: Integers, count: Integers,
    offset: Integers, piece: Integers, best: Integers, own: Floats, pair: Integers, pair_start: Integers,
    surface: NDArray[np.float32], unseen: NDArray[np.float32], before: Floats, after: Floats,
    weight_surface: float, weight_unseen: float,
) -> tuple[
    Integers, Integers, Floats, Integers, Integers, Floats, Integers, Integers, Integers, Integers, Integers,
    Integers,
]:  # fmt: skip
    """Make the fields of `Runs` of a solution.

    Parameters
    ----------
    start, peak, before_entry, tie
        See `roemetry_kernels.coding.sight_entries.Entries`.
    low, count, offset
        See `roemetry_kernels.coding.label_costs.Labels`.
    piece
        (peak,) piece of its trace: a run does not go on from piece to piece.
    best
        (entry,) chosen node.
    own
        (node,) cost of a node by itself.
    pair, pair_start, surface, unseen, before, after
        See `roemetry_kernels.coding.label_costs.Steps`.
    weight_surface, weight_unseen
        See `roemetry_kernels.coding.label_sweeps.swept`.
    """
    of, stripe = _runs(peak, before_entry, low, count, offset, piece, best)
    runs, lines = stripe.shape[0], start.shape[0] - 1
    alone = np.zeros((runs, _WAYS + 1))
    first, last_line = np.full(runs, lines, np.int64), np.full(runs, -1, np.int64)
    size = np.zeros(runs, np.int64)
    key = np.empty(2 * of.shape[0], np.int64)
    keys = 0
    for e in range(lines):
        last = -1
        for p in range(start[e], start[e + 1]):
            f, q = of[p], before_entry[p]
            if f < 0:
                continue
            first[f], last_line[f] = min(first[f], e), max(last_line[f], e)
            alone[f, _OUT] += own[offset[p + 1] - 1]
            size[f] += 1
            if q >= 0 and of[q] >= 0 and of[q] != f:
                key[keys] = of[q] * runs + f
                keys += 1
            if last >= 0 and of[last] != f:
                key[keys] = of[last] * runs + f
                keys += 1
            last = p
    key = np.unique(key[:keys])
    both = np.zeros((key.shape[0], _WAYS + 1, _WAYS + 1))
    disorder = np.zeros(both.shape, np.int64)
    for e in range(lines):
        last, n = -1, pair_start[e]
        for p in range(start[e], start[e + 1]):
            f, q = of[p], before_entry[p]
            if f < 0:
                continue
            for a in range(_WAYS):
                k = stripe[f] + a - _ASIDE - low[p]
                if 0 <= k < count[p]:
                    alone[f, a] += own[offset[p] + k]
                    if last < 0:
                        alone[f, a] += weight_unseen * before[offset[p] + k]
                else:
                    alone[f, a] += _IMPOSSIBLE
            if q >= 0 and of[q] >= 0 and of[q] != f:
                t = np.searchsorted(key, of[q] * runs + f)
                for a in range(_WAYS):
                    for b in range(_WAYS):
                        if stripe[of[q]] + a != stripe[f] + b:
                            both[t, a, b] += tie[p]
            if last >= 0 and of[last] != f:
                while n < pair_start[e + 1] and (pair[n, 1] < p or (pair[n, 1] == p and pair[n, 0] < last)):
                    n += 1
                near = n < pair_start[e + 1] and pair[n, 1] == p and pair[n, 0] == last
                t = np.searchsorted(key, of[last] * runs + f)
                for a in range(_WAYS):
                    h = stripe[of[last]] + a - _ASIDE - low[last]
                    for b in range(_WAYS):
                        k = stripe[f] + b - _ASIDE - low[p]
                        if stripe[of[last]] + a >= stripe[f] + b:
                            both[t, a, b] += _DISORDER
                            disorder[t, a, b] += 1
                        elif not near:
                            both[t, a, b] += _IMPOSSIBLE
                        elif 0 <= k < count[p] and 0 <= h < count[last]:
                            c = pair[n, 2] + k * count[last] + h
                            step = weight_surface * surface[c] + weight_unseen * unseen[c]
                            both[t, a, b] += min(step, _IMPOSSIBLE)
            last = p
        if last >= 0:
            for a in range(_WAYS):
                k = stripe[of[last]] + a - _ASIDE - low[last]
                if 0 <= k < count[last]:
                    alone[of[last], a] += weight_unseen * after[offset[last] + k]
    one, other = key // runs, key % runs
    edge_start, edge = _edges(runs, one, other)
    return of, stripe, alone, one, other, both, disorder, edge_start, edge, first, last_line, size


@kernel
def _runs(
    peak: Integers, before_entry: Integers, low: Integers, count: Integers, offset: Integers, piece: Integers,
    best: Integers,
) -> tuple[Integers, Integers]:  # fmt: skip
    of = np.full(peak.shape[0], -1, np.int64)
    stripe = np.empty(peak.shape[0], np.int64)
    runs = 0
    for i in range(peak.shape[0]):
        k = best[i] - offset[i]
        if k >= count[i]:
            continue
        q = before_entry[i]
        if q >= 0 and of[q] >= 0 and piece[peak[q]] == piece[peak[i]] and stripe[of[q]] == low[i] + k:
            of[i] = of[q]
        else:
            of[i], stripe[runs] = runs, low[i] + k
            runs += 1
    return of, stripe[:runs].copy()


@kernel
def _edges(runs: int, one: Integers, other: Integers) -> tuple[Integers, Integers]:
    start = np.zeros(runs + 1, np.int64)
    for t in range(one.shape[0]):
        start[one[t] + 1] += 1
        start[other[t] + 1] += 1
    start = np.cumsum(start)
    fill = start[:-1].copy()
    edge = np.empty(2 * one.shape[0], np.int64)
    for t in range(one.shape[0]):
        for f in (one[t], other[t]):
            edge[fill[f]] = t
            fill[f] += 1
    return start, edge


@kernel
def shifts_of(
    own: Floats, one: Integers, other: Integers, both: Floats, disorder: Integers, start: Integers,
    edge: Integers, first: Integers, last: Integers, size: Integers, stray: Flags, lines: int,
    gain_min: float,
) -> tuple[Floats, Integers]:  # fmt: skip
    """Shift every run by one stripe either way, with all that must, or had better, go along.

    Parameters
    ----------
    own, one, other, both, disorder, start, edge, first, last, size
        See `Runs`.
    stray
        (run,) True for what may be left out when it is asked what is sure.
    lines
        Number of sight lines.
    gain_min
        A shift that is cheaper by this much or more is made.

    Returns
    -------
    tuple
        (run,) cost of the cheapest shift that it is part of, over the sight lines that are touched; and
        (run,) how far it is shifted by those that are cheaper, taken together; `OUT` where it is left out.
    """
    runs = own.shape[0]
    dearer = np.full(runs, np.inf)
    cost = np.full((runs, 2), np.inf)
    way, waiting = np.empty(runs, np.int64), np.empty(runs, np.int64)
    queued = np.zeros(runs, np.bool_)
    cheap, much = eased(both, disorder, _DISORDER)
    touched = np.zeros(lines + 1, np.int64)
    for f in range(runs):
        for k in range(2):
            way[:] = _ASIDE
            cost[f, k] = _shift(
                f, 2 * k - 1, _END_ENTRIES, way, own, one, other, cheap, much, start, edge, size, stray,
                waiting, queued,
            )  # fmt: skip
            low, high = lines, 0
            for g in range(runs):
                if way[g] != _ASIDE:
                    touched[first[g]] += 1
                    touched[last[g] + 1] -= 1
                    low, high = min(low, first[g]), max(high, last[g])
            inside, wide = 0, 0
            for e in range(low, high + 2):
                inside += touched[e]
                wide += inside > 0
                touched[e] = 0
            for g in range(runs):
                if way[g] != _ASIDE:
                    dearer[g] = min(dearer[g], cost[f, k] / wide)
    way[:] = _ASIDE
    none = np.zeros(runs, np.bool_)
    for n in np.argsort(cost.ravel()):
        f, k = n // 2, n % 2
        if cost[f, k] > -gain_min:
            break
        if way[f] == _ASIDE:
            tried = way.copy()
            again = _shift(
                f, 2 * k - 1, _SMALL_ENTRIES, tried, own, one, other, both, disorder, start, edge, size, none,
                waiting, queued,
            )  # fmt: skip
            if again <= -gain_min:
                way = tried
    for f in range(runs):
        way[f] = OUT if way[f] == _OUT else way[f] - _ASIDE
    return dearer, way


@kernel
def _shift(
    f: int, by: int, small: int, way: Integers, own: Floats, one: Integers, other: Integers, both: Floats,
    disorder: Integers, start: Integers, edge: Integers, size: Integers, stray: Flags, waiting: Integers,
    queued: Flags,
) -> float:  # fmt: skip
    """Shift run f; then others the same way, as long as order asks for it or it is cheaper; give the cost.

    Runs of up to `small` entries that would have to give way are left out, where that is cheaper.
    """
    cost = _change(f, way[f] + by, way, own, one, other, both, start, edge)
    way[f] += by
    more = _ask(f, way, one, other, start, edge, waiting, queued, 0)
    while more > 0:
        more -= 1
        g = waiting[more]
        queued[g] = False
        forced = False
        for n in range(start[g], start[g + 1]):
            forced = forced or disorder[edge[n], way[one[edge[n]]], way[other[edge[n]]]] > 0
        to = way[g] + by
        change = _change(g, to, way, own, one, other, both, start, edge)
        if forced and (size[g] <= small or stray[g]):
            left_out = _change(g, _OUT, way, own, one, other, both, start, edge)
            if left_out < change:
                to, change = _OUT, left_out
        if forced or change < 0.0:
            cost += change
            way[g] = to
            more = _ask(g, way, one, other, start, edge, waiting, queued, more)
    return cost


@kernel
def _ask(
    f: int, way: Integers, one: Integers, other: Integers, start: Integers, edge: Integers, waiting: Integers,
    queued: Flags, size: int,
) -> int:  # fmt: skip
    """Put the runs beside one that was shifted on the waiting list; give its new length."""
    for n in range(start[f], start[f + 1]):
        g = other[edge[n]] if one[edge[n]] == f else one[edge[n]]
        if way[g] == _ASIDE and not queued[g]:
            waiting[size], queued[g] = g, True
            size += 1
    return size


@kernel
def _change(
    f: int, now: int, way: Integers, own: Floats, one: Integers, other: Integers, both: Floats,
    start: Integers, edge: Integers,
) -> float:  # fmt: skip
    """What it costs to change one more run."""
    was = way[f]
    cost = own[f, now] - own[f, was]
    for n in range(start[f], start[f + 1]):
        t = edge[n]
        if one[t] == f:
            cost += both[t, now, way[other[t]]] - both[t, was, way[other[t]]]
        else:
            cost += both[t, way[one[t]], now] - both[t, way[one[t]], was]
    return float(cost)
