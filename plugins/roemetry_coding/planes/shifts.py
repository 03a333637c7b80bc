"""Runs of peaks that are one stripe, and what it costs to move several of them to the next stripe at once.

Model. On a solved frame, entries of one piece with the same stripe make a run. What two runs cost each other,
as neighbours on epipolar lines or one behind the other along a trace, depends on their two stripes only. So
the whole frame is a small graph of runs, on which the energy of any change is exact:

    E(w) = Σ_f own_f(w_f) + Σ_(f, g touch) both_fg(w_f, w_g),   w_f: stripe − 1, 0, + 1, or none.

Two kinds of change are tried. (1) Single runs, the one first that gains most: what one run has wrong is put
right there. (2) Where no single run gains, each in turn with all those that order forces to go along, or that
had better; runs too small to count give way instead.

The cost of change (2), over the number of lines that it touches, is the evidence of every run that it moves:
the truth, if it is not the labels at hand, is most often these labels with one group shifted by one stripe.
A run is sure only as far as every such shift that it is part of is dear.

Fails where the truth differs by two stripes or by several independent shifts: the evidence is then too large.
Of whole bodies `whole_bodies` asks that.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_coding.planes.graph import Candidates, PairCosts, Weights
from roemetry_coding.planes.lines import OVERLAP_ROWS, Entries
from roemetry_kernels.compiling import kernel

_ASIDE = 1
"""Stripes on either side of its own that a run may move to: more would square the costs of a pair."""
_WAYS = 2 * _ASIDE + 1
_OUT = _WAYS
"""What follows the ways of being a stripe: none of it."""
OUT = 1000
"""So many stripes on: left out."""
_SMALL_COST = 72.0
"""A run that costs no more to leave out is left out before all behind it give way: twelve false peaks as
bright as those beside them, or more that are faint."""
DISORDER = 8.0
"""Cost of two neighbours out of order on a line: that of leaving one of them out there, as a false peak. What
lies beyond a body's edge by the light's spread is in the trace of what it spread from."""
IMPOSSIBLE = 20.0
"""Cost of a stripe that an entry cannot be, and of neighbours too far apart to be compared."""
_GAIN_MIN = 0.5
"""A shift is made where it lowers the energy by so much: less is no difference."""
_SHIFTS_MAX = 24
"""Shifts that are tried before it is given up; a few are usual."""


class Runs(NamedTuple):
    """Runs and their costs."""

    of: Integers
    """(entry,) run, −1 where the entry is no stripe."""
    stripe: Integers
    """(run,) its stripe."""
    own: Floats
    """(run, way) cost by itself, for its stripe and the ones beside it, and for none of it."""
    one: Integers
    other: Integers
    """one, other: (edge,) two runs that touch, the one to the left or above first."""
    both: Floats
    """(edge, way, way) what they cost each other."""
    disorder: Integers
    """(edge, way, way) over how many rows that puts neighbours out of order."""
    start: Integers
    edge: Integers
    """start, edge: (run + 1,) where a run's edges begin; edges, run by run."""
    first: Integers
    last: Integers
    """first, last: (run,) sight lines on which it begins and ends."""
    apart: int = 1
    """Rows from one line to the next, about."""


def cheapest_shifts(
    entries: Entries, candidates: Candidates, piece: Integers, best: Integers, own: Floats, costs: PairCosts,
    weights: Weights,
) -> tuple[Integers, Floats, bool, Runs]:  # fmt: skip
    """Shift runs of one stripe as long as that lowers the energy.

    Parameters
    ----------
    entries, candidates, own, costs, weights
        The graph.
    piece
        (peak,) piece of its trace: a run does not go on from piece to piece.
    best
        (entry,) chosen node.

    Returns
    -------
    tuple
        (entry,) nodes; (entry,) what the cheapest shift that an entry's run is part of would cost, a line;
        whether anything was shifted; and the runs of these nodes.
    """
    moved = False
    evidence = np.zeros(best.size)
    runs = runs_of(entries, candidates, piece, best, own, costs, weights)
    for _ in range(_SHIFTS_MAX):
        # singles first: they are cheap, and leave fewer wrong runs to drag along
        by = single_shifts(runs, _GAIN_MIN)
        if not by.any():
            dearer, by = shifts_of(runs, entries.start.size - 1, _GAIN_MIN)
            # evidence is that of the last look, on which nothing moved
            evidence = of_entries(runs, dearer, np.inf)
            if not by.any():
                break
        moved = True
        best = shift_labels(candidates, best, of_entries(runs, by, 0))
        runs = runs_of(entries, candidates, piece, best, own, costs, weights)
    return best, evidence, moved, runs


