"""From costs of lines to verdicts on peaks, what a whole solution costs, and which others may be better."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.label_pieces import ENDS


@kernel
def verdicts_of(
    start: Integers, peak: Integers, low: Integers, count: Integers, offset: Integers, line: Floats,
    piece: Integers, cost: Floats,
) -> tuple[Integers, Floats]:  # fmt: skip
    """Give (peak,) stripe or −1, and by how much the next best verdict is dearer; of its nearest line.

    A peak between two lines takes the verdict on which its neighbours in its piece agree.
    """
    peaks = line.shape[0]
    stripe = np.full(peaks, -1, np.int64)
    dearer = np.zeros(peaks)
    nearest = np.full(peaks, np.inf)
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            p = peak[i]
            if abs(line[p] - e) >= nearest[p] or count[i] == 0:
                continue
            nearest[p] = abs(line[p] - e)
            best, second, found = cost[offset[i + 1] - 1], np.inf, -1
            for k in range(count[i]):
                value = cost[offset[i] + k]
                if value < best:
                    best, second, found = value, best, low[i] + k
                else:
                    second = min(second, value)
            stripe[p] = found
            dearer[p] = second - best
    before = np.full(piece.shape[0], -1, np.int64)
    last = np.full(piece.shape[0], -1, np.int64)
    for p in range(peaks):
        if nearest[p] == np.inf:
            before[p] = last[piece[p]]
        else:
            last[piece[p]] = p
    last[:] = -1
    for p in range(peaks - 1, -1, -1):
        if nearest[p] < np.inf:
            last[piece[p]] = p
            continue
        one, other = before[p], last[piece[p]]
        if one >= 0 and other >= 0 and stripe[one] == stripe[other]:
            stripe[p], dearer[p] = stripe[one], min(dearer[one], dearer[other])
    return stripe, dearer


@kernel
def out_of_order(start: Integers, peak: Integers, row: Integers, stripe: Integers, stripes: int) -> Flags:
    """Mark coded peaks that stand out of order on a sight line, or share a stripe with another in a row."""
    wrong = np.zeros(stripe.shape[0], np.bool_)
    for e in range(start.shape[0] - 1):
        last = -1
        for i in range(start[e], start[e + 1]):
            p = peak[i]
            if stripe[p] < 0:
                continue
            if last >= 0 and last != p and stripe[last] >= stripe[p]:
                wrong[last] = wrong[p] = True
            last = p
    holder = np.full(stripes, -1, np.int64)
    for p in range(stripe.shape[0]):
        s = stripe[p]
        if s < 0:
            continue
        if holder[s] >= 0 and row[holder[s]] == row[p]:
            wrong[holder[s]] = wrong[p] = True
        holder[s] = p
    return wrong


@kernel
def chosen(count: Integers, offset: Integers, cost: Floats) -> Integers:
    """Give (entry,) the cheapest of its nodes."""
    best = np.empty(count.shape[0], np.int64)
    for i in range(count.shape[0]):
        best[i] = offset[i + 1] - 1
        for node in range(offset[i], offset[i] + count[i]):
            if cost[node] < cost[best[i]]:
                best[i] = node
    return best


@kernel
def shifted(
    start: Integers, peak: Integers, low: Integers, count: Integers, offset: Integers, best: Integers,
    piece: Integers, piece_line: Integers, own: Floats, where: Flags, stripe: int, by: int, gain: float,
) -> Floats:  # fmt: skip
    """Favour, off the belt, the stripe next to the chosen one, on one side of a stripe left out.

    Parameters
    ----------
    start, peak, low, count, offset
        See `roemetry_kernels.label_costs`.
    best
        (entry,) chosen node.
    piece, piece_line
        See `own_costs`.
    own
        (node,) cost.
    where
        (line,) where `stripe` is left out.
    by
        1 moves the stripes below `stripe` up, −1 those above it down.
    gain
        How much it is favoured.
    """
    favoured = own.copy()
    for e in range(start.shape[0] - 1):
        if not where[e]:
            continue
        for i in range(start[e], start[e + 1]):
            k = best[i] - offset[i]
            s = low[i] + k
            if k == count[i] or piece_line[piece[peak[i]]] == s or (s - stripe) * by >= 0:
                continue
            if 0 <= k + by < count[i]:
                favoured[best[i] + by] -= gain
    return favoured


@kernel
def line_costs(
    start: Integers, before_entry: Integers, tie: Floats, low: Integers, count: Integers, offset: Integers,
    best: Integers, own: Floats, pair: Integers, pair_start: Integers, surface: NDArray[np.float32],
    unseen: NDArray[np.float32], before: Floats, after: Floats, weight_surface: float, weight_unseen: float,
) -> Floats:  # fmt: skip
    """Give (line,) what the chosen nodes cost, ties to the line before included; infinite out of order."""
    lines = start.shape[0] - 1
    found = np.zeros(lines)
    for e in range(lines):
        n, last = pair_start[e], -1
        for p in range(start[e], start[e + 1]):
            k = best[p] - offset[p]
            found[e] += own[best[p]]
            q = before_entry[p]
            both = q >= 0 and k < count[p] and best[q] - offset[q] < count[q]
            if both and low[p] + k != low[q] + best[q] - offset[q]:
                found[e] += tie[p]
            if k == count[p]:
                continue
            if last < 0:
                found[e] += weight_unseen * before[best[p]]
            else:
                while n < pair_start[e + 1] and (pair[n, 1] < p or (pair[n, 1] == p and pair[n, 0] < last)):
                    n += 1
                if n < pair_start[e + 1] and pair[n, 1] == p and pair[n, 0] == last:
                    c = pair[n, 2] + k * count[last] + best[last] - offset[last]
                    step = weight_surface * surface[c] + weight_unseen * unseen[c]
                    found[e] += min(step, _BROKEN)
                else:
                    found[e] += _BROKEN
            last = p
        if last >= 0:
            found[e] += weight_unseen * after[best[last]]
    return found


@kernel
def left_out(
    start: Integers, low: Integers, count: Integers, offset: Integers, best: Integers, pair: Integers,
    pair_start: Integers, unseen: NDArray[np.float32], stripes: int,
) -> Floats:  # fmt: skip
    """Give (line, stripe) how much it costs that a stripe is left out between two others."""
    found = np.zeros((start.shape[0] - 1, stripes))
    for e in range(start.shape[0] - 1):
        n, last = pair_start[e], -1
        for p in range(start[e], start[e + 1]):
            k = best[p] - offset[p]
            if k == count[p]:
                continue
            if last >= 0:
                while n < pair_start[e + 1] and (pair[n, 1] < p or (pair[n, 1] == p and pair[n, 0] < last)):
                    n += 1
                s, t = low[p] + k, low[last] + best[last] - offset[last]
                if n < pair_start[e + 1] and pair[n, 1] == p and pair[n, 0] == last and s - t > 1:
                    c = pair[n, 2] + k * count[last] + best[last] - offset[last]
                    for between in range(t + 1, s):
                        found[e, between] += min(unseen[c], _BROKEN) / (s - t - 1)
            last = p
    return found


_BROKEN = 20.0
"""Cost of two neighbours out of order, or too far apart to be compared."""


@kernel
def mixed(piece: Integers, piece_line: Integers, stripe: Integers, stripes: int, share_min: float) -> Flags:
    """Mark coded peaks whose piece, which is one stripe, was given several: all but a large majority.

    Parameters
    ----------
    piece, piece_line
        (peak,) piece; (piece,) its rest line. `ENDS` may hold two stripes.
    stripe
        (peak,) stripe, below 0 for none.
    stripes
        Number of stripes.
    share_min
        Share of a piece's coded peaks that makes a majority large.
    """
    pieces = piece_line.shape[0]
    votes = np.zeros((pieces, stripes), np.int64)
    for p in range(piece.shape[0]):
        if stripe[p] >= 0:
            votes[piece[p], stripe[p]] += 1
    found = np.zeros(piece.shape[0], np.bool_)
    for p in range(piece.shape[0]):
        f = piece[p]
        if stripe[p] >= 0 and piece_line[f] != ENDS:
            found[p] = votes[f, stripe[p]] < share_min * votes[f].sum()
    return found
