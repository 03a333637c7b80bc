"""Local polynomials along stripes that stop at breaks and steps, compiled."""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import kernel
from roemetry_kernels.extraction.local_least_squares import functional, nearest, too_much, variance_of
from roemetry_kernels.extraction.stripe_breaks import highest_step, leave_outliers_out

_FEW = 3


@kernel
def smoothed_run(
    row: Floats, x_px: Floats, std_px: Floats, rows: int, length: float, out_px: Floats, out_std_px: Floats
) -> int:
    """Smooth one unbroken piece of a stripe.

    Parameters
    ----------
    row, x_px, std_px
        (point,) row, increasing; position, px; its standard uncertainty, px.
    rows
        How many rows a line is put through.
    length
        Correlation of the errors along the stripe, rows, as in `Peaks.correlation_rows`.
    out_px, out_std_px
        (point,) become the smoothed positions, px, and their standard uncertainty, px.

    Returns
    -------
    int
        Number of steps that were found and kept.
    """
    n = row.shape[0]
    use = np.ones(n, np.bool_)
    leave_outliers_out(row, x_px, std_px, length, use)
    begin = np.zeros(n, np.int64)  # where the piece between steps that a point lies in begins, and ends
    end = np.full(n, n, np.int64)
    steps = 0
    for _ in range(n):
        at = highest_step(row, x_px, std_px, length, use, begin, end)
        if at < 0:
            break
        steps += 1
        first, last = begin[at], end[at]
        for i in range(first, at):
            end[i] = at
        for i in range(at, last):
            begin[i] = at
    weights, other = np.zeros(n), np.zeros(n)
    for i in range(n):
        out_px[i], out_std_px[i] = x_px[i], std_px[i]
        for way in range(3):
            # A line with the bend of a wider window; a parabola; a parabola over half of the rows.
            first, last = nearest(row, begin[i], end[i], i, rows if way < 2 else rows // 2 + 1)
            low, high = first, last
            if way == 0:
                low, high = nearest(row, begin[i], end[i], i, 2 * rows - 1)
            if not _weights(row, std_px, use, i, first, last, low, high, way == 0, weights, other):
                continue
            if way < 2 and _misfit(row, x_px, std_px, use, i, first, last, low, high, way == 0, other):
                continue
            if way == 2 and not use[i]:
                continue
            value = 0.0
            for j in range(low, high):
                value += weights[j] * x_px[j]
            out_px[i] = value
            out_std_px[i] = math.sqrt(variance_of(row, std_px, weights, low, high, length))
            break
    return steps


@kernel
def _weights(
    row: Floats,
    std_px: Floats,
    use: np.ndarray,
    i: int,
    first: int,
    last: int,
    low: int,
    high: int,
    line: bool,
    weights: Floats,
    other: Floats,
) -> bool:
    """Weights on the points low … high that give the position at point i."""
    for j in range(low, high):
        weights[j] = 0.0
    if not line:
        return functional(row, std_px, use, row[i], first, last, 3, -1, 0, weights)
    if not functional(row, std_px, use, row[i], first, last, 2, -1, 0, weights):
        return False
    bent = 0.0
    for j in range(first, last):
        bent += weights[j] * (row[j] - row[i]) ** 2
    if high - low > 2 * _FEW and functional(row, std_px, use, row[i], low, high, 3, -1, 2, other):
        for j in range(low, high):
            weights[j] -= bent * other[j]
    return True


@kernel
def _misfit(
    row: Floats,
    x_px: Floats,
    std_px: Floats,
    use: np.ndarray,
    i: int,
    first: int,
    last: int,
    low: int,
    high: int,
    line: bool,
    weights: Floats,
) -> bool:
    """Whether what is left of the points first … last is more than their uncertainty explains."""
    coefficients = np.zeros(3)
    for which in range(3):
        begin, end = (low, high) if line and which == 2 else (first, last)
        powers = 2 if line and which < 2 else 3
        if not functional(row, std_px, use, row[i], begin, end, powers, -1, which, weights):
            continue
        for j in range(begin, end):
            coefficients[which] += weights[j] * x_px[j]
    if line:
        # The line is put through what the bend leaves.
        for which in range(2):
            functional(row, std_px, use, row[i], first, last, 2, -1, which, weights)
            for j in range(first, last):
                coefficients[which] -= weights[j] * coefficients[2] * (row[j] - row[i]) ** 2
    return too_much(row, x_px, std_px, use, row[i], first, last, coefficients)