def of_entries(runs: Runs, of_run: NDArray[Any], otherwise: float) -> NDArray[Any]:
    """Give (entry,) what (run,) values say of its run; `otherwise` where an entry is in none."""
    found = np.full(runs.of.size, otherwise, of_run.dtype)
    inside = runs.of >= 0
    found[inside] = of_run[runs.of[inside]]
    return found


def evidence_without(
    entries: Entries, candidates: Candidates, piece: Integers, best: Integers, own: Floats, costs: PairCosts,
    weights: Weights, doubtful: Flags,
) -> Floats:  # fmt: skip
    """Give (peak,) evidence as it is without the (peak,) ones that are in doubt; infinite for these."""
    # doubtful entries are none here, so they can neither hold nor force others
    left = np.where(doubtful[entries.peak], candidates.offset[1:] - 1, best)
    runs = runs_of(entries, candidates, piece, left, own, costs, weights)
    found = np.full(doubtful.size, np.inf)
    if not runs.stripe.size:
        return found
    dearer, _ = shifts_of(runs, entries.start.size - 1, _GAIN_MIN)
    np.minimum.at(found, entries.peak, np.where(runs.of >= 0, dearer[runs.of], np.inf))
    return found


@kernel
def runs_of(
    entries: Entries, candidates: Candidates, piece: Integers, best: Integers, own: Floats, costs: PairCosts,
    weights: Weights,
) -> Runs:  # fmt: skip
    """Make the graph of runs of a solution; see `cheapest_shifts`."""
    start, before_entry, tie = entries.start, entries.before, entries.tie
    low, count, offset = candidates.low, candidates.many, candidates.offset
    pair, pair_start, surface, unseen = costs.pair, costs.pair_start, costs.surface, costs.unseen
    before, after = costs.before, costs.after
    of, stripe = _runs(entries, candidates, piece, best)
    runs, lines = stripe.shape[0], start.shape[0] - 1
    alone = np.zeros((runs, _WAYS + 1))
    first, last_line = np.full(runs, lines, np.int64), np.full(runs, -1, np.int64)
    # each entry may touch one run above and one to the left
    key = np.empty(2 * of.shape[0], np.int64)
    keys = 0
    # runs touch the same ones from line to line: what the last line said is not written down again
    above, left = np.full(runs, -1, np.int64), np.full(runs, -1, np.int64)
    for e in range(lines):
        last = -1
        for p in range(start[e], start[e + 1]):
            f, q = of[p], before_entry[p]
            if f < 0:
                continue
            first[f], last_line[f] = min(first[f], e), max(last_line[f], e)
            # none of it: all its entries are false peaks
            alone[f, _OUT] += own[offset[p + 1] - 1]
            if q >= 0 and of[q] >= 0 and of[q] != f and of[q] != above[f]:
                above[f] = of[q]
                key[keys] = of[q] * runs + f
                keys += 1
            if last >= 0 and of[last] != f and of[last] != left[f]:
                left[f] = of[last]
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
            # own costs for the run one stripe to the left, where it is, one to the right
            for a in range(_WAYS):
                k = stripe[f] + a - _ASIDE - low[p]
                if 0 <= k < count[p]:
                    alone[f, a] += own[offset[p] + k]
                    # first label of its line: what would be seen to its left
                    if last < 0:
                        alone[f, a] += weights.unseen * before[offset[p] + k]
                else:
                    alone[f, a] += IMPOSSIBLE
            if q >= 0 and of[q] >= 0 and of[q] != f:
                t = np.searchsorted(key, of[q] * runs + f)
                # along a trace: the tie, wherever the two differ
                for a in range(_WAYS):
                    for b in range(_WAYS):
                        if stripe[of[q]] + a != stripe[f] + b:
                            both[t, a, b] += tie[p]
            # along a line: pairs are sorted by right entry, so the place only moves on
            if last >= 0 and of[last] != f:
                while n < pair_start[e + 1] and (pair[n, 1] < p or (pair[n, 1] == p and pair[n, 0] < last)):
                    n += 1
                near = n < pair_start[e + 1] and pair[n, 1] == p and pair[n, 0] == last
                t = np.searchsorted(key, of[last] * runs + f)
                for a in range(_WAYS):
                    h = stripe[of[last]] + a - _ASIDE - low[last]
                    for b in range(_WAYS):
                        k = stripe[f] + b - _ASIDE - low[p]
                        # out of order: not infinite, as light that spreads over an edge is out of order for a
                        # few lines
                        if stripe[of[last]] + a >= stripe[f] + b:
                            both[t, a, b] += DISORDER
                            disorder[t, a, b] += entries.apart
                        elif not near:
                            both[t, a, b] += IMPOSSIBLE
                        elif 0 <= k < count[p] and 0 <= h < count[last]:
                            c = pair[n, 2] + k * count[last] + h
                            step = weights.surface * surface[c] + weights.unseen * unseen[c]
                            # capped as neighbours out of reach are
                            both[t, a, b] += min(step, IMPOSSIBLE)
            last = p
        # last label of its line: what would be seen to its right
        if last >= 0:
            for a in range(_WAYS):
                k = stripe[of[last]] + a - _ASIDE - low[last]
                if 0 <= k < count[last]:
                    alone[of[last], a] += weights.unseen * after[offset[last] + k]
    one, other = key // runs, key % runs
    edge_start, edge = _edges(runs, one, other)
    apart = entries.apart
    return Runs(of, stripe, alone, one, other, both, disorder, edge_start, edge, first, last_line, apart)


