"""Scans of image rows for peaks, compiled: dominant peaks, every local maximum, runs above a grey level.

Each scan walks the inner rows of a grey image (the first and last row and column are not searched, as in
Lee et al. 2000, section 3.2), and one common measurement adds what is known of each peak. Rows are read
from left to right; in the kernels ``f`` is a row's grey levels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry.records.peaks import EDGE, SATURATED
from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import plain_layout

_BORDER_PX = 2  # a peak this near to the left or right border pixel may be cut off
_BLOCK = 16  # pixels looked at together where nothing happens: one vector of 16-bit pixels
_PEAKS_A_ROW = 64  # room made at first

Pixels = NDArray[Any]
Bytes = NDArray[np.uint8]


class Scan(NamedTuple):
    """What a scan found, one element a peak, sorted by row, then x: the fields of `Peaks` it can fill.

    Attributes
    ----------
    row : ndarray of int64, shape (peak,)
        Image row.
    x_px : ndarray of float64, shape (peak,)
        Position along the row, px.
    amplitude : ndarray of float64, shape (peak,)
        Grey levels above `background`: by so much the peak rises above the valleys on both sides.
    background : ndarray of float64, shape (peak,)
        Grey level of the higher of the two valleys; a valley is the lowest level between a peak and its
        neighbour, or the image border.
    width_px : ndarray of float64, shape (peak,)
        Full width at half of the amplitude, px; NaN where the amplitude is 0.
    flags : ndarray of uint8, shape (peak,)
        Sum of `SATURATED` (at the white level) and `EDGE` (within 2 px of the left or right border pixel,
        or a run that the border cuts off).
    """

    row: Integers
    x_px: Floats
    amplitude: Floats
    background: Floats
    width_px: Floats
    flags: Bytes


def dominant_peaks(image: Pixels, threshold: int, *, lowest: bool, white: int) -> Scan:
    """Find peaks that exceed the valleys before and after them by more than `threshold` grey levels.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels; an image that is not contiguous is copied first.
    threshold
        Grey levels; a difference equal to it is not enough.
    lowest
        What counts as the valley before a peak. False: the valley that ended the last peak (at first the
        row's first pixel), however much lower the row falls later. True: the lowest valley since then.
    white
        Grey level from which on a pixel is saturated.
    """
    return _scan(_scan_dominant, image, white, threshold, lowest)


def local_maxima(image: Pixels, floor: int, *, white: int) -> Scan:
    """Find every maximum of at least `floor` grey levels; the other parameters as for `dominant_peaks`.

    A maximum is a pixel that is not lower than the one before it and higher than the one after it. So the
    last pixel of a plateau is one, even of a step halfway down a slope (which has amplitude 0).
    """
    return _scan(_scan_maxima, image, white, floor, False)


def runs_above(image: Pixels, threshold: int, *, white: int) -> Scan:
    """Find the middles of runs of pixels above `threshold`; the other parameters as for `dominant_peaks`.

    A run that the border cuts off on one side is flagged `EDGE`; one that fills the row is no stripe.
    """
    return _scan(_scan_runs, image, white, threshold, False)


def _scan(kernel: Callable[..., int], image: Pixels, white: int, level: int, lowest: bool) -> Scan:
    pixels = plain_layout(image)
    room = _PEAKS_A_ROW * pixels.shape[0]
    while True:
        row, at = np.empty(room, np.int64), np.empty(room, np.int64)
        x_px, flags = np.empty(room, np.float64), np.empty(room, np.uint8)
        count = kernel(pixels, level, lowest, row, at, x_px, flags)
        if count <= room:
            break
        room = count
    # Copies, so that a record which is kept for long does not hold the unused room.
    row, x_px, flags = row[:count].copy(), x_px[:count].copy(), flags[:count].copy()
    amplitude, background, width_px = np.empty(count), np.empty(count), np.empty(count)
    _measure(pixels, white, row, at[:count], x_px, amplitude, background, width_px, flags)
    return Scan(row, x_px, amplitude, background, width_px, flags)


@kernel
def _scan_dominant(
    image: Pixels, threshold: int, lowest: bool, row: Integers, at: Integers, x_px: Floats, flags: Bytes
) -> int:
    """Section 3.2 in one walk along each row; gives the number of peaks, also of those there is no room for.

    The search over lists of maxima and minima, put into three states: only a pixel above start + threshold
    can be dominant, so all below are passed over (1); from there on the highest pixel is kept until the row
    falls by more than the threshold below it (2); where that fall ends is the end, and the next start (3).
    The highest pixel between two minima is a maximum, and the last one of its plateau, if that is kept.
    """
    rows, columns = image.shape
    count = 0
    for y in range(1, rows - 1):
        f = image[y]
        start = np.int64(f[0])
        x = 1
        while True:
            # 1: look for a pixel above start + threshold, a block at a time as long as none has one.
            while x < columns - _BLOCK:
                block = f[x : x + _BLOCK]
                high = block[0]
                low = block[0]
                for k in range(_BLOCK):
                    high = max(high, block[k])
                    low = min(low, block[k])
                valley = min(start, np.int64(low)) if lowest else start
                if np.int64(high) > valley + threshold:
                    # Most blocks that come here have such a pixel; one that has not costs its own walk.
                    stop = x + _BLOCK
                    while x < stop and np.int64(f[x]) <= start + threshold:
                        if lowest:
                            start = min(start, np.int64(f[x]))
                        x += 1
                    if x < stop:
                        break
                else:
                    start = valley
                    x += _BLOCK
            while x < columns - 1 and np.int64(f[x]) <= start + threshold:
                if lowest:
                    start = min(start, np.int64(f[x]))
                x += 1
            if x >= columns - 1:
                break
            # 2: keep the highest pixel until the row falls. The last pixel may end a peak, not be one.
            top = np.int64(f[x])
            peak = x
            x += 1
            while x < columns:
                level = np.int64(f[x])
                if level > top or (level == top and peak == x - 1):
                    top = level
                    peak = x
                elif level < top - threshold:
                    break
                x += 1
            if x == columns:
                break
            # 3: the next minimum, or the row's last pixel.
            while x < columns - 1 and f[x + 1] < f[x]:
                x += 1
            start = np.int64(f[x])
            if count < row.shape[0]:
                row[count] = y
                at[count] = peak
                x_px[count] = peak
                flags[count] = 0
            count += 1
            x += 1
    return count


@kernel
def _scan_maxima(
    image: Pixels, floor: int, _: bool, row: Integers, at: Integers, x_px: Floats, flags: Bytes
) -> int:
    """Find every maximum by the definition of section 3.2."""
    rows, columns = image.shape
    count = 0
    for y in range(1, rows - 1):
        f = image[y]
        for x in range(1, columns - 1):
            if f[x + 1] < f[x] and f[x] >= f[x - 1] and f[x] >= floor:
                if count < row.shape[0]:
                    row[count] = y
                    at[count] = x
                    x_px[count] = x
                    flags[count] = 0
                count += 1
    return count


@kernel
def _scan_runs(
    image: Pixels, threshold: int, _: bool, row: Integers, at: Integers, x_px: Floats, flags: Bytes
) -> int:
    """Find runs above a level; `at` is the first highest pixel of a run, where it is measured."""
    rows, columns = image.shape
    last = columns - 2
    count = 0
    for y in range(1, rows - 1):
        f = image[y]
        x = 1
        while x <= last:
            if f[x] <= threshold:
                x += 1
                continue
            first = x
            top = x
            while x <= last and f[x] > threshold:
                if f[x] > f[top]:
                    top = x
                x += 1
            if first == 1 and x > last:
                continue
            if count < row.shape[0]:
                row[count] = y
                at[count] = top
                x_px[count] = 0.5 * (first + x - 1)
                flags[count] = EDGE if first == 1 or x > last else 0
            count += 1
    return count


@kernel
def _measure(
    image: Pixels,
    white: int,
    row: Integers,
    at: Integers,
    x_px: Floats,
    amplitude: Floats,
    background: Floats,
    width_px: Floats,
    flags: Bytes,
) -> None:
    """Amplitude, background, width and flags of the peaks at the pixels `at`, sorted by row, then x."""
    columns = image.shape[1]
    count = row.shape[0]
    left_valley = np.int64(0)
    for i in range(count):
        f = image[row[i]]
        peak = at[i]
        top = np.int64(f[peak])
        if i == 0 or row[i - 1] != row[i]:
            left_valley = _lowest(f[: peak + 1])
        last = i == count - 1 or row[i + 1] != row[i]
        right_valley = _lowest(f[peak:] if last else f[peak : at[i + 1] + 1])
        base = max(left_valley, right_valley)
        left_valley = right_valley
        background[i] = base
        amplitude[i] = top - base
        width_px[i] = np.nan
        if top > base:
            # Both valleys lie below half height, so each walk ends before the neighbouring peak.
            half = 0.5 * (top + base)
            left = peak - 1
            while f[left] >= half:
                left -= 1
            right = peak + 1
            while f[right] >= half:
                right += 1
            # In floats, since differences of unsigned grey levels may wrap around.
            rise = np.float64(f[left + 1]) - np.float64(f[left])
            fall = np.float64(f[right - 1]) - np.float64(f[right])
            width_px[i] = (right - (half - f[right]) / fall) - (left + (half - f[left]) / rise)
        if top >= white:
            flags[i] |= SATURATED
        if x_px[i] <= _BORDER_PX or x_px[i] >= columns - 1 - _BORDER_PX:
            flags[i] |= EDGE


@kernel
def _lowest(levels: Pixels) -> int:
    lowest = levels[0]
    for k in range(levels.shape[0]):
        lowest = min(lowest, levels[k])
    return np.int64(lowest)  # type: ignore[return-value]
