"""The best set of runs to move to the next stripe together, found as a minimal cut."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_LEAST = 1e-6


@kernel
def best_shift(
    own: Floats, one: Integers, other: Integers, both: Floats, stays: int, by: int
) -> tuple[Flags, float]:
    """Give (run,) which runs to move by one stripe so that the whole is cheapest, and the change of cost.

    Of all sets of runs the best one, but for pairs that would rather have just one of the two moved; their
    cost is overstated. That does not happen to the cost that is given.

    Parameters
    ----------
    own, one, other, both
        See `roemetry_kernels.coding.label_graph.Runs`.
    stays
        Way of staying what it is.
    by
        1 for the next stripe, −1 for the one before.
    """
    runs, pairs = own.shape[0], one.shape[0]
    goes = stays + by
    alone = own[:, goes] - own[:, stays]
    # arcs in pairs, each followed by its reverse; nodes: runs, source, sink
    source, sink = runs, runs + 1
    head = np.empty(2 * (pairs + runs), np.int64)
    room = np.zeros(2 * (pairs + runs))
    arcs = 0
    tail = np.empty(2 * (pairs + runs), np.int64)
    for t in range(pairs):
        f, g = one[t], other[t]
        neither, second = both[t, stays, stays], both[t, stays, goes]
        first, together = both[t, goes, stays], both[t, goes, goes]
        over = max(neither + together - first - second, 0.0)
        first, second = first + 0.5 * over, second + 0.5 * over
        alone[f] += first - neither
        alone[g] += together - first
        tail[arcs], head[arcs], tail[arcs + 1], head[arcs + 1] = f, g, g, f
        room[arcs] = max(second + first - neither - together, 0.0)
        arcs += 2
    for f in range(runs):
        begin, end = (source, f) if alone[f] > 0.0 else (f, sink)
        tail[arcs], head[arcs], tail[arcs + 1], head[arcs + 1] = begin, end, end, begin
        room[arcs] = abs(alone[f])
        arcs += 2
    stays_side = _source_side(tail, head, room, runs + 2, source, sink)
    moved = ~stays_side[:runs]
    change = 0.0
    for f in range(runs):
        if moved[f]:
            change += own[f, goes] - own[f, stays]
    for t in range(pairs):
        a, b = goes if moved[one[t]] else stays, goes if moved[other[t]] else stays
        change += both[t, a, b] - both[t, stays, stays]
    return moved, change


@kernel
def _source_side(tail: Integers, head: Integers, room: Floats, nodes: int, source: int, sink: int) -> Flags:
    """Fill the network by shortest ways (Dinic); give (node,) True where the source still reaches."""
    start = np.zeros(nodes + 1, np.int64)
    for a in range(tail.shape[0]):
        start[tail[a] + 1] += 1
    start = np.cumsum(start)
    arc, fill = np.empty(tail.shape[0], np.int64), start[:-1].copy()
    for a in range(tail.shape[0]):
        arc[fill[tail[a]]] = a
        fill[tail[a]] += 1
    level, queue = np.empty(nodes, np.int64), np.empty(nodes, np.int64)
    at, way = np.empty(nodes, np.int64), np.empty(nodes, np.int64)
    while True:
        level[:] = -1
        level[source], queue[0], first, size = 0, source, 0, 1
        while first < size:
            n = queue[first]
            first += 1
            for k in range(start[n], start[n + 1]):
                a = arc[k]
                if room[a] > _LEAST and level[head[a]] < 0:
                    level[head[a]] = level[n] + 1
                    queue[size] = head[a]
                    size += 1
        if level[sink] < 0:
            return level >= 0
        for n in range(nodes):
            at[n] = start[n]
        n, depth = source, 0
        while True:
            if n == sink:
                least = np.inf
                for k in range(depth):
                    least = min(least, room[way[k]])
                back = depth
                for k in range(depth - 1, -1, -1):
                    room[way[k]] -= least
                    room[way[k] ^ 1] += least
                    if room[way[k]] <= _LEAST:
                        back = k
                depth, n = back, tail[way[back]]
                continue
            while at[n] < start[n + 1]:
                a = arc[at[n]]
                if room[a] > _LEAST and level[head[a]] == level[n] + 1:
                    break
                at[n] += 1
            if at[n] < start[n + 1]:
                way[depth] = arc[at[n]]
                n = head[way[depth]]
                depth += 1
            elif depth == 0:
                break
            else:
                depth -= 1
                n = tail[way[depth]]
                at[n] += 1
