"""The cheapest closed path around a strip of costs, by dynamic programming."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel


@kernel
def closed_path(cost: Floats, bend: float, most: int) -> Integers:
    """Find the path of least cost once around.

    Parameters
    ----------
    cost : ndarray, shape (n, m)
        Cost of each of m places on each of n rays; the last ray lies beside the first.
    bend
        Cost of a step from ray to ray, times its square.
    most
        Largest step, places.

    Returns
    -------
    ndarray of int64, shape (n,)
        Place on each ray. The path is followed twice around and the middle of it taken, whose ends meet
        unless two paths cost alike; then they differ by at most `most` places.
    """
    n, m = cost.shape
    total = np.empty((2 * n, m))
    came = np.zeros((2 * n, m), np.int64)
    total[0] = cost[0]
    for k in range(1, 2 * n):
        for j in range(m):
            best, place = np.inf, j
            for i in range(max(j - most, 0), min(j + most, m - 1) + 1):
                way = total[k - 1, i] + bend * (i - j) ** 2
                if way < best:
                    best, place = way, i
            total[k, j] = best + cost[k % n, j]
            came[k, j] = place
    path = np.empty(2 * n, np.int64)
    path[2 * n - 1] = np.argmin(total[2 * n - 1])
    for k in range(2 * n - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    half = n // 2
    out = np.empty(n, np.int64)
    for k in range(n):
        out[k] = path[k + n] if k < half else path[k]
    return out
