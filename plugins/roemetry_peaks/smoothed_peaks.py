"""Peaks of lightly smoothed image rows, compiled: where stripes are, well enough to start a fit from.

The light beside stripes is a straight line, pooled along each stripe over the rows next to each row.

Halos. Where light is scattered in the product, the lens or the sensor, a stripe is a narrow core on broad
light that may be half as high, and is brighter on one side. Half height then lies in the halo, and tells
neither the core's middle nor its width. A Gaussian of standard deviation σ and height a is wide by
w² = 8 σ² ln(a / level) at a level; so two levels give σ², and a second pair, higher up, gives it again:

    unclipped  σ²_low = w²(½) / 8 ln 2,                      σ²_high = w²(0.8) / 8 ln 1.25
    cut off    σ²_low = (w²(¼) − w²(0.7)) / 8 ln (0.7/0.25), σ²_high = (w²(0.7) − w²(0.85)) / 8 ln (0.85/0.7)

(of clipped tops the height is not known, but cancels). Both are one number for a Gaussian, cut off or not.
Summed over the rows next to each row, σ²_low is 0.7 to 1.35 σ²_high under speckle of contrast up to 0.25,
and 2 to 10 times it in halos. Where it is more than 1.5 times, the chord high up is where the stripe is.

It assumes that a stripe moves by less than 3 px from row to row. It fails where stripes are nearer to each
other than the smoothing is wide.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

SMOOTHING_VARIANCE_PX2 = 1.5
"""Variance of the smoothing across the stripes, 1 6 15 20 15 6 1, px²."""
_WEIGHTS = 256.0  # sum of the smoothing's weights, 64 across times 4 along
NOISE_LEFT = math.sqrt(924.0 / 4096.0 * 6.0 / 16.0)
"""Standard deviation of white noise after smoothing, over before."""
_SEPARATE = 0.45  # two peaks are two where the valley between is deeper than this share of the lower one
_PEAKS_A_ROW = 32  # room made at first
_BLOCK_PX = 8  # a block is shorter than the belt between two stripes
_QUIET_QUANTILE = 0.25  # the quietest quarter of the blocks lies between stripes
_QUIET_SHARE = 0.5218  # that quantile of the mean square of a block of the noise filter, for white noise
_LAPLACIAN_SQUARES = 36.0  # sum of squares of the noise filter's weights

Pixels = NDArray[Any]


class Starts(NamedTuple):
    """Where fits can start, one element a peak, sorted by row, then x."""

    row: Integers
    """(peak,) image row."""
    x_px: Floats
    """(peak,) middle of the crossings of half height, px."""
    amplitude: Floats
    """(peak,) height above the valleys, grey levels."""
    sigma_px: Floats
    """(peak,) standard deviation of the Gaussian of that width, the smoothing taken off, px."""
    level: Floats
    """(peak,) mean grey level of the two valleys."""
    core_px: Floats
    core_width_px: Floats
    """core_px, core_width_px: (peak,) middle of the chord high up, where a halo tells little, and its width,
    px."""
    core2_px2: Floats
    """(peak,) σ²_high, px²."""
    core_std_px: Floats
    """(peak,) standard uncertainty of that middle if there is a halo, px."""


def background_noise(image: Pixels) -> float:
    """Estimate the noise of the quiet parts of an image, standard deviation of a pixel, grey levels.

    The second difference both ways takes off what is smooth, stripes too (Immerkær 1996); blocks of 8
    pixels are ranked by its mean square, and a low quantile of them is background.
    """
    if min(image.shape) < 3 or image.shape[1] < _BLOCK_PX + 2:
        return 0.0
    squares = _block_squares(image, max(1, image.shape[0] // 96))
    at = int(_QUIET_QUANTILE * (squares.shape[0] - 1))
    return float(math.sqrt(np.partition(squares, at)[at] / (_LAPLACIAN_SQUARES * _QUIET_SHARE)))


def rounding_variance(image: Pixels) -> float:
    """Variance of rounding to the image's own steps, grey levels²: those of 8 bits in 16 are 256 wide."""
    return _smallest_step(image, max(1, image.shape[0] // 16)) ** 2 / 12.0


def smoothed_peaks(image: Pixels, rise: Floats, white: int) -> Starts:
    """Find peaks that rise above both valleys in the smoothed image.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels, contiguous and read-only.
    rise : ndarray of float64, shape (256,)
        By how much a peak must rise, grey levels, from a valley in each 256th of the range.
    white
        Grey level from which on a pixel is saturated.
    """
    rows = image.shape[0]
    room = _PEAKS_A_ROW * rows
    rise = _WEIGHTS * rise
    while True:
        row = np.empty(room, np.int64)
        shapes = np.empty((8, room))
        count = _find(image, rise, float(white), row, shapes)
        if count <= room:
            break
        room = count
    return Starts(row[:count].copy(), *(values[:count].copy() for values in shapes))


@kernel
def _block_squares(image: Pixels, step: int) -> Floats:
    rows, columns = image.shape
    blocks = (columns - 2) // _BLOCK_PX
    squares = np.empty(((rows - 2 + step - 1) // step) * blocks)
    at = 0
    for y in range(1, rows - 1, step):
        for b in range(blocks):
            total = 0.0
            for x in range(1 + b * _BLOCK_PX, 1 + (b + 1) * _BLOCK_PX):
                # second differences across in three rows, then of these down the rows
                top = np.float64(image[y - 1, x - 1]) - 2.0 * image[y - 1, x] + image[y - 1, x + 1]
                here = np.float64(image[y, x - 1]) - 2.0 * image[y, x] + image[y, x + 1]
                below = np.float64(image[y + 1, x - 1]) - 2.0 * image[y + 1, x] + image[y + 1, x + 1]
                total += (top - 2.0 * here + below) ** 2
            squares[at] = total / _BLOCK_PX
            at += 1
    return squares[:at]


@kernel
def _smallest_step(image: Pixels, step: int) -> int:
    seen = np.zeros(65536, np.bool_)
    for y in range(0, image.shape[0], step):
        for level in image[y]:
            seen[level] = True
    smallest, last = 65536, -1
    for level in range(65536):
        if seen[level]:
            if last >= 0:
                smallest = min(smallest, level - last)
            last = level
    return 1 if smallest == 65536 else smallest


@kernel
def _find(image: Pixels, rise: Floats, white: float, row: Integers, shapes: Floats) -> int:
    """Fill in the rows and, as lines of `shapes`, the other fields of `Starts`; gives the number of peaks."""
    rows, columns = image.shape
    padded = np.empty(columns + 6, np.int32)
    smooth = np.empty(columns, np.int32)
    tops = np.empty(columns, np.int64)
    valleys = np.empty(columns + 1, np.int64)
    count = 0
    for y in range(rows):
        _smooth(image, y, padded, smooth)
        found = _tops(smooth, rise, white, tops, valleys)
        for k in range(found):
            if count < row.shape[0]:
                row[count] = y
                _halves(smooth, tops[k], valleys[k], valleys[k + 1], white, shapes[:, count])
            count += 1
    return count


@kernel
def _smooth(image: Pixels, y: int, padded: NDArray[np.int32], smooth: NDArray[np.int32]) -> None:
    """One row, 1 2 1 along the stripes and 1 6 15 20 15 6 1 across, borders repeated."""
    rows, columns = image.shape
    above, here, below = image[max(y - 1, 0)], image[y], image[min(y + 1, rows - 1)]
    for x in range(columns):
        padded[x + 3] = np.int32(above[x]) + 2 * np.int32(here[x]) + np.int32(below[x])
    for x in range(3):
        padded[x] = padded[3]
        padded[columns + 3 + x] = padded[columns + 2]
    for x in range(columns):
        smooth[x] = (
            padded[x]
            + padded[x + 6]
            + 6 * (padded[x + 1] + padded[x + 5])
            + 15 * (padded[x + 2] + padded[x + 4])
            + 20 * padded[x + 3]
        )


@kernel
def _tops(smooth: NDArray[np.int32], rise: Floats, white: float, tops: Integers, valleys: Integers) -> int:
    """Tops with the valley before each, and the one after the last."""
    columns = smooth.shape[0]
    scale = 255.9 / (_WEIGHTS * white)
    count = 0
    base, low = 0, int(smooth[0])
    x = 1
    while x < columns:
        # Up from the lowest pixel since the last peak.
        enough = rise[min(int(low * scale), 255)]
        need = math.floor(low + enough)
        here = low
        while x < columns:
            here = int(smooth[x])
            if here > need:
                break
            if here < low:
                base, low = x, here
                enough = rise[min(int(low * scale), 255)]
                need = math.floor(low + enough)
            x += 1
        if x >= columns:
            break
        top, high = x, here
        # a peak ends where it has fallen by the threshold and by what separates two
        least = math.ceil(high - max(enough, _SEPARATE * (high - low)))
        while x < columns:
            here = int(smooth[x])
            if here > high:
                top, high = x, here
                least = math.ceil(high - max(enough, _SEPARATE * (high - low)))
            elif here < least:
                break
            x += 1
        if x >= columns:
            # Cut off by the border on its way down, as those at the other border are on their way up.
            if top < columns - 1 and high - int(smooth[columns - 1]) > enough:
                tops[count], valleys[count], valleys[count + 1] = top, base, columns - 1
                count += 1
                return count
            break
        # A second bump on the same stripe's slope does not stand out from both sides.
        tops[count] = top
        valleys[count] = base
        count += 1
        base, low = x, here
        x += 1
        while x < columns and smooth[x] <= low:
            base, low = x, int(smooth[x])
            x += 1
        valleys[count] = base
    if count:
        # The valley after the last peak: the lowest pixel that is left.
        for x in range(tops[count - 1], columns):
            if smooth[x] < smooth[valleys[count]]:
                valleys[count] = x
    return count


_LN_HALF, _LN_HIGH = 8.0 * math.log(2.0), 8.0 * math.log(1.0 / 0.8)
_LN_CLIPPED, _LN_CLIPPED_HIGH = 8.0 * math.log(0.7 / 0.25), 8.0 * math.log(0.85 / 0.7)
"""Of a Gaussian, w² / σ² at half height and at 0.8 of it; growth of w² / σ² between two levels."""
_HALO = 1.5  # σ²_low over σ²_high: see above
_FLANK = 0.5 / math.sqrt(12.0)
"""Standard uncertainty of a core's middle over what its two flanks move by between two levels, together: each
lies anywhere within that stretch, and a halo that is brighter on one side moves both the same way."""


@kernel
def _halves(
    smooth: NDArray[np.int32], top: int, before: int, after: int, white: float, shape: Floats
) -> None:
    """Fill in, from where the flanks cross some levels, the fields of `Starts` but for the row."""
    # halfway between the two valleys
    base = 0.5 * (smooth[before] + smooth[after])
    height = smooth[top] - base
    left, right = _crossings(smooth, top, before, after, 0.5)
    # the width at half height gives the variance; the smoothing's is taken off
    variance = (right - left) ** 2 / _LN_HALF - SMOOTHING_VARIANCE_PX2
    if smooth[top] >= 0.97 * _WEIGHTS * white:
        # A clipped top: width and height from the widths at two levels of what is left.
        low_left, low_right = _crossings(smooth, top, before, after, 0.25)
        high_left, high_right = _crossings(smooth, top, before, after, 0.7)
        up_left, up_right = _crossings(smooth, top, before, after, 0.85)
        top_left, top_right = _crossings(smooth, top, before, after, 0.9)
        # of a clipped top the height is not known: two widths below it
        wide, narrow = (low_right - low_left) ** 2, (high_right - high_left) ** 2
        spread = max((wide - narrow) / _LN_CLIPPED, 0.3)
        # a = level × exp(w²/8σ²), at most by e⁴
        height *= 0.25 * math.exp(min(wide / (8.0 * spread), 4.0))
        left, right = 0.5 * (left + low_left), 0.5 * (right + low_right)
        variance = spread - SMOOTHING_VARIANCE_PX2
        shape[6] = (narrow - (up_right - up_left) ** 2) / _LN_CLIPPED_HIGH
        shape[7] = _FLANK * (top_left - high_left + high_right - top_right)
    else:
        top_left, top_right = _crossings(smooth, top, before, after, 0.8)
        shape[6] = (top_right - top_left) ** 2 / _LN_HIGH
        low_left, low_right = _crossings(smooth, top, before, after, 0.6)
        shape[7] = _FLANK * (top_left - low_left + low_right - top_right)
    variance = max(variance, 0.25)
    # smoothing lowered it by σ/√(σ² + s²)
    height *= math.sqrt((variance + SMOOTHING_VARIANCE_PX2) / variance)
    shape[0], shape[1], shape[2] = 0.5 * (left + right), height / _WEIGHTS, math.sqrt(variance)
    shape[3], shape[4], shape[5] = base / _WEIGHTS, 0.5 * (top_left + top_right), top_right - top_left


@kernel
def _crossings(
    smooth: NDArray[np.int32], top: int, before: int, after: int, share: float
) -> tuple[float, float]:
    """Where the flanks cross a share of the height above the valley on either side, px."""
    level = smooth[before] + share * (smooth[top] - smooth[before])
    x = top
    while smooth[x] > level:
        x -= 1
    left = x + (level - smooth[x]) / (smooth[x + 1] - smooth[x])
    level = smooth[after] + share * (smooth[top] - smooth[after])
    x = top
    while smooth[x] > level:
        x += 1
    right = x - (level - smooth[x]) / (smooth[x - 1] - smooth[x])
    return left, right


_REACH = 4  # rows pooled on either side
_STEP_PX = 3.0  # farthest from row to row along one stripe
_CLEAR = 3.6  # standard deviations beyond which a stripe's own light does not count
_SIDE_PX = 8.0  # pixels taken on either side
_HOT = 6.0  # a pixel so many standard deviations above the others of its side is left out


class Beside(NamedTuple):
    """What the rows around each peak say of its stripe, one element a peak."""

    sigma_px: Floats
    """(peak,) standard deviation, px, root mean square over the rows."""
    amplitude: Floats
    """(peak,) height at that width, grey levels."""
    height: Floats
    slope: Floats
    """height, slope: (peak,) the light beside the stripe at the peak's x, grey levels, and its growth, grey
    levels per px."""
    up: Integers
    down: Integers
    """up, down: (peak,) the same stripe's peak in the row above and in the row below; −1 for none."""
    halo: Flags
    """(peak,) whether the stripe is a core in a halo: then its width is the core's, and the halo is light
    beside it."""


@kernel
def light_beside(image: Pixels, starts: Starts, noise: float, gain: float) -> Beside:
    """Give the light beside each peak, pooled over the rows within 4 of it.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels.
    starts
        The peaks; `x_px` of those in a halo becomes the core's middle, in place.
    noise, gain
        Standard deviation of a dark pixel, grey levels; growth of the variance with the grey level.
    """
    up, down = neighbours(starts.row, starts.core_px)
    peaks = starts.row.shape[0]
    shape = np.empty((peaks, 4))
    for p in range(peaks):
        sigma_px = starts.sigma_px[p]
        # height times width, so that the light of the rows adds up
        shape[p, 0], shape[p, 1], shape[p, 2] = 1.0, sigma_px**2, starts.amplitude[p] * sigma_px
        shape[p, 3] = starts.core2_px2[p]
    shape = pooled(shape, up, down, _REACH, _REACH)
    halo = np.zeros(peaks, np.bool_)
    for p in range(peaks):
        core2 = shape[p, 3] / shape[p, 0]
        shape[p, 1] /= shape[p, 0]
        halo[p] = shape[p, 1] + SMOOTHING_VARIANCE_PX2 > _HALO * core2
        shape[p, 1] = math.sqrt(shape[p, 1])
        shape[p, 2] /= shape[p, 0] * shape[p, 1]
        if halo[p]:
            starts.x_px[p] = starts.core_px[p]
            shape[p, 1] = math.sqrt(max(core2 - SMOOTHING_VARIANCE_PX2, 0.25))
    sigma, height = shape[:, 1].copy(), shape[:, 2].copy()
    sums = pooled(_side_sums(image, starts, sigma, height, noise, gain), up, down, _REACH, _REACH)
    line, slope = _lines(sums, starts.level)
    return Beside(sigma, height, line, slope, up, down, halo)


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
        # the first peak of the next row that is not left of this one
        while q < peaks and (row[q] < row[p] + 1 or (row[q] == row[p] + 1 and x_px[q] < x_px[p])):
            q += 1
        best, off = -1, _STEP_PX
        for other in (q - 1, q):
            if 0 <= other < peaks and row[other] == row[p] + 1 and abs(x_px[other] - x_px[p]) <= off:
                best, off = other, abs(x_px[other] - x_px[p])
        if best < 0:
            continue
        # of two that want the same the nearer one keeps it
        if up[best] < 0:
            up[best], down[p] = p, best
        elif abs(x_px[up[best]] - x_px[best]) > off:
            down[up[best]] = -1
            up[best], down[p] = p, best
    return up, down


@kernel
def pooled(values: Floats, up: Integers, down: Integers, above: int, below: int) -> Floats:
    """Sum (peak, value) over the peaks of the same stripe at most so many rows above and below."""
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
            first, last = max(m - above, 0), min(m + below + 1, n)
            for k in range(columns):
                total[chain[m], k] = sums[last, k] - sums[first, k]
    return total


@kernel
def _side_sums(
    image: Pixels, starts: Starts, sigma_px: Floats, amplitude: Floats, noise: float, gain: float
) -> Floats:
    """(peak, 5) sums of the pixels on both sides: their number, and u, u², y, u y.

    u is the distance from the peak, px, y the grey level. Pixels nearer to a neighbour than 3.6 of its
    standard deviations do not count either. Where stripes are so near that fewer than three pixels are left,
    the three in the middle of the valley are taken, and both stripes' light, as far as the start values tell
    it, is taken off.
    """
    row, x_px = starts.row, starts.x_px
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
                # too near: the three pixels in the middle of the valley
                if free < inner + 3.0:
                    crowded = True
                    # as many of its own standard deviations from either
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
                # the brightest pixel against the mean of the others
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