@kernel
def single_shifts(runs: Runs, gain_min: float) -> Integers:
    """Give (run,) how far to move it: one run after the other, the one first that gains most by itself.

    What one run alone has wrong is put right there, before groups are moved to make way for it.
    """
    many = runs.own.shape[0]
    way = np.full(many, _ASIDE, np.int64)
    # the best single change first, again and again, until none gains enough
    while True:
        gain, best, to = gain_min, -1, 0
        for f in range(many):
            for way_f in range(_WAYS):
                if way_f != way[f]:
                    change = _change(f, way_f, way, runs)
                    if -change > gain:
                        gain, best, to = -change, f, way_f
        if best < 0:
            return way - _ASIDE
        way[best] = to


@kernel
def _runs(
    entries: Entries, candidates: Candidates, piece: Integers, best: Integers
) -> tuple[Integers, Integers]:
    peak, before_entry = entries.peak, entries.before
    low, count, offset = candidates.low, candidates.many, candidates.offset
    of = np.full(peak.shape[0], -1, np.int64)
    stripe = np.empty(peak.shape[0], np.int64)
    runs = 0
    for i in range(peak.shape[0]):
        k = best[i] - offset[i]
        if k >= count[i]:
            continue
        q = before_entry[i]
        # the same piece and stripe as on the line before: the run goes on
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
        # counting sort: edges of each run, from both of its ends
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
def shifts_of(runs: Runs, lines: int, gain_min: float) -> tuple[Floats, Integers]:
    """Shift every run by one stripe either way, with all that must, or had better, go along.

    Parameters
    ----------
    runs
        The graph of runs.
    lines
        Number of epipolar lines.
    gain_min
        A shift that is cheaper by this much or more is made.

    Returns
    -------
    tuple
        (run,) cost of the cheapest shift that it is part of, over the lines that are touched; and
        (run,) how far it is shifted by those that are cheaper, taken together; `OUT` where it is left out.
    """
    many, first, last = runs.own.shape[0], runs.first, runs.last
    dearer = np.full(many, np.inf)
    cost = np.full((many, 2), np.inf)
    way, waiting = np.empty(many, np.int64), np.empty(many, np.int64)
    queued = np.zeros(many, np.bool_)
    touched = np.zeros(lines + 1, np.int64)
    for f in range(many):
        for k in range(2):
            # each run as the seed of a shift, both ways
            way[:] = _ASIDE
            cost[f, k] = _shift(f, 2 * k - 1, way, runs, waiting, queued)
            low, high = lines, 0
            for g in range(many):
                if way[g] != _ASIDE:
                    # lines that any moved run covers, by a difference array between first and last
                    touched[first[g]] += 1
                    touched[last[g] + 1] -= 1
                    low, high = min(low, first[g]), max(high, last[g])
            inside, wide = 0, 0
            for e in range(low, high + 2):
                inside += touched[e]
                wide += inside > 0
                touched[e] = 0
            # dearer by line: comparable for a small group and a large one
            for g in range(many):
                if way[g] != _ASIDE:
                    dearer[g] = min(dearer[g], cost[f, k] / wide)
    way[:] = _ASIDE
    # gains are made in order, the largest first
    for n in np.argsort(cost.ravel(), kind="mergesort"):
        f, k = n // 2, n % 2
        if cost[f, k] > -gain_min:
            break
        # not moved by an earlier one, and still a gain after those
        if way[f] == _ASIDE:
            tried = way.copy()
            again = _shift(f, 2 * k - 1, tried, runs, waiting, queued)
            if again <= -gain_min:
                way = tried
    for f in range(many):
        way[f] = OUT if way[f] == _OUT else way[f] - _ASIDE
    return dearer, way


