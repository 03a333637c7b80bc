"""Least squares along a stripe, compiled: weights on points that give a coefficient, and what they leave."""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import kernel

_CORRELATED = 4.0  # lengths beyond which errors count as independent
_MISFIT_STDS = 4.0  # squares are too much if they exceed their expectation by so many standard deviations


@kernel
def nearest(row: Floats, begin: int, end: int, i: int, rows: int) -> tuple[int, int]:
    """Points of a window of `rows` rows around point i, moved inwards at the ends of its piece."""
    half = rows // 2
    top, bottom = row[i] - half, row[i] + half
    if top < row[begin]:
        bottom += row[begin] - top
        top = row[begin]
    if bottom > row[end - 1]:
        top = max(top - (bottom - row[end - 1]), row[begin])
        bottom = row[end - 1]
    first, last = i, i + 1
    while first > begin and row[first - 1] >= top:
        first -= 1
    while last < end and row[last] <= bottom:
        last += 1
    return first, last


@kernel
def functional(
    row: Floats,
    std_px: Floats,
    use: np.ndarray,
    centre: float,
    first: int,
    last: int,
    powers: int,
    step_at: int,
    which: int,
    weights: Floats,
) -> bool:
    """Weights on points that give one coefficient of a polynomial, with a step from point `step_at` on.

    Rows are counted from `centre`. Writes ``weights[first:last]``; False where the points do not suffice.
    """
    size = powers + (1 if step_at >= 0 else 0)
    scale = max(abs(row[first] - centre), abs(row[last - 1] - centre), 1.0)
    normal = np.zeros((5, 6))
    basis = np.empty(5)
    count = 0
    for j in range(first, last):
        weights[j] = 0.0
        if not use[j]:
            continue
        count += 1
        _basis((row[j] - centre) / scale, powers, step_at >= 0, j >= step_at, basis)
        w = 1.0 / (std_px[j] * std_px[j])
        for k in range(size):
            for m in range(size):
                normal[k, m] += w * basis[k] * basis[m]
    if count < size:
        return False
    normal[which, 5] = 1.0
    for k in range(size):
        pivot = k
        for m in range(k + 1, size):
            if abs(normal[m, k]) > abs(normal[pivot, k]):
                pivot = m
        if abs(normal[pivot, k]) < 1e-10 * abs(normal[0, 0]) or normal[pivot, k] == 0.0:
            return False
        for m in range(6):
            normal[k, m], normal[pivot, m] = normal[pivot, m], normal[k, m]
        for m in range(size):
            if m != k:
                factor = normal[m, k] / normal[k, k]
                for c in range(k, 6):
                    normal[m, c] -= factor * normal[k, c]
    unit = scale ** (-which) if which < powers else 1.0
    for j in range(first, last):
        if use[j]:
            _basis((row[j] - centre) / scale, powers, step_at >= 0, j >= step_at, basis)
            total = 0.0
            for k in range(size):
                total += basis[k] * normal[k, 5] / normal[k, k]
            weights[j] = unit * total / (std_px[j] * std_px[j])
    return True


@kernel
def _basis(t: float, powers: int, stepped: bool, behind: bool, basis: Floats) -> None:
    value = 1.0
    for k in range(powers):
        basis[k] = value
        value *= t
    if stepped:
        basis[powers] = 1.0 if behind else 0.0


@kernel
def variance_of(row: Floats, std_px: Floats, weights: Floats, low: int, high: int, length: float) -> float:
    """Variance of a weighted sum of points whose errors correlate by exp(−Δ²/(4 length²)), px²."""
    total = 0.0
    for j in range(low, high):
        own = weights[j] * std_px[j]
        total += own * own
        if length <= 0.0:
            continue
        for k in range(j + 1, high):
            off = row[k] - row[j]
            if off > _CORRELATED * length + 1.0:
                break
            total += 2.0 * own * weights[k] * std_px[k] * math.exp(-off * off / (4.0 * length * length))
    return max(total, 0.0)


@kernel
def too_much(
    row: Floats,
    x_px: Floats,
    std_px: Floats,
    use: np.ndarray,
    centre: float,
    first: int,
    last: int,
    coefficients: Floats,
) -> bool:
    """Whether what a polynomial leaves of the points is more than their uncertainty explains."""
    squares, count = 0.0, 0
    for j in range(first, last):
        if use[j]:
            t = row[j] - centre
            off = x_px[j]
            power = 1.0
            for k in range(coefficients.shape[0]):
                off -= coefficients[k] * power
                power *= t
            squares += (off / std_px[j]) ** 2
            count += 1
    free = max(count - coefficients.shape[0] + 1, 1)
    return squares > free + _MISFIT_STDS * math.sqrt(2.0 * free)
