"""From costs of nodes to verdicts on peaks."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.coding.label_pieces import ENDS
from roemetry_kernels.compiling import kernel

_ONE_SIDE = 0.4
_WHOLE_PEAKS = 6
_WHOLE_SHARE = 0.75
"""A piece with as many peaks, this share of them one stripe, holds no false ones."""


@kernel
def verdicts_of(
    start: Integers, peak: Integers, low: Integers, count: Integers, offset: Integers, line: Floats,
    piece: Integers, piece_line: Integers, cost: Floats, best: Integers, evidence: Floats,
) -> tuple[Integers, Floats, Floats]:  # fmt: skip
    """Give (peak,) stripe or −1, by how much the next best is dearer, and evidence; of its nearest line.

    A piece that is nearly all one stripe is no heap of false peaks: none of its peaks is left out alone. A
    peak between two lines takes the verdict on which its neighbours in its piece agree.

    Parameters
    ----------
    start, peak, low, count, offset
        See `roemetry_kernels.coding.label_costs`.
    line
        (peak,) see `roemetry_kernels.coding.sight_lines`.
    piece, piece_line
        (peak,) piece of its trace; (piece,) rest line that it follows, `ENDS` for ends.
    cost
        (node,) costs.
    best, evidence
        (entry,) chosen node, and what is handed on to the peak.
    """
    peaks, pieces = line.shape[0], piece_line.shape[0]
    entry = _nearest_entry(start, peak, count, line)
    votes, voted = np.zeros(pieces, np.int64), np.full(pieces, -1, np.int64)
    size, least = np.zeros(pieces, np.int64), np.full(pieces, np.inf)
    for turn in range(2):
        for p in range(peaks):
            i, f = entry[p], piece[p]
            if i < 0 or piece_line[f] == ENDS:
                continue
            k = best[i] - offset[i]
            if turn == 0:
                if k < count[i]:
                    if votes[f] == 0:
                        voted[f] = low[i] + k
                    votes[f] += 1 if voted[f] == low[i] + k else -1
            else:
                size[f] += 1
                if k < count[i] and voted[f] == low[i] + k:
                    votes[f] += 1
                    least[f] = min(least[f], evidence[i])
        if turn == 0:
            votes[:] = 0
    stripe = np.full(peaks, -1, np.int64)
    dearer, sure = np.zeros(peaks), np.zeros(peaks)
    for p in range(peaks):
        i, f = entry[p], piece[p]
        if i < 0:
            continue
        node, sure[p] = best[i], evidence[i]
        whole = size[f] >= _WHOLE_PEAKS and votes[f] >= _WHOLE_SHARE * size[f]
        k = voted[f] - low[i]
        whole = whole and 0 <= k < count[i]
        if whole and node == offset[i + 1] - 1:
            node, sure[p] = offset[i] + k, least[f]
        second = np.inf
        for n in range(offset[i], offset[i + 1] - whole):
            if n != node:
                second = min(second, cost[n])
        k = node - offset[i]
        stripe[p] = low[i] + k if k < count[i] else -1
        dearer[p] = max(second - cost[node], 0.0)
    before = np.full(piece.shape[0], -1, np.int64)
    last = np.full(piece.shape[0], -1, np.int64)
    for p in range(peaks):
        if entry[p] < 0:
            before[p] = last[piece[p]]
        else:
            last[piece[p]] = p
    last[:] = -1
    for p in range(peaks - 1, -1, -1):
        if entry[p] >= 0:
            last[piece[p]] = p
            continue
        one, other = before[p], last[piece[p]]
        if one >= 0 and other >= 0 and stripe[one] == stripe[other]:
            stripe[p], dearer[p] = stripe[one], min(dearer[one], dearer[other])
            sure[p] = min(sure[one], sure[other])
    return stripe, dearer, sure


@kernel
def _nearest_entry(start: Integers, peak: Integers, count: Integers, line: Floats) -> Integers:
    """Give (peak,) its entry on the line nearest to it, −1 for none that could be any stripe."""
    entry = np.full(line.shape[0], -1, np.int64)
    nearest = np.full(line.shape[0], np.inf)
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            off = abs(line[peak[i]] - e)
            if off < nearest[peak[i]] and count[i] > 0:
                nearest[peak[i]], entry[peak[i]] = off, i
    return entry


@kernel
def out_of_order(
    start: Integers, peak: Integers, row: Integers, on_line: Integers, stripe: Integers, stripes: int
) -> Flags:
    """Mark coded peaks that stand out of order on a sight line, or share a stripe with another in a row.

    A stripe may be seen twice in a row, on the belt and, displaced, on the product; there is place for one,
    so the belt's is marked.

    Parameters
    ----------
    start, peak
        See `roemetry_kernels.coding.label_costs`.
    row, on_line, stripe
        (peak,) row; rest line it lies on, −1 for none; stripe, below 0 for none.
    stripes
        Number of stripes.
    """
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
        if s < 0 or wrong[p]:
            continue
        q = holder[s]
        if q >= 0 and row[q] == row[p]:
            one, other = on_line[q] == s, on_line[p] == s
            wrong[q] = wrong[q] or one or not other
            wrong[p] = wrong[p] or other or not one
            if wrong[p] and not wrong[q]:
                continue
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
def favoured(count: Integers, offset: Integers, best: Integers, own: Floats, gain: float) -> Floats:
    """Give (node,) own costs with the chosen stripes cheaper by a gain."""
    found = own.copy()
    for i in range(count.shape[0]):
        if best[i] - offset[i] < count[i]:
            found[best[i]] -= gain
    return found


@kernel
def stepped(count: Integers, offset: Integers, best: Integers, by: Integers) -> Integers:
    """Give (entry,) nodes some stripes further on; the one for no stripe where that cannot be."""
    found = best.copy()
    for i in range(count.shape[0]):
        k = best[i] - offset[i]
        if k < count[i] and by[i] != 0:
            found[i] = best[i] + by[i] if 0 <= k + by[i] < count[i] else offset[i + 1] - 1
    return found


@kernel
def ends_settled(
    trace: Integers, piece: Integers, piece_line: Integers, home: Integers, line: Integers, stripe: Integers
) -> Floats:
    """Give (peak,) how far the rest of its trace speaks for a peak of a cut-off end; 1 for any other peak.

    1 if the trace is that stripe on both sides, less if on one, 0 if on neither.
    Where the trace is belt on one side and another stripe's product on the other, the row at which it
    changes is not known: 0 for what is called belt there, too, and for what is called product and still lies
    on the belt's rest line.

    Parameters
    ----------
    trace, piece
        (peak,) trace and piece, peaks sorted by row.
    piece_line, home
        (piece,) its rest line, `ENDS` for ends; the rest line that an end was cut off from.
    line
        (peak,) rest line a peak lies on, −1 for none.
    stripe
        (peak,) stripe, below 0 for none.
    """
    peaks, pieces = trace.shape[0], piece_line.shape[0]
    votes = np.zeros(pieces, np.int64)
    of_piece = np.full(pieces, -1, np.int64)  # the stripe most of its peaks have, by counting up and down
    for p in range(peaks):
        f = piece[p]
        if stripe[p] < 0 or piece_line[f] == ENDS:
            continue
        if votes[f] == 0:
            of_piece[f] = stripe[p]
        votes[f] += 1 if of_piece[f] == stripe[p] else -1
    sides = np.full((peaks, 2), -1, np.int64)
    belt = np.zeros((peaks, 2), np.bool_)
    last = np.full(peaks + 1, -1, np.int64)
    for side in range(2):
        last[:] = -1
        for n in range(peaks):
            p = n if side == 0 else peaks - 1 - n
            if piece_line[piece[p]] != ENDS:
                last[trace[p]] = piece[p]
            elif last[trace[p]] >= 0:
                f = last[trace[p]]
                sides[p, side] = of_piece[f]
                belt[p, side] = piece_line[f] == of_piece[f]
    found = np.ones(peaks)
    for p in range(peaks):
        if stripe[p] < 0 or piece_line[piece[p]] != ENDS:
            continue
        a, b = sides[p]
        if a >= 0 and a == b:
            settled = 1.0 if stripe[p] == a else 0.0
        elif a < 0 and b < 0:
            settled = _ONE_SIDE if stripe[p] == home[piece[p]] else 0.0
        elif a < 0 or b < 0:
            settled = _ONE_SIDE if stripe[p] == max(a, b) else 0.0
        else:
            here = (stripe[p] == a and not belt[p, 0]) or (stripe[p] == b and not belt[p, 1])
            still = (belt[p, 0] and line[p] == a) or (belt[p, 1] and line[p] == b)
            settled = _ONE_SIDE if here and not still else 0.0
        found[p] = settled
    return found


@kernel
def beside_level_bodies(
    row: Integers, stripe: Integers, on_line: Integers, piece: Integers, piece_line: Integers, rows_min: int
) -> Flags:
    """Mark belt beside a body that lies along the rest line of another stripe.

    Such a body is level, and displaces its stripe by whole spacings: it may go on over the neighbours, which
    then look like bare belt. What is marked are the belt's peaks of the same rows, from that rest line on
    up to the first stripe that is not seen.

    Parameters
    ----------
    row, stripe, on_line, piece
        (peak,) row, sorted; stripe, below 0 for none; rest line it lies on, −1 for none; piece.
    piece_line
        (piece,) rest line it follows, −1 for none.
    rows_min
        Shorter pieces cross the rest line by chance.
    """
    peaks, size = row.shape[0], np.zeros(piece_line.shape[0], np.int64)
    for p in range(peaks):
        size[piece[p]] += stripe[p] >= 0 and stripe[p] != piece_line[piece[p]]
    found = np.zeros(peaks, np.bool_)
    for p in range(peaks):
        f = piece[p]
        if piece_line[f] < 0 or stripe[p] < 0 or stripe[p] == piece_line[f] or size[f] < rows_min:
            continue
        by = 1 if piece_line[f] > stripe[p] else -1
        last, q = piece_line[f], p + by
        while 0 <= q < peaks and row[q] == row[p]:
            if stripe[q] >= 0:
                if (stripe[q] - last) * by > 1:
                    break
                found[q] = found[q] or on_line[q] == stripe[q]
                last = stripe[q]
            q += by
    return found