@kernel
def _shift(f: int, by: int, way: Integers, runs: Runs, waiting: Integers, queued: Flags) -> float:
    """Shift run f; then others the same way, as long as order asks for it or it is cheaper; give the cost.

    Runs that would have to give way are left out where that costs at most `_SMALL_COST`, and is cheaper.
    """
    # the seed moves whatever that costs
    cost = _change(f, way[f] + by, way, runs)
    way[f] += by
    more = _ask(f, way, runs, waiting, queued, 0)
    while more > 0:
        more -= 1
        g = waiting[more]
        queued[g] = False
        # forced where order is broken on more lines than light spreads over
        forced = False
        for n in range(runs.start[g], runs.start[g + 1]):
            t = runs.edge[n]
            forced = forced or runs.disorder[t, way[runs.one[t]], way[runs.other[t]]] > OVERLAP_ROWS
        to = way[g] + by
        change = _change(g, to, way, runs)
        # a small run in the way had better be left out than push all behind it
        if forced and runs.apart * runs.own[g, _OUT] <= _SMALL_COST:
            left_out = _change(g, _OUT, way, runs)
            if left_out < change:
                to, change = _OUT, left_out
        if forced or change < 0.0:
            cost += change
            way[g] = to
            more = _ask(g, way, runs, waiting, queued, more)
    return float(cost)


@kernel
def _ask(f: int, way: Integers, runs: Runs, waiting: Integers, queued: Flags, size: int) -> int:
    """Put the runs beside one that was shifted on the waiting list; give its new length."""
    one, other, start, edge = runs.one, runs.other, runs.start, runs.edge
    for n in range(start[f], start[f + 1]):
        g = other[edge[n]] if one[edge[n]] == f else one[edge[n]]
        # already moved or waiting runs are not asked again
        if way[g] == _ASIDE and not queued[g]:
            waiting[size], queued[g] = g, True
            size += 1
    return size


@kernel
def _change(f: int, now: int, way: Integers, runs: Runs) -> float:
    """What it costs to change one more run."""
    own, one, other, both, start, edge = runs.own, runs.one, runs.other, runs.both, runs.start, runs.edge
    was = way[f]
    cost = own[f, now] - own[f, was]
    for n in range(start[f], start[f + 1]):
        t = edge[n]
        if one[t] == f:
            cost += both[t, now, way[other[t]]] - both[t, was, way[other[t]]]
        else:
            cost += both[t, way[one[t]], now] - both[t, way[one[t]], was]
    return float(cost)


@kernel
def shift_labels(candidates: Candidates, best: Integers, by: Integers) -> Integers:
    """Give (entry,) nodes some stripes further on; the one for no stripe where that cannot be."""
    count, offset = candidates.many, candidates.offset
    found = best.copy()
    for i in range(count.shape[0]):
        k = best[i] - offset[i]
        if k < count[i] and by[i] != 0:
            # a stripe the entry cannot be: it is left out
            found[i] = best[i] + by[i] if 0 <= k + by[i] < count[i] else offset[i + 1] - 1
    return found
