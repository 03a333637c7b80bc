"""The light beside stripes as a straight line, pooled along each stripe, compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roemetry.arrays import Floats, Integers

_STEP_PX = 3.0  # farthest from row to row along one stripe
_CLEAR = 3.6  # standard deviations beyond which a stripe's own light does not count
_SIDE_PX = 8.0  # pixels taken on either side
_HOT = 6.0  # a pixel so many standard deviations above the others of its side is left out

Pixels = NDArray[Any]


@njit(cache=True, nogil=True)
def neighbours(row: Integers, x_px: Floats) -> tuple[Integers, Integers]:
    """Link each peak with the nearest one of the next row, where that is mutual and within 3 px.

    Parameters
    ----------
    row, x_px
        (peak,) sorted by row, then x; px.

    Returns
    -------
    tuple
        (peak,) index of the same stripe's peak in the row above and in the row below; −1 for none.
    """
    peaks = row.shape[0]
    up = np.full(peaks, -1, np.int64)
    down = np.full(peaks, -1, np.int64)
    q = 0
    for p in range(peaks):
        while q < peaks and (row[q] < row[p] + 1 or (row[q] == row[p] + 1 and x_px[q] < x_px[p])):
            q += 1
        best, off = -1, _STEP_PX
        for other in (q - 1, q):
            if 0 <= other < peaks and row[other] == row[p] + 1 and abs(x_px[other] - x_px[p]) <= off:
                best, off = other, abs(x_px[other] - x_px[p])
        if best < 0:
            continue
        if up[best] < 0:
            up[best], down[p] = p, best
        elif abs(x_px[up[best]] - x_px[best]) > off:
            down[up[best]] = -1
            up[best], down[p] = p, best
    return up, down


@njit(cache=True, nogil=True)
def pooled(values: Floats, up: Integers, down: Integers, reach: int) -> Floats:
    """Sum (peak, value) over the peaks of the same stripe at most `reach` rows away."""
    peaks, columns = values.shape
    total = values.copy()
    for p in range(peaks):
        for link in (up, down):
            q = p
            for _ in range(reach):
                q = link[q]
                if q < 0:
                    break
                for k in range(columns):
                    total[p, k] += values[q, k]
    return total


@njit(cache=True, nogil=True)
def beside(
    image: Pixels,
    row: Integers,
    x_px: Floats,
    sigma_px: Floats,
    amplitude: Floats,
    level: Floats,
    noise: float,
    gain: float,
) -> Floats:
    """Sums of the pixels on both sides of each peak, for a straight line through them.

    Pixels nearer to a neighbour than 3.6 of its standard deviations do not count either. Where stripes are
    so near that less than three pixels are left, the three in the middle of the valley are taken, and both
    stripes' light, as far as the start values tell it, is taken off.

    Returns
    -------
    ndarray
        (peak, 5) number of pixels, and the sums of u, u², y, u y with u the distance from the peak, px, and
        y the grey level above `level`.
    """
    peaks = row.shape[0]
    columns = image.shape[1]
    sums = np.zeros((peaks, 5))
    for p in range(peaks):
        f = image[row[p]]
        for side in (-1, 1):
            inner = _CLEAR * sigma_px[p] + 0.5
            outer = inner + _SIDE_PX
            q = p + side
            crowded = False
            if 0 <= q < peaks and row[q] == row[p]:
                gap = abs(x_px[q] - x_px[p])
                free = gap - _CLEAR * sigma_px[q] - 0.5
                if free < inner + 3.0:
                    crowded = True
                    middle = gap * sigma_px[p] / (sigma_px[p] + sigma_px[q])
                    inner, outer = middle - 1.5, middle + 1.5
                else:
                    outer = min(outer, free)
            if side < 0:
                first = max(int(math.ceil(x_px[p] - outer)), 0)
                last = min(int(math.floor(x_px[p] - inner)), columns - 1)
            else:
                first = max(int(math.ceil(x_px[p] + inner)), 0)
                last = min(int(math.floor(x_px[p] + outer)), columns - 1)
            n, su, suu, sy, suy = 0, 0.0, 0.0, 0.0, 0.0
            highest, at = -np.inf, 0.0
            for x in range(first, last + 1):
                u = x - x_px[p]
                y = np.float64(f[x])
                if crowded:
                    y -= amplitude[p] * math.exp(-0.5 * (u / sigma_px[p]) ** 2)
                    y -= amplitude[q] * math.exp(-0.5 * ((x - x_px[q]) / sigma_px[q]) ** 2)
                y -= level[p]
                n += 1
                su += u
                suu += u * u
                sy += y
                suy += u * y
                if y > highest:
                    highest, at = y, u
            if n > 3:
                mean = (sy - highest) / (n - 1)
                if highest - mean > _HOT * math.sqrt(noise**2 + gain * max(level[p] + mean, 0.0)):
                    n -= 1
                    su -= at
                    suu -= at * at
                    sy -= highest
                    suy -= at * highest
            sums[p, 0] += n
            sums[p, 1] += su
            sums[p, 2] += suu
            sums[p, 3] += sy
            sums[p, 4] += suy
    return sums


@njit(cache=True, nogil=True)
def lines(sums: Floats, level: Floats) -> tuple[Floats, Floats]:
    """Level at the peak and slope per px of the line through each peak's pooled sums."""
    peaks = sums.shape[0]
    height = np.empty(peaks)
    slope = np.empty(peaks)
    for p in range(peaks):
        n, su, suu, sy, suy = sums[p, 0], sums[p, 1], sums[p, 2], sums[p, 3], sums[p, 4]
        height[p], slope[p] = level[p], 0.0
        if n > 0.0:
            height[p] = level[p] + sy / n
        spread = n * suu - su * su
        # A slope needs pixels on both sides.
        if n > 3.0 and spread > 4.0 * n * suu * 0.02:
            slope[p] = (n * suy - su * sy) / spread
            height[p] = level[p] + (sy - slope[p] * su) / n
    return height, slope
