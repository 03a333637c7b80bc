"""Traces followed by direction and curvature, over gaps, and numbered from the belt."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.ordering import vote_by_order
from roemetry_kernels.tracing import cut_at_rest_lines, nearest_rest

_SLOPE_GAIN = 0.3
_CURVATURE_GAIN = 0.03
_CURVATURE_MAX = 0.15
_GAP_GROWTH = 0.15
_BELT_ROWS_MIN = 6
_FLICKER_ROWS = 3
_END_ROWS = 12
_AGREEMENT_MIN = 0.9
_PASSES = 4


@kernel
def linked_traces(
    row_start: Integers, row: Integers, x_px: Floats, step_max_px: float, gap_rows: int
) -> tuple[Integers, int]:
    """Join peaks to traces that were going there.

    Each trace carries a place, a slope and a curvature that follow its peaks. A peak joins the open trace
    whose prediction is nearest, if that is mutual and near enough; the longer the gap, the farther it may be.

    Parameters
    ----------
    row_start, row, x_px
        Peaks by row, px.
    step_max_px
        Largest distance from the prediction, px.
    gap_rows
        A trace without a peak for longer is closed, rows.

    Returns
    -------
    tuple
        (peak,) trace, and the number of traces.
    """
    peaks = x_px.shape[0]
    trace = np.full(peaks, -1, np.int64)
    place, slope = np.empty(peaks), np.empty(peaks)
    curvature, last = np.empty(peaks), np.empty(peaks, np.int64)
    length = np.zeros(peaks, np.int64)
    open_traces = np.empty(peaks, np.int64)
    ahead, reach, far = np.empty(peaks), np.empty(peaks), np.empty(peaks)
    opened, count = 0, 0
    for r in range(row_start.shape[0] - 1):
        kept = 0
        for k in range(opened):
            t = open_traces[k]
            gap = r - last[t]
            if gap > gap_rows + 1:
                continue
            open_traces[kept] = t
            ahead[kept] = _ahead(place[t], slope[t], curvature[t], gap)
            reach[kept] = step_max_px * (1.0 + _GAP_GROWTH * (gap - 1))
            # a short trace does not know yet where it goes
            if length[t] < 4 and gap > 2:
                reach[kept] = 0.0
            far[kept] = 0.1 * gap
            kept += 1
        opened = waiting = kept
        for p in range(row_start[r], row_start[r + 1]):
            best, found, place_of_found = np.inf, -1, -1
            for k in range(waiting):
                off = abs(ahead[k] - x_px[p])
                nearer = off <= reach[k] and off + far[k] < best
                if nearer and _mine(ahead[k], p, r, row_start, x_px):
                    best, found, place_of_found = off + far[k], open_traces[k], k
            if found < 0:
                found = count
                place[found], slope[found], curvature[found] = x_px[p], 0.0, 0.0
                open_traces[opened] = found
                opened += 1
                count += 1
            else:
                gap = r - last[found]
                off = x_px[p] - ahead[place_of_found]
                reach[place_of_found] = -1.0  # it has its peak
                gain = max(_SLOPE_GAIN, 1.0 / (length[found] + 1))
                slope[found] += curvature[found] * gap + gain * off / gap
                bent = curvature[found] + _CURVATURE_GAIN * off / (gap * gap)
                curvature[found] = min(max(bent, -_CURVATURE_MAX), _CURVATURE_MAX)
                place[found] = x_px[p]
            last[found] = r
            length[found] += 1
            trace[p] = found
    return trace, count


@kernel
def _ahead(place: float, slope: float, curvature: float, gap: int) -> float:
    # over long gaps the curvature is trusted for the first rows only
    rows = min(gap, 5)
    return place + slope * gap + curvature * rows * (gap - 0.5 * rows)


@kernel
def _mine(ahead: float, p: int, r: int, row_start: Integers, x_px: Floats) -> bool:
    """Say whether no other peak of the row is nearer to where a trace was going."""
    off = abs(ahead - x_px[p])
    if p > row_start[r] and abs(ahead - x_px[p - 1]) < off:
        return False
    return not (p + 1 < row_start[r + 1] and abs(ahead - x_px[p + 1]) < off)


@kernel
def coded_traces(
    row_start: Integers, row: Integers, x_px: Floats, trace: Integers, traces: int, rest_px: Floats,
    live: Flags, tolerance_px: float, px_per_mm: Floats, height_min_mm: float, height_max_mm: float,
    rows_min: int,
) -> tuple[Integers, Floats]:  # fmt: skip
    """Number traces from the belt, the others by their order between them.

    Parameters
    ----------
    row_start, row, x_px
        Peaks by row, px.
    trace, traces
        See `linked_traces`.
    rest_px, live
        (stripe, row) rest lines, px; (stripe,) False for those that are not there.
    tolerance_px
        How far from its rest line a peak still is belt, px.
    px_per_mm
        (stripe,) displacement per height, px/mm.
    height_min_mm, height_max_mm
        Heights there may be, mm.
    rows_min
        Traces with fewer peaks are noise.

    Returns
    -------
    tuple
        (peak,) stripe, −1 for noise; and (peak,) margin, 0 where nothing decides.
    """
    line, _ = nearest_rest(row, x_px, rest_px, tolerance_px)
    piece, piece_line = cut_at_rest_lines(trace, line, traces, _BELT_ROWS_MIN, _FLICKER_ROWS)
    pieces = piece_line.shape[0]
    rows = rest_px.shape[1]
    of_label = np.flatnonzero(live)
    to_label = np.full(rest_px.shape[0], -1, np.int64)
    for i in range(of_label.size):
        to_label[of_label[i]] = i
    size = np.zeros(pieces, np.int64)
    first, last = np.full(pieces, rows, np.int64), np.full(pieces, -1, np.int64)
    for p in range(row.shape[0]):
        f = piece[p]
        size[f] += 1
        first[f], last[f] = min(first[f], row[p]), max(last[f], row[p])
    label = np.full(pieces, -1, np.int64)
    margin = np.zeros(pieces)
    for f in range(pieces):
        anchored = piece_line[f] >= 0 and (first[f] <= _END_ROWS or last[f] >= rows - 1 - _END_ROWS)
        if anchored and to_label[piece_line[f]] >= 0:
            label[f], margin[f] = to_label[piece_line[f]], 1.0
    used = np.empty(row.shape[0], np.int64)
    for p in range(row.shape[0]):
        used[p] = piece[p] if size[piece[p]] >= rows_min or label[piece[p]] >= 0 else -1
    low, high = np.empty(of_label.size), np.empty(of_label.size)
    for i in range(of_label.size):
        one, other = px_per_mm[of_label[i]] * height_min_mm, px_per_mm[of_label[i]] * height_max_mm
        low[i], high[i] = min(one, other) - tolerance_px, max(one, other) + tolerance_px
    rest_live = np.ascontiguousarray(rest_px[of_label])
    for _ in range(_PASSES):
        if _all_labelled(label, used):
            break
        votes, voters = vote_by_order(row_start, x_px, used, label, rest_live, low, high)
        settled = 0
        for f in range(pieces):
            if label[f] >= 0 or voters[f] < max(3, size[f] // 2):
                continue
            best, second, mine = 0, 0, -1
            for i in range(of_label.size):
                if votes[f, i] > best:
                    best, second, mine = votes[f, i], best, i
                else:
                    second = max(second, votes[f, i])
            if best >= _AGREEMENT_MIN * voters[f] and best - second >= 0.3 * voters[f]:
                label[f], margin[f] = mine, (best - second) / voters[f]
                settled += 1
        if settled == 0:
            break
    stripe = np.full(row.shape[0], -1, np.int64)
    sure = np.zeros(row.shape[0])
    for p in range(row.shape[0]):
        if used[p] >= 0:
            f = piece[p]
            stripe[p] = of_label[label[f]] if label[f] >= 0 else 0
            sure[p] = margin[f] if label[f] >= 0 else 0.0
    return stripe, sure


@kernel
def _all_labelled(label: Integers, used: Integers) -> bool:
    """Say whether there is nothing to vote on."""
    waiting = 0
    for p in range(used.shape[0]):
        waiting += used[p] >= 0 and label[used[p]] < 0
    return waiting == 0
