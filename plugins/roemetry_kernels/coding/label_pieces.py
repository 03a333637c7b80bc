"""Pieces of traces: their ends, what is known of them."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

ENDS = -2
"""Rest line of the ends that were cut off: not known."""
_AMID_SHARE = 0.5
"""What lies on a rest line amid the image only, and is shorter, may be the neighbour's body."""


@kernel
def between_bare(row: Integers, line: Integers, stripes: int, rows: int, rows_min: int) -> Flags:
    """Mark peaks on a rest line where the rest lines on either side show nothing.

    What hides both may lie under this one, too, displaced by just a whole spacing.

    Parameters
    ----------
    row, line
        (peak,) row; rest line it lies on, −1 for none.
    stripes, rows
        Number of rest lines and of image rows.
    rows_min
        A rest line is bare where nothing lies on it for so many rows on end.
    """
    bare = np.zeros((stripes, rows), np.bool_)
    last = np.full(stripes, -1, np.int64)
    for p in range(row.shape[0] + stripes):
        r = row[p] if p < row.shape[0] else rows
        s = line[p] if p < row.shape[0] else p - row.shape[0]
        if s < 0:
            continue
        if r - last[s] > rows_min:
            bare[s, last[s] + 1 : r] = True
        last[s] = r
    found = np.zeros(row.shape[0], np.bool_)
    for p in range(row.shape[0]):
        s = line[p]
        if 0 < s < stripes - 1:
            found[p] = bare[s - 1, row[p]] and bare[s + 1, row[p]]
    return found


@kernel
def end_pieces(
    row: Integers, piece: Integers, line: Integers, rows: int, end_rows: int, border_rows: int
) -> tuple[Integers, Integers, Flags, Integers]:
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
        a piece that reaches the image's border; (piece,) the rest line it was, or was cut off from.
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
    anchored, home = np.zeros(3 * pieces, np.bool_), np.empty(3 * pieces, np.int64)
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
            home[count] = line[f]
            anchored[count] = part == 0 and (first[f] <= border_rows or last[f] >= rows - 1 - border_rows)
            count += 1
        found[p] = number[f, part]
    return found, on[:count].copy(), anchored[:count].copy(), home[:count].copy()


@kernel
def presence_of(
    line: Floats, piece: Integers, piece_line: Integers, enters: Floats, leaves: Floats, lines: int,
    rows_full: int, rows_min: int, end_lines: int, lost: float,
) -> Floats:  # fmt: skip
    """Give (line, stripe) how surely a stripe's belt is there to be seen, 0 to 1.

    Parameters
    ----------
    line
        (peak,) see `roemetry_kernels.coding.sight_lines`.
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
        amid = first[s] - low > end_lines and high - last[s] > end_lines
        if amid and seen[s] < _AMID_SHARE * (high - low):
            continue
        for e in range(lines):
            off = (e < first[s] and first[s] - low > end_lines) or (
                e > last[s] and high - last[s] > end_lines
            )
            presence[e, s] = min(seen[s] / rows_full, 1.0) * (lost if off else 1.0)
    return presence


@kernel
def own_costs(
    peak: Integers, low: Integers, count: Integers, offset: Integers, peak_line: Integers, piece: Integers,
    piece_line: Integers, anchored: Flags, there: Floats, false_peak: float, on_rest: float, long_run: float,
    anchor: float, on_end: float, absent: float, run_rows: tuple[int, int],
) -> Floats:  # fmt: skip
    """Give (node,) costs of a node by itself.

    Parameters
    ----------
    peak, low, count, offset
        See `roemetry_kernels.coding.label_costs`.
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
    on_rest, long_run, anchor, on_end
        Gain of lying on the stripe's rest line, of doing so in a long run, in one from the border on, and in
        an end that was cut off.
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
                own[node] -= on_end if piece_line[piece[p]] == ENDS else on_rest
                if piece_line[piece[p]] == s:
                    own[node] -= long_run * min(max(long, 0.0), 1.0)
                    if anchored[piece[p]]:
                        own[node] -= anchor * min(rows[piece[p]] / run_rows[0], 1.0)
            own[node] += absent * (1.0 - min(1.0, 5.0 * there[s]))
        own[offset[i + 1] - 1] = false_peak
    return own
