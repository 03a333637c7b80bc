"""Whether all rows and all columns of an image differ, told for certain by a few pixels of each.

For the core's check for lines that no sensor gives. A sensor's noise makes every line another one, so a few
pixels of each nearly always tell that all is well. Rows are compared by three words of eight bytes at their
middle, columns by every eighth of 192 pixels, each as a number of 64 bits that is looked for among those of
the lines before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import inlined, kernel
from roemetry_kernels.image_levels import plain_layout

_WORD = 8
_WORDS = 3
"""Of each row. Lines of the same words may differ elsewhere: that is left to the core."""
_APART, _SAMPLES = 8, 24
"""Every eighth pixel of a column, so many of them: where noise is blurred, neighbours tell little more."""
_ODD = np.uint64(0x9E3779B97F4A7C15)
"""An odd number of 64 bits, whose products mix them."""


def lines_differ(pixels: NDArray[Any]) -> bool:
    """Say for certain that no row and no column is of one level or like another; False tells nothing.

    Parameters
    ----------
    pixels
        (row, column) grey levels of 8 or 16 bits.
    """
    plain = plain_layout(pixels)
    rows, columns = plain.shape
    length = columns * plain.itemsize
    if rows < _APART * _SAMPLES or length < _WORDS * _WORD or length % _WORD:
        return False
    words = plain.view(np.uint64)
    return bool(words.flags.aligned and _rows_differ(words) and _columns_differ(plain))


@kernel
def _rows_differ(words: NDArray[np.uint64]) -> bool:
    """Compare rows by words at their middle."""
    rows, first = words.shape[0], (words.shape[1] - _WORDS) // 2
    sums = np.empty(rows, np.uint64)
    level = False
    for y in range(rows):
        one, two, three = words[y, first], words[y, first + 1], words[y, first + 2]
        level |= one == two
        sums[y] = ((one * _ODD + two) * _ODD + three) * _ODD
    return not level and _all_differ(sums)


@kernel
def _columns_differ(pixels: NDArray[Any]) -> bool:
    """Compare columns by some of their pixels, half-way down."""
    rows, columns = pixels.shape
    begin = (rows - _APART * _SAMPLES) // 2
    sums = np.zeros(columns, np.uint64)
    low, high = pixels[begin].copy(), pixels[begin].copy()
    for k in range(_SAMPLES):
        y = np.uint64(begin + _APART * k)
        for x in range(np.uint64(columns)):
            here = pixels[y, x]
            sums[x] = sums[x] * _ODD + np.uint64(here)
            low[x], high[x] = min(low[x], here), max(high[x], here)
    for x in range(columns):
        if low[x] == high[x]:
            return False
        sums[x] *= _ODD
    return _all_differ(sums)


@inlined
def _all_differ(sums: NDArray[np.uint64]) -> bool:
    """Look for each number among those before, in a table of twice as many places by its highest bits."""
    bits = 1
    while (1 << bits) < 2 * sums.size:
        bits += 1
    places = np.zeros(1 << bits, np.uint64)
    shift, last, one, none = np.uint64(64 - bits), np.uint64((1 << bits) - 1), np.uint64(1), np.uint64(0)
    for k in range(sums.size):
        number = sums[k] | one  # no number is 0, which marks an empty place
        at = number >> shift
        while places[at] != none:
            if places[at] == number:
                return False
            at = (at + one) & last
        places[at] = number
    return True
