"""From costs of lines to one verdict for each peak: pieces of a trace agree, order is kept, doubt refused."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roemetry.arrays import Flags, Floats, Integers

ENDS = -2
"""Rest line of the ends that were cut off: not known."""
_MEAN_MAX = 6.0
"""No label of an entry counts for more than this in its piece's mean."""


@njit(cache=True, nogil=True)
def end_pieces(
    row: Integers, piece: Integers, line: Integers, rows: int, end_rows: int, border_rows: int
) -> tuple[Integers, Integers, Flags]:
    """Cut the ends off pieces that lie on a rest line and end amid the image.

    There a body that begins on the rest line, within its tolerance, may have been taken along.

    Parameters
    ----------
    row, piece
        (peak,) row and piece, peaks sorted by row.
    line
        (piece,) rest line a piece lies on, −1 for none.
    rows
        Image rows.
    end_rows
        What is cut off, rows.
    border_rows
        A piece that begins or ends this near to the image's border is not cut there.

    Returns
    -------
    tuple
        (peak,) new pieces; (piece,) the rest line of each, `ENDS` for ends; (piece,) True for what is left of
        a piece that reaches the image's border.
    """
    pieces = line.shape[0]
    first = np.full(pieces, rows, np.int64)
    last = np.full(pieces, -1, np.int64)
    for p in range(row.shape[0]):
        first[piece[p]] = min(first[piece[p]], row[p])
        last[piece[p]] = max(last[piece[p]], row[p])
    number = np.full((pieces, 3), -1, np.int64)
    found = np.empty(row.shape[0], np.int64)
    on = np.empty(3 * pieces, np.int64)
    anchored = np.zeros(3 * pieces, np.bool_)
    count = 0
    for p in range(row.shape[0]):
        f, part = piece[p], 0
        if line[f] >= 0:
            if first[f] > border_rows and row[p] < first[f] + end_rows:
                part = 1
            elif last[f] < rows - 1 - border_rows and row[p] > last[f] - end_rows:
                part = 2
        if number[f, part] < 0:
            number[f, part] = count
            on[count] = line[f] if part == 0 else ENDS
            anchored[count] = part == 0 and (first[f] <= border_rows or last[f] >= rows - 1 - border_rows)
            count += 1
        found[p] = number[f, part]
    return found, on[:count].copy(), anchored[:count].copy()


@njit(cache=True, nogil=True)
def presence_of(
    line: Floats, piece: Integers, piece_line: Integers, enters: Floats, leaves: Floats, lines: int,
    rows_full: int, rows_min: int, end_lines: int, lost: float,
) -> Floats:  # fmt: skip
    """Give (line, stripe) how surely a stripe's belt is there to be seen, 0 to 1.

    Parameters
    ----------
    line
        (peak,) see `roemetry_kernels.sight_lines`.
    piece, piece_line
        (peak,) piece; (piece,) rest line that it follows, below 0 for none.
    enters, leaves
        (stripe,) lines at which the rest line enters and leaves the image.
    lines
        Number of lines.
    rows_full, rows_min
        Peaks on the rest line that make a stripe certain; with fewer than the second it is not there.
    end_lines
        A stripe's belt may begin or end this far from the image's border.
    lost
        Where it does not reach so far: what is left of its presence there.
    """
    stripes = enters.shape[0]
    seen = np.zeros(stripes)
    first, last = np.full(stripes, np.inf), np.full(stripes, -np.inf)
    for p in range(line.shape[0]):
        s = piece_line[piece[p]]
        if s >= 0:
            seen[s] += 1.0
            first[s], last[s] = min(first[s], line[p]), max(last[s], line[p])
    presence = np.zeros((lines, stripes))
    for s in range(stripes):
        if seen[s] < rows_min:
            continue
        low, high = min(enters[s], leaves[s]), max(enters[s], leaves[s])
        for e in range(lines):
            off = (e < first[s] and first[s] - low > end_lines) or (
                e > last[s] and high - last[s] > end_lines
            )
            presence[e, s] = min(seen[s] / rows_full, 1.0) * (lost if off else 1.0)
    return presence


