"""Steps and outliers along a stripe, compiled."""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.extraction.local_least_squares import functional, nearest, too_much, variance_of

_STEP_REACH = 8  # rows on either side that a step is judged by
_STEP_STDS = 4.0  # a step is one if it is so many standard deviations high
_OUTLIER_STDS = 4.5  # a row is left out if it is so far from what its neighbours foretell
_FEW = 3


@kernel
def highest_step(
    row: Floats,
    x_px: Floats,
    std_px: Floats,
    length: float,
    use: np.ndarray,
    begin: Integers,
    end: Integers,
) -> int:
    """First point behind the most certain step, or −1: a step beside a cubic over 8 rows on both sides."""
    best, at = _STEP_STDS, -1
    weights = np.zeros(row.shape[0])
    for i in range(1, row.shape[0]):
        if begin[i] == i:
            continue
        first, last = i, i
        while first > begin[i] and row[i] - row[first - 1] <= _STEP_REACH:
            first -= 1
        while last < end[i] and row[last] - row[i] < _STEP_REACH:
            last += 1
        few = min(i - first, last - i)
        if few < _FEW:
            continue
        # As many on either side: so a bend, which is even, is not taken for a step, which is odd.
        first, last = i - few, i + few
        powers = 4 if few > _FEW + 1 else 2
        if not functional(row, std_px, use, row[i], first, last, powers, i, powers, weights):
            continue
        height = 0.0
        for j in range(first, last):
            height += weights[j] * x_px[j]
        variance = variance_of(row, std_px, weights, first, last, 0.0)
        if height * height <= best * best * variance:
            continue
        # Correlation, which costs more to count, only makes a step less certain.
        variance = max(variance, variance_of(row, std_px, weights, first, last, length))
        if height * height > best * best * variance:
            best, at = abs(height) / math.sqrt(variance), i
    return at


@kernel
def leave_outliers_out(row: Floats, x_px: Floats, std_px: Floats, length: float, use: np.ndarray) -> None:
    """Mark points that a cubic through the others does not foretell while it fits these.

    A point beside a step has one neighbour that it is like; an outlier has none.
    """
    n = row.shape[0]
    weights = np.zeros(n)
    for i in range(n):
        first, last = nearest(row, 0, n, i, 2 * _STEP_REACH + 1)
        if last - first < 2 * _FEW + 2:
            continue
        use[i] = False
        if functional(row, std_px, use, row[i], first, last, 4, -1, 0, weights):
            foretold = 0.0
            for j in range(first, last):
                foretold += weights[j] * x_px[j]
            limit = _OUTLIER_STDS * std_px[i]
            alone = i == 0 or abs(x_px[i] - x_px[i - 1]) > 0.5 * limit
            alone = alone and (i == n - 1 or abs(x_px[i] - x_px[i + 1]) > 0.5 * limit)
            if (
                alone
                and abs(x_px[i] - foretold) > limit
                and _fits(row, x_px, std_px, use, row[i], first, last)
            ):
                variance = variance_of(row, std_px, weights, first, last, length) + std_px[i] ** 2
                if abs(x_px[i] - foretold) > _OUTLIER_STDS * math.sqrt(variance):
                    continue
        use[i] = True


@kernel
def _fits(
    row: Floats, x_px: Floats, std_px: Floats, use: np.ndarray, centre: float, first: int, last: int
) -> bool:
    """Whether a cubic leaves of the points no more than their uncertainty explains."""
    weights = np.zeros(row.shape[0])
    coefficients = np.zeros(4)
    for which in range(4):
        if not functional(row, std_px, use, centre, first, last, 4, -1, which, weights):
            return False
        for j in range(first, last):
            coefficients[which] += weights[j] * x_px[j]
    return not too_much(row, x_px, std_px, use, centre, first, last, coefficients)
