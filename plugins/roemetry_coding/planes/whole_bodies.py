"""Whole bodies, moved by one stripe or several: what the margin of a body's number is measured against.

Model. A round body is the same surface, lower or higher, if all its labels are some stripes off; only how it
meets the belt tells. `shifts` moves a run with what order forces along, or what had better go along. Where
runs in the middle of a body gain nothing and are not forced, it stops half-way, at a break amid the body that
is dearer than the whole body moved: on potatoes under 40 lines it asked 2 to 7 a line for a shift that costs
1.7 to 2. So whole bodies are moved here as well: all runs off their rest lines that touch each other, on
lines or along traces, by up to `_REACH` stripes each way. The change of the energy of `graph` is exact, but
for two neighbours out of order, which cost what they do in `shifts`.

Assumes that a body's runs touch, and that its labels are right or wrong together; parts of it are for
`shifts`. A level top so near to a whole number of label heights that it is taken for belt is no body here.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_coding.planes.graph import Candidates, PairCosts, Weights
from roemetry_coding.planes.lines import GAP_ROWS, Entries
from roemetry_coding.planes.shifts import DISORDER, IMPOSSIBLE, Runs
from roemetry_kernels.compiling import kernel

_REACH = 3
"""Stripes each way: heights are looked for up to about as many label heights above a body on dense rigs."""
_ROWS_MIN = 100
"""Smaller bodies are for `shifts`: so few rows, of all stripes together, are one run or two, which it moves
as a whole."""
_LOST_SHARE_MAX = 0.25
"""Of a body that is moved, more entries without a possible height are no body there: below the belt, or above
what heights are looked for."""
_AGAINST_SHARE_MAX = 0.5
"""Where order speaks against a shift on more of the lines, it does against farther ones the same way."""


@kernel
def whole_body_shifts(
    entries: Entries, candidates: Candidates, line: Integers, best: Integers, runs: Runs, own: Floats,
    costs: PairCosts, weights: Weights,
) -> tuple[Floats, Integers]:  # fmt: skip
    """Move every body as a whole.

    Parameters
    ----------
    entries, candidates, own, costs, weights
        The graph.
    line
        (peak,) rest line that a peak lies on, −1 for none.
    best
        (entry,) chosen node.
    runs
        The runs of that solution.

    Returns
    -------
    tuple
        (run,) what the cheapest shift of the body that it is part of would cost, over the lines that the body
        crosses, infinite off bodies; and (run,) by how many stripes it costs least to move its body.
    """
    start, count, offset = entries.start, candidates.many, candidates.offset
    body, bodies = _bodies(entries, line, runs)
    dearer, by = np.full(runs.stripe.shape[0], np.inf), np.zeros(runs.stripe.shape[0], np.int64)
    lines = start.shape[0] - 1
    still = np.empty(lines)
    zero = np.zeros(best.shape[0], np.int64)
    # lines as they are: what a move changes is compared with them
    for e in range(lines):
        still[e] = _cost_of(e, zero, entries, candidates, best, own, costs, weights)[0]
    move = np.empty(best.shape[0], np.int64)
    crossed = np.empty(lines, np.bool_)
    for b in range(bodies):
        size = 0
        # the sight lines it crosses; its cost is told per line
        crossed[:] = False
        for e in range(lines):
            for i in range(start[e], start[e + 1]):
                if runs.of[i] >= 0 and body[runs.of[i]] == b:
                    crossed[e] = True
                    size += entries.apart
        if size < _ROWS_MIN:
            continue
        least, to = np.inf, 0
        for way in (-1, 1):
            for far in range(1, _REACH + 1):
                lost = 0
                for i in range(best.shape[0]):
                    move[i] = 0
                    if runs.of[i] >= 0 and body[runs.of[i]] == b:
                        move[i] = way * far
                        # entries for which the moved stripe has no possible height
                        lost += entries.apart * (not 0 <= best[i] + move[i] - offset[i] < count[i])
                # and farther on even more have none
                if lost > _LOST_SHARE_MAX * size:
                    break
                # behind the last line it crosses, ties still reach over a gap
                change, wide, against, last = 0.0, 0, 0, -GAP_ROWS - 1
                for e in range(lines):
                    if crossed[e]:
                        wide, last = wide + 1, e
                    if entries.apart * (e - last) <= GAP_ROWS:
                        cost, disorder = _cost_of(e, move, entries, candidates, best, own, costs, weights)
                        change += cost - still[e]
                        against += disorder > 0
                if change / wide < least:
                    least, to = change / wide, way * far
                # farther the same way order is broken as well
                if against > _AGAINST_SHARE_MAX * wide:
                    break
        for f in range(runs.stripe.shape[0]):
            if body[f] == b:
                dearer[f], by[f] = least, to
    return dearer, by


@kernel
def _bodies(entries: Entries, line: Integers, runs: Runs) -> tuple[Integers, int]:
    """Number (run,) the bodies, −1 for belt: runs that touch and are mostly off their rest lines."""
    many = runs.stripe.shape[0]
    size, on_line = np.zeros(many, np.int64), np.zeros(many, np.int64)
    for i in range(runs.of.shape[0]):
        f = runs.of[i]
        if f >= 0:
            size[f] += 1
            on_line[f] += line[entries.peak[i]] == runs.stripe[f]
    body, bodies = np.full(many, -1, np.int64), 0
    waiting = np.empty(many, np.int64)
    for first in range(many):
        # mostly on its rest lines: belt
        if body[first] >= 0 or 2 * on_line[first] > size[first]:
            continue
        # flood over runs that touch
        body[first], waiting[0], left = bodies, first, 1
        while left > 0:
            left -= 1
            f = waiting[left]
            for n in range(runs.start[f], runs.start[f + 1]):
                t = runs.edge[n]
                g = runs.other[t] if runs.one[t] == f else runs.one[t]
                if body[g] < 0 and 2 * on_line[g] <= size[g]:
                    body[g], waiting[left] = bodies, g
                    left += 1
        bodies += 1
    return body, bodies


@kernel
def _cost_of(
    e: int, move: Integers, entries: Entries, candidates: Candidates, best: Integers, own: Floats,
    costs: PairCosts, weights: Weights,
) -> tuple[float, int]:  # fmt: skip
    """Cost of line e, and of its ties to lines before, with entries moved; neighbours out of order there."""
    start, before_entry = entries.start, entries.before
    low, count, offset = candidates.low, candidates.many, candidates.offset
    cost, disorder, last, last_k, n = 0.0, 0, -1, 0, costs.pair_start[e]
    for p in range(start[e], start[e + 1]):
        k = best[p] - offset[p]
        if k < count[p]:
            k += move[p]
        # left out, or no longer possible where it is moved to
        if not 0 <= k < count[p]:
            cost += own[offset[p + 1] - 1]
            continue
        cost += own[offset[p] + k]
        q = before_entry[p]
        if q >= 0:
            h = best[q] - offset[q]
            # tie to the entry before: only where both are stripes and differ
            if h < count[q] and 0 <= h + move[q] < count[q] and low[q] + h + move[q] != low[p] + k:
                cost += entries.tie[p]
        if last < 0:
            cost += weights.unseen * costs.before[offset[p] + k]
        elif low[last] + last_k >= low[p] + k:
            cost += DISORDER
            disorder += 1
        else:
            while n < costs.pair_start[e + 1] and (
                costs.pair[n, 1] < p or (costs.pair[n, 1] == p and costs.pair[n, 0] < last)
            ):
                n += 1
            # too far apart for costs to be kept
            step = IMPOSSIBLE
            if n < costs.pair_start[e + 1] and costs.pair[n, 1] == p and costs.pair[n, 0] == last:
                c = costs.pair[n, 2] + k * count[last] + last_k
                step = min(weights.surface * costs.surface[c] + weights.unseen * costs.unseen[c], IMPOSSIBLE)
            cost += step
        last, last_k = p, k
    if last >= 0:
        cost += weights.unseen * costs.after[offset[last] + last_k]
    return float(cost), disorder
