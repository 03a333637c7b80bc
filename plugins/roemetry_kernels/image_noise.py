"""The noise of an image, estimated from the image itself, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry_kernels.compiling import kernel

_BLOCK = 16  # pixels whose differences are looked at together
_BLOCKS_MAX = 1024  # looked at in all: the estimate is then good to 2 %
_QUANTILE = 0.2  # of the blocks' noise: the dark ones, without stripes and texture
_QUANTILE_OF_CHI = 0.791
"""That quantile of the root mean square of 15 differences of white noise, over the true one; found by drawing
ten million blocks."""
_QUANTISATION = 1.0 / np.sqrt(12.0)


def image_noise(image: NDArray[Any], top: int, bottom: int, left: int, right: int) -> float:
    """Estimate the standard deviation of the noise in the dark parts of an image, grey levels.

    From differences of neighbouring pixels in blocks of 16 (a low quantile of the blocks). Never
    less than the rounding to whole grey levels has.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels, contiguous and read-only.
    top, bottom, left, right
        The part that is looked at: rows and columns from the first to the one after the last.
    """
    squares = np.empty(_BLOCKS_MAX)
    count = _block_squares(image, top, bottom, left, right, squares)
    if count == 0:
        return float(_QUANTISATION)
    at = int(_QUANTILE * (count - 1))
    low = float(np.partition(squares[:count], at)[at])
    return float(max(np.sqrt(low / 2.0) / _QUANTILE_OF_CHI, _QUANTISATION))


@kernel
def _block_squares(image: NDArray[Any], top: int, bottom: int, left: int, right: int, squares: Floats) -> int:
    """Mean squares of first differences in blocks spread evenly over the image; gives their number."""
    across = (right - left) // _BLOCK
    blocks = across * (bottom - top)
    count = min(blocks, squares.shape[0])
    for n in range(count):
        block = n * blocks // count
        f = image[top + block // across]
        begin = left + _BLOCK * (block % across)
        total = np.int64(0)
        for k in range(begin + 1, begin + _BLOCK):
            step = np.int64(f[k]) - np.int64(f[k - 1])
            total += step * step
        squares[n] = total / (_BLOCK - 1.0)
    return count
