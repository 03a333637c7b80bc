"""Verdicts that stand against each other: where pieces of traces contradict, both are in doubt."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.coding.label_pieces import ENDS
from roemetry_kernels.compiling import kernel

_MUCH_LARGER = 3
"""Of two pieces that contradict each other, one so many times as large is believed."""
_GOES_ON_SPACINGS = 0.3
_ASIDE_SPACINGS = 0.5
_FEW_PEAKS = 4
"""A piece of fewer says nothing about where its stripe goes on."""


@kernel
def claimed(
    trace: Integers, piece: Integers, piece_line: Integers, stripe: Integers, settled: Floats, stripes: int,
    peaks_min: int,
) -> Integers:  # fmt: skip
    """Give (peak,) stripes, with the one that its piece has elsewhere for peaks that are none.

    A piece that is a stripe on some lines, and left out on others, was left out for the sake of another: one
    of the two is wrong. An end of which nothing is settled is claimed for the stripe that its trace is.

    Parameters
    ----------
    trace, piece, piece_line
        (peak,) trace, and piece of it; (piece,) rest line that it follows, `ENDS` for ends.
    stripe, settled
        (peak,) stripe, below 0 for none; see `ends_settled`.
    stripes
        Number of stripes.
    peaks_min
        A piece with so many peaks of one stripe claims it.
    """
    votes = np.zeros((piece_line.shape[0], stripes), np.int64)
    of_trace = np.zeros((trace.max() + 1, stripes), np.int64)
    for p in range(piece.shape[0]):
        if stripe[p] >= 0:
            votes[piece[p], stripe[p]] += 1
            of_trace[trace[p], stripe[p]] += piece_line[piece[p]] != ENDS
    found = stripe.copy()
    for p in range(piece.shape[0]):
        if settled[p] > 0.0 and stripe[p] >= 0:
            continue
        asked = of_trace[trace[p]] if piece_line[piece[p]] == ENDS else votes[piece[p]]
        s = np.argmax(asked)
        if asked[s] >= peaks_min:
            found[p] = s
    return found


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


@kernel
def interjected(trace: Integers, piece: Integers, piece_line: Integers, stripe: Integers) -> Flags:
    """Mark peaks of a piece between two of its trace that are both one other stripe's body.

    Parameters
    ----------
    trace, piece
        (peak,) trace and piece, peaks sorted by row.
    piece_line
        (piece,) its rest line, `ENDS` for ends, which are looked over.
    stripe
        (peak,) stripe, below 0 for none.
    """
    pieces = piece_line.shape[0]
    voted, votes = np.full(pieces, -1, np.int64), np.zeros(pieces, np.int64)
    for p in range(piece.shape[0]):
        f = piece[p]
        if stripe[p] >= 0:
            if votes[f] == 0:
                voted[f] = stripe[p]
            votes[f] += 1 if voted[f] == stripe[p] else -1
    before, after = np.full(pieces, -1, np.int64), np.full(pieces, -1, np.int64)
    last = np.full(trace.max() + 1, -1, np.int64)
    for p in range(piece.shape[0]):
        f, q = piece[p], last[trace[p]]
        if piece_line[f] == ENDS or voted[f] < 0 or q == f:
            continue
        if q >= 0:
            before[f], after[q] = q, f
        last[trace[p]] = f
    found = np.zeros(piece.shape[0], np.bool_)
    for p in range(piece.shape[0]):
        f = piece[p]
        a, b = before[f], after[f]
        if piece_line[f] == ENDS or a < 0 or b < 0 or voted[a] != voted[b]:
            continue
        body = piece_line[a] != voted[a] or piece_line[b] != voted[b]
        found[p] = stripe[p] >= 0 and body and stripe[p] != voted[a]
    return found


@kernel
def aside(
    row: Integers, x_px: Floats, line: Integers, piece: Integers, stripe: Integers, spacing_px: float
) -> Flags:
    """Mark pieces of a body that stand far beside where their stripe goes on after them, as it was before.

    Parameters
    ----------
    row, x_px, line, piece, stripe
        (peak,) row, sorted, and place, px; rest line it lies on, −1 for none; piece of its trace; stripe,
        below 0 for none.
    spacing_px
        Distance of the rest lines, px.
    """
    pieces, stripes = piece.max() + 1, stripe.max() + 1
    size = np.zeros(pieces, np.int64)
    first_px, last_px = np.zeros(pieces), np.zeros(pieces)
    own = np.full(pieces, -1, np.int64)
    before, after = np.full(pieces, -1, np.int64), np.full(pieces, -1, np.int64)
    last = np.full(stripes + 1, -1, np.int64)
    for p in range(row.shape[0]):
        s, f = stripe[p], piece[p]
        if s < 0 or line[p] == s or (own[f] >= 0 and own[f] != s):
            continue
        if own[f] < 0:
            own[f], first_px[f] = s, x_px[p]
            before[f] = last[s]
            if last[s] >= 0:
                after[last[s]] = f
            last[s] = f
        last_px[f] = x_px[p]
        size[f] += 1
    found = np.zeros(pieces, np.bool_)
    for f in range(pieces):
        a, b = before[f], after[f]
        if a < 0 or b < 0 or min(size[a], size[b]) < _FEW_PEAKS:
            continue
        one, other = first_px[f] - last_px[a], last_px[f] - first_px[b]
        goes_on = abs(first_px[b] - last_px[a]) <= _GOES_ON_SPACINGS * spacing_px
        found[f] = goes_on and min(abs(one), abs(other)) > _ASIDE_SPACINGS * spacing_px
    return found[piece]


@kernel
def broken_off(
    start: Integers, peak: Integers, before: Integers, tie: Floats, piece: Integers, stripe: Integers,
    tie_whole: float, tie_min: float, lines_max: int,
) -> Flags:  # fmt: skip
    """Mark pieces that go on exactly where another ended, a line or few before, as another stripe.

    Of two such pieces the much smaller one is marked, else both.

    Parameters
    ----------
    start, peak, before, tie
        See `roemetry_kernels.coding.sight_entries.Entries`.
    piece, stripe
        (peak,) piece of its trace; stripe, below 0 for none.
    tie_whole
        The tie within a piece.
    tie_min
        The tie, over a gap, of two that fit.
    lines_max
        Longest gap, lines.
    """
    size = np.bincount(piece)
    doubt = np.zeros(size.shape[0], np.bool_)
    line = np.empty(peak.shape[0], np.int64)
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            line[i] = e
            j = before[i]
            if j < 0 or not tie_min <= tie[i] < tie_whole or e - line[j] > lines_max:
                continue
            f, g = piece[peak[i]], piece[peak[j]]
            if f == g or min(stripe[peak[i]], stripe[peak[j]]) < 0 or stripe[peak[i]] == stripe[peak[j]]:
                continue
            doubt[f] = doubt[f] or size[f] < _MUCH_LARGER * size[g]
            doubt[g] = doubt[g] or size[g] < _MUCH_LARGER * size[f]
    return doubt[piece]


@kernel
def left_over(piece: Integers, stripe: Integers, kept: Integers, share_min: float) -> Flags:
    """Mark coded peaks of pieces of which most others were refused: the doubt is the whole piece's.

    Parameters
    ----------
    piece
        (peak,) piece of its trace.
    stripe, kept
        (peak,) stripe before and after refusing, below 0 for none.
    share_min
        Share of a piece's peaks that must be left.
    """
    before, after = np.zeros(piece.max() + 1, np.int64), np.zeros(piece.max() + 1, np.int64)
    for p in range(piece.shape[0]):
        before[piece[p]] += stripe[p] >= 0
        after[piece[p]] += kept[p] >= 0
    found = np.zeros(piece.shape[0], np.bool_)
    for p in range(piece.shape[0]):
        found[p] = kept[p] >= 0 and after[piece[p]] < share_min * before[piece[p]]
    return found
