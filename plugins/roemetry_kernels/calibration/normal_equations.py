"""Normal equations of least squares whose rows touch few of the parameters each."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel


@kernel
def add_rows(
    columns: Integers, values: Floats, residual: Floats, weight: Floats, normal: Floats, gradient: Floats
) -> None:
    """Add rows of a sparse Jacobian to JᵀWJ and JᵀWr.

    Parameters
    ----------
    columns
        (row, k) which parameter each value belongs to; −1 for none.
    values
        (row, k) derivatives.
    residual, weight
        (row,) of each row.
    normal, gradient
        (n, n) and (n,); added to. Of `normal` the lower triangle alone.
    """
    for row in range(columns.shape[0]):
        w = weight[row]
        if w == 0.0:
            continue
        for i in range(columns.shape[1]):
            a = columns[row, i]
            if a < 0:
                continue
            scaled = w * values[row, i]
            gradient[a] += scaled * residual[row]
            for j in range(columns.shape[1]):
                b = columns[row, j]
                if 0 <= b <= a:
                    normal[a, b] += scaled * values[row, j]


@kernel
def row_variances(columns: Integers, values: Floats, covariance: Floats) -> Floats:
    """Give (row,) J C Jᵀ: the variance of what each row predicts, C being the parameters' covariance."""
    found = np.zeros(columns.shape[0])
    for row in range(columns.shape[0]):
        total = 0.0
        for i in range(columns.shape[1]):
            a = columns[row, i]
            if a < 0:
                continue
            for j in range(columns.shape[1]):
                b = columns[row, j]
                if b >= 0:
                    total += values[row, i] * covariance[a, b] * values[row, j]
        found[row] = total
    return found
