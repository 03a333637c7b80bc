"""One stripe for each piece of a trace, in order on every sight line, from costs that differ along it."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry_kernels.coding.label_pieces import ENDS
from roemetry_kernels.compiling import kernel

_DEAR = 20.0
"""Costs count up to this."""
_SMALL_ENTRIES = 12
"""A piece of so few entries gives way to a larger one."""


@kernel
def agreed(
    start: Integers, peak: Integers, low: Integers, count: Integers, offset: Integers, piece: Integers,
    piece_line: Integers, stripes: int, cost: Floats,
) -> Integers:  # fmt: skip
    """Give (entry,) the node of the stripe that is cheapest for its whole piece.

    Single entries that are cheapest as no stripe stay so; ends choose for themselves. Of two that stand
    out of order on a sight line, the one of an end or of a small piece is no stripe.

    Parameters
    ----------
    start, peak, low, count, offset
        See `roemetry_kernels.coding.label_costs`.
    piece, piece_line
        (peak,) piece; (piece,) rest line that it follows, `ENDS` for ends, which may hold two stripes.
    stripes
        Number of stripes.
    cost
        (node,) costs.
    """
    pieces = piece_line.shape[0]
    gain = np.zeros((pieces, stripes))
    best = np.empty(peak.shape[0], np.int64)
    for i in range(peak.shape[0]):
        best[i] = offset[i + 1] - 1
        for k in range(count[i]):
            node = offset[i] + k
            gain[piece[peak[i]], low[i] + k] += _DEAR - min(cost[node], _DEAR)
            if cost[node] < cost[best[i]]:
                best[i] = node
    stripe = np.empty(pieces, np.int64)
    for f in range(pieces):
        stripe[f] = np.argmax(gain[f])
    for i in range(peak.shape[0]):
        f = piece[peak[i]]
        k = stripe[f] - low[i]
        if piece_line[f] != ENDS and best[i] < offset[i + 1] - 1:
            best[i] = offset[i] + k if 0 <= k < count[i] else offset[i + 1] - 1
    _put_in_order(start, peak, low, count, offset, piece, piece_line, best)
    return best


@kernel
def _put_in_order(
    start: Integers, peak: Integers, low: Integers, count: Integers, offset: Integers, piece: Integers,
    piece_line: Integers, best: Integers,
) -> None:  # fmt: skip
    size = np.zeros(piece_line.shape[0], np.int64)
    for i in range(peak.shape[0]):
        size[piece[peak[i]]] += piece_line[piece[peak[i]]] != ENDS
    for e in range(start.shape[0] - 1):
        last = -1
        for i in range(start[e], start[e + 1]):
            if best[i] - offset[i] >= count[i]:
                continue
            while last >= 0 and low[last] + best[last] - offset[last] >= low[i] + best[i] - offset[i]:
                before, here = size[piece[peak[last]]], size[piece[peak[i]]]
                if here <= before and here <= _SMALL_ENTRIES:
                    best[i] = offset[i + 1] - 1
                    break
                if before > _SMALL_ENTRIES:
                    break
                best[last] = offset[last + 1] - 1
                last -= 1
                while last >= start[e] and best[last] - offset[last] >= count[last]:
                    last -= 1
                if last < start[e]:
                    last = -1
            if best[i] - offset[i] < count[i]:
                last = i