@njit(cache=True, nogil=True)
def own_costs(
    peak: Integers, low: Integers, count: Integers, offset: Integers, peak_line: Integers, piece: Integers,
    piece_line: Integers, anchored: Flags, there: Floats, false_peak: float, on_rest: float, long_run: float,
    anchor: float, absent: float, run_rows: tuple[int, int],
) -> Floats:  # fmt: skip
    """Give (node,) costs of a node by itself.

    Parameters
    ----------
    peak, low, count, offset
        See `roemetry_kernels.label_costs`.
    peak_line
        (peak,) rest line a peak lies on, −1 for none.
    piece, piece_line
        (peak,) piece; (piece,) rest line that it follows, −1 for none.
    anchored
        (piece,) True where it begins or ends at the image's border.
    there
        (stripe,) how surely a stripe is there, 0 to 1.
    false_peak
        Cost of no stripe.
    on_rest, long_run, anchor
        Gain of lying on the stripe's rest line, of doing so in a long run, and in one from the border on.
    absent
        Cost of a stripe that is not there.
    run_rows
        Rows from which a run begins to be long, and at which it is as long as it need be.
    """
    rows = np.zeros(piece_line.shape[0], np.int64)
    for p in range(piece.shape[0]):
        rows[piece[p]] += 1
    own = np.zeros(offset[-1])
    for i in range(peak.shape[0]):
        p = peak[i]
        long = (rows[piece[p]] - run_rows[0]) / (run_rows[1] - run_rows[0])
        for k in range(count[i]):
            s = low[i] + k
            node = offset[i] + k
            if peak_line[p] == s:
                own[node] -= on_rest
                if piece_line[piece[p]] == s:
                    own[node] -= long_run * min(max(long, 0.0), 1.0)
                    if anchored[piece[p]]:
                        own[node] -= anchor * min(rows[piece[p]] / run_rows[0], 1.0)
            own[node] += absent * (1.0 - min(1.0, 5.0 * there[s]))
        own[offset[i + 1] - 1] = false_peak
    return own


@njit(cache=True, nogil=True)
def pieces_agree(
    peak: Integers, low: Integers, count: Integers, offset: Integers, piece: Integers, piece_line: Integers,
    stripes: int, cost: Floats, own: Floats,
) -> Floats:  # fmt: skip
    """Add to each node's own cost the mean cost that its stripe has over its piece."""
    pieces = piece_line.shape[0]
    mean = np.zeros((pieces, stripes + 1))
    entries = np.zeros(pieces)
    for i in range(peak.shape[0]):
        f = piece[peak[i]]
        entries[f] += 1.0
        for k in range(count[i]):
            mean[f, low[i] + k] += min(cost[offset[i] + k], _MEAN_MAX) - _MEAN_MAX
        mean[f, stripes] += min(cost[offset[i + 1] - 1], _MEAN_MAX) - _MEAN_MAX
    for f in range(pieces):
        least = np.inf
        if piece_line[f] == ENDS:
            entries[f] = np.inf
        for s in range(stripes):
            least = min(least, mean[f, s])
        for s in range(stripes + 1):
            mean[f, s] = max(0.0, (mean[f, s] - least) / max(entries[f], 1.0))
    added = own.copy()
    for i in range(peak.shape[0]):
        f = piece[peak[i]]
        for k in range(count[i]):
            added[offset[i] + k] += mean[f, low[i] + k]
        added[offset[i + 1] - 1] += mean[f, stripes]
    return added


@njit(cache=True, nogil=True)
def verdicts_of(
    start: Integers, peak: Integers, low: Integers, count: Integers, offset: Integers, line: Floats,
    cost: Floats,
) -> tuple[Integers, Floats]:  # fmt: skip
    """Give (peak,) stripe or −1, and by how much the next best verdict is dearer; of its nearest line."""
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
    return stripe, dearer


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def chosen(count: Integers, offset: Integers, cost: Floats) -> Integers:
    """Give (entry,) the cheapest of its nodes."""
    best = np.empty(count.shape[0], np.int64)
    for i in range(count.shape[0]):
        best[i] = offset[i + 1] - 1
        for node in range(offset[i], offset[i] + count[i]):
            if cost[node] < cost[best[i]]:
                best[i] = node
    return best


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
            if q >= 0 and k < count[p] and best[q] - offset[q] < count[q]:
                if low[p] + k != low[q] + best[q] - offset[q]:
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


@njit(cache=True, nogil=True)
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
