"""The light beside stripes as a straight line, pooled along each stripe, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_peaks.smoothed_peaks import Starts

_REACH = 4  # rows pooled on either side
_STEP_PX = 3.0  # farthest from row to row along one stripe
_CLEAR = 3.6  # standard deviations beyond which a stripe's own light does not count
_SIDE_PX = 8.0  # pixels taken on either side
_HOT = 6.0  # a pixel so many standard deviations above the others of its side is left out

Pixels = NDArray[Any]


class Beside(NamedTuple):
    """What the rows around each peak say of its stripe, one element a peak.

    Attributes
    ----------
    sigma_px : ndarray of float64, shape (peak,)
        Standard deviation, px, root mean square over the rows.
    amplitude : ndarray of float64, shape (peak,)
        Height at that width, grey levels.
    height, slope : ndarray of float64, shape (peak,)
        The light beside the stripe at the peak's x, grey levels, and its growth, grey levels per px.
    up, down : ndarray of int64, shape (peak,)
        The same stripe's peak in the row above and in the row below; −1 for none.
    """

    sigma_px: Floats
    amplitude: Floats
    height: Floats
    slope: Floats
    up: Integers
    down: Integers


def light_beside(image: Pixels, starts: Starts, noise: float, gain: float) -> Beside:
    """Give the light beside each peak, pooled over the rows within 4 of it.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels.
    starts
        The peaks.
    noise, gain
        Standard deviation of a dark pixel, grey levels; growth of the variance with the grey level.
    """
    return Beside(*_beside(image, *starts, noise, gain))


@kernel
def _beside(
    image: Pixels,
    row: Integers,
    x_px: Floats,
    amplitude: Floats,
    sigma_px: Floats,
    level: Floats,
    noise: float,
    gain: float,
) -> tuple[Floats, Floats, Floats, Floats, Integers, Integers]:
    up, down = neighbours(row, x_px)
    peaks = row.shape[0]
    shape = np.empty((peaks, 3))
    for p in range(peaks):
        shape[p, 0], shape[p, 1], shape[p, 2] = 1.0, sigma_px[p] ** 2, amplitude[p] * sigma_px[p]
    shape = _pooled(shape, up, down)
    for p in range(peaks):
        shape[p, 1] = math.sqrt(shape[p, 1] / shape[p, 0])
        shape[p, 2] /= shape[p, 0] * shape[p, 1]
    sigma, height = shape[:, 1].copy(), shape[:, 2].copy()
    sums = _pooled(_side_sums(image, row, x_px, sigma, height, noise, gain, level), up, down)
    line, slope = _lines(sums, level)
    return sigma, height, line, slope, up, down


@kernel
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


@kernel
def _pooled(values: Floats, up: Integers, down: Integers) -> Floats:
    """Sum (peak, value) over the peaks of the same stripe at most 4 rows away."""
    peaks, columns = values.shape
    total = np.empty((peaks, columns))
    chain = np.empty(peaks, np.int64)
    sums = np.zeros((peaks + 1, columns))
    for head in range(peaks):
        if up[head] >= 0:
            continue
        # One stripe from its first row on: sums of windows from sums so far.
        n, p = 0, head
        while p >= 0:
            chain[n] = p
            for k in range(columns):
                sums[n + 1, k] = sums[n, k] + values[p, k]
            n += 1
            p = down[p]
        for m in range(n):
            first, last = max(m - _REACH, 0), min(m + _REACH + 1, n)
            for k in range(columns):
                total[chain[m], k] = sums[last, k] - sums[first, k]
    return total


@kernel
def _side_sums(
    image: Pixels,
    row: Integers,
    x_px: Floats,
    sigma_px: Floats,
    amplitude: Floats,
    noise: float,
    gain: float,
    level: Floats,
) -> Floats:
    """(peak, 5) sums of the pixels on both sides: their number, and u, u², y, u y.

    u is the distance from the peak, px, y the grey level. Pixels nearer to a neighbour than 3.6 of its
    standard deviations do not count either. Where stripes are so near that fewer than three pixels are left,
    the three in the middle of the valley are taken, and both stripes' light, as far as the start values tell
    it, is taken off.
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
                first = max(math.ceil(x_px[p] - outer), 0)
                last = min(math.floor(x_px[p] - inner), columns - 1)
            else:
                first = max(math.ceil(x_px[p] + inner), 0)
                last = min(math.floor(x_px[p] + outer), columns - 1)
            n, su, suu, sy, suy = 0, 0.0, 0.0, 0.0, 0.0
            highest, at = -np.inf, 0.0
            for x in range(first, last + 1):
                u = x - x_px[p]
                y = np.float64(f[x])
                if crowded:
                    y -= amplitude[p] * math.exp(-0.5 * (u / sigma_px[p]) ** 2)
                    y -= amplitude[q] * math.exp(-0.5 * ((x - x_px[q]) / sigma_px[q]) ** 2)
                n += 1
                su += u
                suu += u * u
                sy += y
                suy += u * y
                if y > highest:
                    highest, at = y, u
            if n > 3:
                mean = (sy - highest) / (n - 1)
                if highest - mean > _HOT * math.sqrt(noise**2 + gain * max(mean, 0.0)):
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


@kernel
def _lines(sums: Floats, level: Floats) -> tuple[Floats, Floats]:
    """Level at the peak and slope per px of the line through each peak's pooled sums."""
    peaks = sums.shape[0]
    height = np.empty(peaks)
    slope = np.empty(peaks)
    for p in range(peaks):
        n, su, suu, sy, suy = sums[p, 0], sums[p, 1], sums[p, 2], sums[p, 3], sums[p, 4]
        height[p], slope[p] = level[p], 0.0
        if n > 0.0:
            height[p] = sy / n
        spread = n * suu - su * su
        # A slope needs pixels on both sides.
        if n > 3.0 and spread > 4.0 * n * suu * 0.02:
            slope[p] = (n * suy - su * sy) / spread
            height[p] = (sy - slope[p] * su) / n
    return height, slope
