"""Traces followed by direction and curvature, over gaps, and numbered from the belt."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.coding.consistency import refuse_disorder
from roemetry_kernels.coding.rest_lines import vote_by_order
from roemetry_kernels.coding.tracing import cut_in_order
from roemetry_kernels.compiling import kernel

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
    row_start: Integers, x_px: Floats, step_max_px: float, gap_rows: int
) -> tuple[Integers, int]:
    """Join peaks to traces that were going there.

    Each trace carries a place, a slope and a curvature that follow its peaks. A peak joins the open trace
    whose prediction is nearest, if that is mutual and near enough; the longer the gap, the farther it may be.

    Parameters
    ----------
    row_start, x_px
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
    trace = np.empty(peaks, np.int64)
    # what is known of the open traces, in the order in which they began
    number, last = np.empty(peaks, np.int64), np.empty(peaks, np.int64)
    length = np.empty(peaks, np.int64)
    place, slope, curvature = np.empty(peaks), np.empty(peaks), np.empty(peaks)
    ahead = np.empty(peaks)
    # of a row's peaks: the trace that comes nearest, and how near
    most = 0
    for r in range(row_start.shape[0] - 1):
        most = max(most, row_start[r + 1] - row_start[r])
    taken_by, nearest = np.full(most, -1, np.int64), np.full(most, np.inf)
    opened, count = 0, 0
    for r in range(row_start.shape[0] - 1):
        begin, end = row_start[r], row_start[r + 1]
        kept, p = 0, begin
        for k in range(opened):
            gap = r - last[k]
            if gap > gap_rows + 1:
                continue
            if kept != k:
                number[kept], last[kept], length[kept] = number[k], last[k], length[k]
                place[kept], slope[kept], curvature[kept] = place[k], slope[k], curvature[k]
            to, reach, far = place[kept] + slope[kept] + 0.5 * curvature[kept], step_max_px, 0.1
            if gap > 1:
                to = _ahead(place[kept], slope[kept], curvature[kept], gap)
                reach, far = step_max_px * (1.0 + _GAP_GROWTH * (gap - 1)), 0.1 * gap
            ahead[kept] = to
            kept += 1
            # a short trace does not know yet where it goes
            if begin == end or (gap > 2 and length[kept - 1] < 4):
                continue
            while p + 1 < end and abs(to - x_px[p + 1]) < abs(to - x_px[p]):
                p += 1
            while p > begin and abs(to - x_px[p - 1]) < abs(to - x_px[p]):
                p -= 1
            off = abs(to - x_px[p])
            if off <= reach and off + far < nearest[p - begin]:
                taken_by[p - begin], nearest[p - begin] = kept - 1, off + far
        opened = kept
        for p in range(begin, end):
            k = taken_by[p - begin]
            taken_by[p - begin], nearest[p - begin] = -1, np.inf
            if k < 0:
                k = opened
                number[k], length[k], slope[k], curvature[k] = count, 0, 0.0, 0.0
                opened += 1
                count += 1
            else:
                gap = r - last[k]
                off = x_px[p] - ahead[k]
                gain = _SLOPE_GAIN
                if length[k] < 3:
                    gain = max(gain, 1.0 / (length[k] + 1))
                away, bend = gain * off, _CURVATURE_GAIN * off
                if gap > 1:  # nearly never, and divisions are slow
                    away, bend = away / gap, bend / (gap * gap)
                slope[k] += curvature[k] * gap + away
                bent = curvature[k] + bend
                curvature[k] = min(max(bent, -_CURVATURE_MAX), _CURVATURE_MAX)
            place[k], last[k] = x_px[p], r
            length[k] += 1
            trace[p] = number[k]
    return trace, count


@kernel
def _ahead(place: float, slope: float, curvature: float, gap: int) -> float:
    # over long gaps the curvature is trusted for the first rows only
    rows = min(gap, 5)
    return place + slope * gap + curvature * rows * (gap - 0.5 * rows)


@kernel
def coded_traces(
    row_start: Integers, row: Integers, x_px: Floats, step_max_px: float, gap_rows: int, rest_px: Floats,
    line: Integers, live: Flags, tolerance_px: float, px_per_mm: Floats, height_min_mm: float,
    height_max_mm: float, rows_min: int, margin_min: float, refused: int,
) -> tuple[Integers, Floats, int]:  # fmt: skip
    """Number traces from the belt, the others by their order between them.

    Parameters
    ----------
    row_start, row, x_px
        Peaks by row, px.
    step_max_px, gap_rows
        See `linked_traces`.
    rest_px, line, live
        (stripe, row) rest lines, px; (peak,) the one a peak lies on, −1 for none; (stripe,) False for those
        that are not there.
    tolerance_px
        How far from its rest line a peak still is belt, px.
    px_per_mm
        (stripe,) displacement per height, px/mm.
    height_min_mm, height_max_mm
        Heights there may be, mm.
    rows_min
        Traces with fewer peaks are noise.
    margin_min
        A stripe with a smaller margin is refused.
    refused
        What is written for a refused peak.

    Returns
    -------
    tuple
        (peak,) stripe, −1 for noise, refused where those of a row do not increase; (peak,) margin, 0 where
        nothing decides; and the number of coded peaks.
    """
    trace, traces = linked_traces(row_start, x_px, step_max_px, gap_rows)
    piece, piece_line, order, start = cut_in_order(trace, line, traces, _BELT_ROWS_MIN, _FLICKER_ROWS)
    pieces = piece_line.shape[0]
    rows = rest_px.shape[1]
    of_label = np.flatnonzero(live)
    to_label = np.full(rest_px.shape[0], -1, np.int64)
    for i in range(of_label.size):
        to_label[of_label[i]] = i
    size = start[1:] - start[:-1]
    label = np.full(pieces, -1, np.int64)
    margin = np.zeros(pieces)
    used_piece = np.full(pieces, -1, np.int64)
    for f in range(pieces):
        first, last = row[order[start[f]]], row[order[start[f + 1] - 1]]
        anchored = piece_line[f] >= 0 and (first <= _END_ROWS or last >= rows - 1 - _END_ROWS)
        if anchored and to_label[piece_line[f]] >= 0:
            label[f], margin[f] = to_label[piece_line[f]], 1.0
        if size[f] >= rows_min or label[f] >= 0:
            used_piece[f] = f
    used = used_piece[piece]
    low, high = np.empty(of_label.size), np.empty(of_label.size)
    for i in range(of_label.size):
        one, other = px_per_mm[of_label[i]] * height_min_mm, px_per_mm[of_label[i]] * height_max_mm
        low[i], high[i] = min(one, other) - tolerance_px, max(one, other) + tolerance_px
    rest_live = np.ascontiguousarray(rest_px[of_label])
    for _ in range(_PASSES):
        if not np.any((used_piece >= 0) & (label < 0)):
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
    verdict = np.full(pieces, -1, np.int64)
    for f in range(pieces):
        if used_piece[f] >= 0:
            verdict[f] = of_label[label[f]] if label[f] >= 0 and margin[f] >= margin_min else refused
        else:
            margin[f] = 0.0
    stripe, sure = np.empty(row.size, np.int64), np.empty(row.size)
    for p in range(row.size):
        stripe[p], sure[p] = verdict[piece[p]], margin[piece[p]]
    return stripe, sure, refuse_disorder(row, stripe, refused)
