"""Levels of a slice: runs of points of one height."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel

_LEVEL, _FEW = 5, 3  # points of a level at least; points together that end it, single ones are noise


@kernel
def levels(z_mm: Floats, within_mm: float, tilt_mm: float) -> Integers:
    """Give the first and the last point of each level; what rises or falls evenly is none.

    Parameters
    ----------
    z_mm : ndarray, shape (n,)
        Heights along a slice.
    within_mm
        By how much a level's points lie off the median of its first five.
    tilt_mm
        By how much the medians of its two halves differ.

    Returns
    -------
    ndarray of int64, shape (levels, 2)
    """
    n = z_mm.size
    found = np.empty((n // _LEVEL + 1, 2), np.int64)
    count, begin = 0, 0
    while begin < n:
        height = np.median(z_mm[begin : min(begin + _LEVEL, n)])
        size, off = n - begin, 0
        for k in range(begin, n):
            off = off + 1 if abs(z_mm[k] - height) > within_mm else 0
            if off == _FEW:
                size = k - begin + 1 - _FEW
                break
        if size >= _LEVEL:
            half = size // 2
            run = z_mm[begin : begin + size]
            if abs(np.median(run[size - half :]) - np.median(run[:half])) < tilt_mm:
                found[count, 0], found[count, 1] = begin, begin + size - 1
                count += 1
        begin += max(size, 1)
    return found[:count]
