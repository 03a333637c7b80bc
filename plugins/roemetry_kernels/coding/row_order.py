"""Stripes of a row's peaks by their order, where some peaks are missing and some are false."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_FAR = 1e9
_STEP_MAX = 1.0
"""A step of the surface between two stripes costs at most this, in label heights."""
_SKIP = 0.6
"""A stripe that is not seen costs this."""
_FALSE = 1.6
"""A peak that is no stripe costs this."""
_REST = 0.3
"""A peak on the belt, on its own rest line, gains this."""
_LOOK_BACK = 3
DEAREST = 2.0 * _SKIP
"""A verdict is dearer than another by this at most: one stripe put in another place and one left out."""


@kernel
def order_rows(
    row_start: Integers,
    x_px: Floats,
    rest_px: Floats,
    live: Flags,
    px_per_mm: Floats,
    height_min_mm: float,
    height_max_mm: float,
    tolerance_px: float,
) -> tuple[Integers, Floats]:
    """Give each row's peaks strictly increasing stripes at the least cost.

    The cost, in heights that a displacement of one stripe spacing stands for: the surface's step from each
    peak to the next, up to one; for each stripe left out; for each peak left out; a gain on the belt.

    Parameters
    ----------
    row_start, x_px
        Peaks by row, px.
    rest_px
        (stripe, row) rest lines, px, increasing with the stripe.
    live
        (stripe,) False for stripes that are not there at all.
    px_per_mm
        (stripe,) displacement per height, px/mm.
    height_min_mm, height_max_mm
        Heights there may be, mm.
    tolerance_px
        How far from its rest line a peak still is belt, px.

    Returns
    -------
    tuple
        (peak,) stripe, −1 for a peak left out; and (peak,) cost by which the row would be dearer if this peak
        had another verdict.
    """
    of_label = np.flatnonzero(live)
    labels = of_label.size
    most = 0
    for row in range(row_start.shape[0] - 1):
        most = max(most, row_start[row + 1] - row_start[row])
    stripe = np.full(x_px.shape[0], -1, np.int64)
    margin = np.zeros(x_px.shape[0])
    if labels == 0 or most == 0:
        return stripe, margin
    # Displacements there may be, and the way that higher points go: the same in every row.
    low, high, way = np.empty(labels), np.empty(labels), np.empty(labels)
    for i in range(labels):
        steep = px_per_mm[of_label[i]]
        one, other = steep * height_min_mm, steep * height_max_mm
        low[i], high[i] = min(one, other) - tolerance_px, max(one, other) + tolerance_px
        way[i] = 1.0 if steep > 0.0 else -1.0
    height = np.empty((most, labels))
    own = np.empty((most, labels))
    first = np.empty(most, np.int64)
    last = np.empty(most, np.int64)
    forward = np.empty((most, labels))
    backward = np.empty((most, labels))
    for row in range(row_start.shape[0] - 1):
        begin = row_start[row]
        count = row_start[row + 1] - begin
        if count == 0:
            continue
        spacing = 1.0
        if labels > 1:
            spacing = (rest_px[of_label[-1], row] - rest_px[of_label[0], row]) / (labels - 1)
        if count == labels and _in_full(
            x_px[begin : begin + count], rest_px[:, row], of_label, low, high, way, 0.5 * spacing
        ):
            for k in range(count):
                stripe[begin + k] = of_label[k]
                margin[begin + k] = DEAREST
            continue
        for k in range(count):
            first[k], last[k] = labels, -1
            for i in range(labels):
                off = x_px[begin + k] - rest_px[of_label[i], row]
                if off < low[i] or off > high[i]:
                    continue
                first[k] = min(first[k], i)
                last[k] = i
                height[k, i] = way[i] * off / spacing
                own[k, i] = -_REST if abs(off) <= tolerance_px else 0.0
        _least(height, own, first, last, count, labels, forward, backward)
        _verdicts(forward, backward, own, first, last, count, labels, of_label, begin, stripe, margin)
    return stripe, margin


@kernel
def _in_full(
    x_px: Floats, rest_px: Floats, of_label: Integers, low: Floats, high: Floats, way: Floats, step_px: float
) -> bool:
    """Say whether all stripes are there and the surface goes from each to the next without a large step."""
    before = 0.0
    for k in range(of_label.size):
        off = x_px[k] - rest_px[of_label[k]]
        if off < low[k] or off > high[k] or (k and abs(way[k] * off - before) > step_px):
            return False
        before = way[k] * off
    return True


@kernel
def _least(
    height: Floats, own: Floats, first: Integers, last: Integers, count: int, labels: int,
    forward: Floats, backward: Floats,
) -> None:  # fmt: skip
    """Write the least cost of all up to, and from, each peak with each stripe, both with its own."""
    for k in range(count):
        for i in range(first[k], last[k] + 1):
            best = i * _SKIP + k * _FALSE
            for q in range(max(0, k - _LOOK_BACK), k):
                for j in range(first[q], min(last[q], i - 1) + 1):
                    step = min(abs(height[k, i] - height[q, j]), _STEP_MAX)
                    best = min(best, forward[q, j] + step + (i - j - 1) * _SKIP + (k - q - 1) * _FALSE)
            forward[k, i] = best + own[k, i]
    for k in range(count - 1, -1, -1):
        for i in range(first[k], last[k] + 1):
            best = (labels - 1 - i) * _SKIP + (count - 1 - k) * _FALSE
            for q in range(k + 1, min(count, k + 1 + _LOOK_BACK)):
                for j in range(max(first[q], i + 1), last[q] + 1):
                    step = min(abs(height[k, i] - height[q, j]), _STEP_MAX)
                    best = min(best, backward[q, j] + step + (j - i - 1) * _SKIP + (q - k - 1) * _FALSE)
            backward[k, i] = best + own[k, i]


@kernel
def _verdicts(
    forward: Floats, backward: Floats, own: Floats, first: Integers, last: Integers, count: int, labels: int,
    of_label: Integers, begin: int, stripe: Integers, margin: Floats,
) -> None:  # fmt: skip
    """Walk back along the cheapest row, and compare each of its peaks with the next best verdict."""
    whole = labels * _SKIP + count * _FALSE
    for k in range(count):
        for i in range(first[k], last[k] + 1):
            whole = min(whole, forward[k, i] + backward[k, i] - own[k, i])
    for k in range(count):
        best, second, mine = _FAR, _FAR, -1
        for i in range(first[k], last[k] + 1):
            cost = forward[k, i] + backward[k, i] - own[k, i]
            if cost < best:
                best, second, mine = cost, best, i
            else:
                second = min(second, cost)
        if mine >= 0 and best <= whole + 1e-9:
            stripe[begin + k] = of_label[mine]
            margin[begin + k] = min(second - best, DEAREST)


@kernel
def refuse_doubtful(
    row: Integers, x_px: Floats, stripe: Integers, dearer: Floats, stripes: int, step_max_px: float,
    dearer_min: float, refused: int,
) -> int:  # fmt: skip
    """Refuse coded peaks that another verdict suits as well or that stand alone; gives how many stay coded.

    Parameters
    ----------
    row, x_px, stripe
        (peak,) sorted by row; `stripe` below 0 is not coded; changed.
    dearer
        (peak,) see `order_rows`.
    stripes
        Number of stripes.
    step_max_px
        A peak stands alone without a peak of its stripe within the next three rows up or down, not farther
        away than this from row to row, px.
    dearer_min
        Another verdict suits as well if it is dearer by less.
    refused
        What is written for a refused peak.
    """
    last = np.full(stripes, -1, np.int64)
    found = np.zeros(row.shape[0], np.bool_)
    for p in range(row.shape[0]):
        s = stripe[p]
        if s < 0:
            continue
        q = last[s]
        if q >= 0 and 0 < row[p] - row[q] <= 3 and abs(x_px[p] - x_px[q]) <= step_max_px * (row[p] - row[q]):
            found[p] = found[q] = True
        last[s] = p
    coded = 0
    for p in range(row.shape[0]):
        if stripe[p] >= 0 and not (found[p] and dearer[p] >= dearer_min):
            stripe[p] = refused
        coded += stripe[p] >= 0
    return coded
