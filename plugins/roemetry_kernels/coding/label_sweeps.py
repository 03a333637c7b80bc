"""Strictly increasing stripes on every sight line, made to agree along the traces.

Each line is a chain, which is solved exactly, forwards and backwards: for every entry and stripe the least
cost of the whole line. What a line knows is handed down, trace by trace, to the next line, and so on to the
last; and the same upwards. A line's cost is shared out among its entries before it is handed on, so that what
is known once (all stripes are shifted by one) does not count once for every stripe.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel

_EMPTY = 3.0
"""A line with no stripe at all costs this many visible stripes left out."""


@kernel
def swept(
    start: Integers, up: Integers, down: Integers, tie: Floats, low: Integers, count: Integers,
    offset: Integers, own: Floats, pair: Integers, pair_start: Integers, surface: NDArray[np.float32],
    unseen: NDArray[np.float32], before: Floats, after: Floats, weight_surface: float,
    weight_unseen: float, keep: float,
) -> Floats:  # fmt: skip
    """Give each node its cost, less the least of its entry.

    Parameters
    ----------
    start, up, down, tie
        See `roemetry_kernels.coding.sight_entries.Entries` (there `before` and `after`).
    low, count, offset
        See `roemetry_kernels.coding.label_costs.Labels`.
    own
        (node,) cost of a node by itself.
    pair, pair_start, surface, unseen, before, after
        See `roemetry_kernels.coding.label_costs.Steps`.
    weight_surface, weight_unseen
        What a whole step of the surface, and a visible stripe left out, cost.
    keep
        Share of what is handed on that is kept at each line, 0 to 1.
    """
    size = own.shape[0]
    from_up, from_down = np.zeros(size), np.zeros(size)
    cost, total, taken = np.zeros(size), np.empty(size), np.empty(size)
    forward, backward = np.empty(size), np.empty(size)
    step = np.empty(unseen.shape[0], np.float32)
    for c in range(step.shape[0]):
        step[c] = weight_surface * surface[c] + weight_unseen * unseen[c]
    first, last = weight_unseen * before, weight_unseen * after
    empty = weight_unseen * _EMPTY
    lines = start.shape[0] - 1
    for downwards in (True, False):
        said = from_up if downwards else from_down
        for k in range(lines):
            e = k if downwards else lines - 1 - k
            if start[e] == start[e + 1]:
                continue
            a, b = start[e], start[e + 1]
            for node in range(offset[a], offset[b]):
                total[node] = own[node] + said[node]
                taken[node] = 0.0
            _share_out(a, b, pair_start[e], pair_start[e + 1], count, offset, total, pair, step, first, last,
                       forward, backward, taken)  # fmt: skip
            for i in range(a, b):
                if downwards and down[i] >= 0:
                    _hand_on(i, down[i], tie[down[i]], keep, low, count, offset, taken, from_up)
                elif not downwards and up[i] >= 0:
                    _hand_on(i, up[i], tie[i], keep, low, count, offset, taken, from_down)
    for e in range(lines):
        if start[e] == start[e + 1]:
            continue
        a, b = start[e], start[e + 1]
        for node in range(offset[a], offset[b]):
            total[node] = own[node] + from_up[node] + from_down[node]
        _solve(a, b, pair_start[e], pair_start[e + 1], count, offset, total, pair, step, first, last, empty,
               forward, backward, cost)  # fmt: skip
    return cost


@kernel
def _share_out(
    a: int, b: int, pair_a: int, pair_b: int, count: Integers, offset: Integers, total: Floats,
    pair: Integers, step: NDArray[np.float32], first: Floats, last: Floats,
    forward: Floats, backward: Floats, taken: Floats,
) -> None:  # fmt: skip
    """Take the line's cost apart into its nodes': evenly from the left, what is left from the right."""
    none = 0.0
    nothing = np.empty(b - a + 1)
    for i in range(a, b):
        nothing[i - a] = none
        none += total[offset[i + 1] - 1]
    nothing[b - a] = none
    _backwards(a, b, pair_a, pair_b, count, offset, total, pair, step, last, nothing, backward)
    n = pair_a
    for p in range(a, b):
        for node in range(offset[p], offset[p] + count[p]):
            forward[node] = nothing[p - a] + first[node]
        n = _arrive(p, n, pair_b, a, count, offset, pair, step, nothing, forward)
        least = np.inf
        for node in range(offset[p], offset[p] + count[p]):
            forward[node] += total[node]
            least = min(least, forward[node] + backward[node] - total[node])
        share = 1.0 / (b - p)
        for node in range(offset[p], offset[p] + count[p]):
            part = share * (forward[node] + backward[node] - total[node] - least)
            taken[node] += part
            forward[node] -= part
            total[node] -= part
    n = pair_b - 1
    for p in range(b - 1, a - 1, -1):
        for node in range(offset[p], offset[p] + count[p]):
            backward[node] = none - nothing[p + 1 - a] + last[node]
    for p in range(b - 1, a - 1, -1):
        least = np.inf
        for node in range(offset[p], offset[p] + count[p]):
            backward[node] += total[node]
            least = min(least, forward[node] + backward[node] - total[node])
        for node in range(offset[p], offset[p] + count[p]):
            part = forward[node] + backward[node] - total[node] - least
            taken[node] += part
            backward[node] -= part
        n = _depart(p, n, pair_a, a, count, offset, pair, step, nothing, backward)


@kernel
def _backwards(
    a: int, b: int, pair_a: int, pair_b: int, count: Integers, offset: Integers, total: Floats,
    pair: Integers, step: NDArray[np.float32], last: Floats, nothing: Floats, backward: Floats,
) -> None:  # fmt: skip
    """Write the least cost of the line from each node on, its own included."""
    for p in range(a, b):
        for node in range(offset[p], offset[p] + count[p]):
            backward[node] = nothing[b - a] - nothing[p + 1 - a] + last[node]
    n = pair_b - 1
    for p in range(b - 1, a - 1, -1):
        for node in range(offset[p], offset[p] + count[p]):
            backward[node] += total[node]
        n = _depart(p, n, pair_a, a, count, offset, pair, step, nothing, backward)


@kernel
def _arrive(
    p: int, n: int, end: int, a: int, count: Integers, offset: Integers, pair: Integers,
    step: NDArray[np.float32], nothing: Floats, forward: Floats,
) -> int:  # fmt: skip
    """Lower the costs up to entry p by coming from the entries before it; give the next pair."""
    while n < end and pair[n, 1] == p:
        q, c = pair[n, 0], pair[n, 2]
        between = nothing[p - a] - nothing[q + 1 - a]
        for s in range(count[p]):
            least = np.inf
            for t in range(count[q]):
                least = min(least, forward[offset[q] + t] + step[c])
                c += 1
            forward[offset[p] + s] = min(forward[offset[p] + s], least + between)
        n += 1
    return n


@kernel
def _depart(
    p: int, n: int, begin: int, a: int, count: Integers, offset: Integers, pair: Integers,
    step: NDArray[np.float32], nothing: Floats, backward: Floats,
) -> int:  # fmt: skip
    """Lower the costs of the entries before p by going on to p; give the next pair."""
    while n >= begin and pair[n, 1] == p:
        q, c = pair[n, 0], pair[n, 2]
        between = nothing[p - a] - nothing[q + 1 - a]
        for s in range(count[p]):
            later = backward[offset[p] + s] + between
            for t in range(count[q]):
                node = offset[q] + t
                backward[node] = min(backward[node], later + step[c])
                c += 1
        n -= 1
    return n


@kernel
def _hand_on(
    i: int, j: int, tie: float, keep: float, low: Integers, count: Integers, offset: Integers, taken: Floats,
    message: Floats,
) -> None:  # fmt: skip
    """Write what entry i says to entry j of the next line; a change of stripe costs the tie at most."""
    least = np.inf
    for node in range(offset[i], offset[i] + count[i]):
        least = min(least, taken[node])
    for b in range(count[j]):
        a = low[j] + b - low[i]
        said = tie
        if 0 <= a < count[i]:
            said = min(tie, keep * (taken[offset[i] + a] - least))
        message[offset[j] + b] = said


@kernel
def _solve(
    a: int, b: int, pair_a: int, pair_b: int, count: Integers, offset: Integers, total: Floats,
    pair: Integers, step: NDArray[np.float32], first: Floats, last: Floats,
    empty: float, forward: Floats, backward: Floats,
    cost: Floats,
) -> None:  # fmt: skip
    """Write the least cost of the line for each of its nodes, less the least of the entry."""
    none = 0.0
    nothing = np.empty(b - a + 1)
    for i in range(a, b):
        nothing[i - a] = none
        none += total[offset[i + 1] - 1]
        cost[offset[i + 1] - 1] = np.inf
    nothing[b - a] = none
    _backwards(a, b, pair_a, pair_b, count, offset, total, pair, step, last, nothing, backward)
    n = pair_a
    ended = none + empty
    for p in range(a, b):
        for node in range(offset[p], offset[p] + count[p]):
            forward[node] = nothing[p - a] + first[node]
        m = _arrive(p, n, pair_b, a, count, offset, pair, step, nothing, forward)
        while n < m:  # entries between the two are left out
            q, c = pair[n, 0], pair[n, 2]
            if p - q > 1:
                least = np.inf
                for s in range(count[p]):
                    for t in range(count[q]):
                        least = min(least, forward[offset[q] + t] + step[c] + backward[offset[p] + s])
                        c += 1
                least += nothing[p - a] - nothing[q + 1 - a]
                for i in range(q + 1, p):
                    cost[offset[i + 1] - 1] = min(cost[offset[i + 1] - 1], least)
            n += 1
        cost[offset[p + 1] - 1] = min(cost[offset[p + 1] - 1], ended)
        for node in range(offset[p], offset[p] + count[p]):
            forward[node] += total[node]
            ended = min(ended, forward[node] + none - nothing[p + 1 - a] + last[node])
    begun = none + empty
    for p in range(b - 1, a - 1, -1):
        left_out = offset[p + 1] - 1
        cost[left_out] = min(cost[left_out], begun)
        least = cost[left_out]
        for node in range(offset[p], offset[p] + count[p]):
            begun = min(begun, backward[node] + nothing[p - a] + first[node])
            cost[node] = forward[node] + backward[node] - total[node]
            least = min(least, cost[node])
        for node in range(offset[p], offset[p + 1]):
            cost[node] -= least
