"""The noise of an image, estimated from the image itself, compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel
from roemetry_kernels.ranking import nth_smallest

_BLOCK = 16  # pixels whose differences are looked at together
_BLOCKS_MAX = 1024  # looked at in all: the estimate is then good to 2 %
_ROWS_MAX = 32  # that they lie in: memory is read along rows
_SUMS = 4096  # sums of squares up to here are counted, not sorted
_QUANTILE = 0.2  # of the blocks' noise: the dark ones, without stripes and texture
_QUANTILE_OF_CHI = 0.791
"""That quantile of the root mean square of 15 differences of white noise, over the true one; found by drawing
ten million blocks."""
_QUANTISATION = 1.0 / math.sqrt(12.0)
_NOISES = 10.0  # that a stripe rises at least
RISE_MIN = 6.0
"""Of 255 grey levels, that a stripe rises at least."""
_STEEP_SHARE = 0.01  # of white: noisier images are looked at across the rows as well


def image_noise(image: NDArray[Any], top: int, bottom: int, left: int, right: int) -> float:
    """Estimate the standard deviation of the noise in the dark parts of an image, grey levels.

    From differences of neighbouring pixels in blocks of 16 (a low quantile of the blocks), along the rows;
    where that is much, also from row to row, and the smaller counts. Never less than the rounding to whole
    grey levels has.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels, contiguous and read-only.
    top, bottom, left, right
        The part that is looked at: rows and columns from the first to the one after the last.
    """
    levels, columns = image.reshape(-1), image.shape[1]
    noise = _noise_of(_low_sum(levels, columns, 1, top, bottom, left, right))
    if noise > _STEEP_SHARE * np.iinfo(image.dtype).max and bottom - top > 1:
        # Where stripes fill the image every block holds a slope; from row to row they hardly change.
        noise = min(noise, _noise_of(_low_sum(levels, columns, columns, top, bottom - 1, left, right)))
    return max(noise, _QUANTISATION)


def automatic_rise(image: NDArray[Any], white: int, top: int, bottom: int, left: int, right: int) -> int:
    """Choose by how much a stripe must rise: ten times the noise, at least 6 grey levels of 255.

    The parameters are those of `image_noise`; `white` is the grey level that 255 stands for.
    """
    noise = image_noise(image, top, bottom, left, right)
    return math.ceil(max(_NOISES * noise, RISE_MIN * white / 255.0))


def _noise_of(low: int) -> float:
    return math.sqrt(low / (_BLOCK - 1.0) / 2.0) / _QUANTILE_OF_CHI


@kernel
def _low_sum(
    levels: NDArray[Any], columns: int, apart: int, top: int, bottom: int, left: int, right: int
) -> int:
    """Low quantile of the sums of 15 squared differences in blocks spread over the image; 0 without any.

    The differences are those of pixels `apart` places from each other: 1 along the row, `columns` across.
    """
    across = (right - left) // _BLOCK
    rows = min(bottom - top, _ROWS_MAX)
    if across == 0 or rows == 0:
        return 0
    a_row = min(across, _BLOCKS_MAX // rows)
    sums, counts = np.empty(rows * a_row, np.int64), np.zeros(_SUMS, np.int64)
    # Unsigned, which no index from the end can be: only then are pixels taken many at a time.
    begins, beside = np.empty(a_row, np.uint64), np.uint64(apart)
    for n in range(a_row):
        begins[n] = left + _BLOCK * (n * across // a_row)
    for r in range(rows):
        row = np.uint64((top + (2 * r + 1) * (bottom - top) // (2 * rows)) * columns)
        for n in range(a_row):
            begin = row + begins[n]
            total: Any = np.int64(0)
            for k in range(np.uint64(_BLOCK - 1)):
                step = np.int64(levels[begin + k + beside]) - np.int64(levels[begin + k])
                total += step * step
            sums[r * a_row + n] = total
            counts[min(total, _SUMS - 1)] += 1
    wanted = int(_QUANTILE * (sums.size - 1))
    upto: Any = 0
    for low in range(_SUMS - 1):
        upto += counts[low]
        if upto > wanted:
            return low
    return int(nth_smallest(sums, wanted))
