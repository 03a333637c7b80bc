"""Least squares that let single places go their own way: Cauchy's weights, reweighted round by round.

It assumes that most places follow the terms, for the scatter is told by a median. It fails where more than
half of them go their own way.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.image_levels import median_of


@float_kernel
def robust_fit(
    rows: Floats, wanted: Floats, base: Floats, ridge: Floats, least: float, rounds: int
) -> tuple[Floats, Floats, Floats]:
    """Fit Σ c·rows to the values that are wanted (Holland and Welsch 1977).

    Parameters
    ----------
    rows : ndarray, shape (k, n)
        Every term at every place.
    wanted, base : ndarray, shape (n,)
        Values, and the weights they begin with.
    ridge : ndarray, shape (k,)
        Added to the diagonal of the normal equations.
    least
        The scatter is taken to be at least that, so that weights do not follow what is finer.
    rounds
        Of reweighting.

    Returns
    -------
    fit : ndarray, shape (k,)
        The terms' coefficients.
    weight : ndarray, shape (n,)
        Weights after the last round.
    off : ndarray, shape (n,)
        What is wanted less what is fitted.
    """
    terms, count = rows.shape
    weight, off, fit = base.copy(), np.empty(count), np.empty(terms)
    normal, weighed = np.empty((terms, terms)), np.empty(count)
    for _ in range(rounds):
        for a in range(terms):
            right = 0.0
            for k in range(count):
                weighed[k] = weight[k] * rows[a, k]
                right += weighed[k] * wanted[k]
            fit[a] = right
            for b in range(a + 1):
                total = ridge[a] if a == b else 0.0
                for k in range(count):
                    total += weighed[k] * rows[b, k]
                normal[a, b] = total
        solve(normal, fit)
        off = wanted - fit[0] * rows[0]
        for a in range(1, terms):
            off -= fit[a] * rows[a]
        # 1.4826: from a median to a standard deviation
        scatter = max(1.4826 * median_of(np.abs(off)), least)
        # a half at two standard deviations
        weight = base / (1.0 + (off / (2.0 * scatter)) ** 2)
    return fit, weight, off


@float_kernel
def solve(normal: Floats, right: Floats) -> None:
    """Solve positive definite equations by Cholesky's factors of the lower triangle; both are overwritten."""
    count = right.size
    # row by row the factor L, and y of L y = right
    for a in range(count):
        for b in range(a + 1):
            rest = normal[a, b]
            for c in range(b):
                rest -= normal[a, c] * normal[b, c]
            normal[a, b] = np.sqrt(rest) if a == b else rest / normal[b, b]
        for c in range(a):
            right[a] -= normal[a, c] * right[c]
        right[a] /= normal[a, a]
    # then x of L′ x = y
    for a in range(count - 1, -1, -1):
        for c in range(a + 1, count):
            right[a] -= normal[c, a] * right[c]
        right[a] /= normal[a, a]
