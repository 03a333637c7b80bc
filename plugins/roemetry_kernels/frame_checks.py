"""What the core's checks for damaged frames ask of an image, compiled: the core has no compiled code.

Whether all rows and all columns differ, for the check for lines that no sensor gives. A sensor's noise makes
every line another one, so a few pixels of each nearly always tell that all is well. Rows are compared by
three words of eight bytes at their middle, columns by every eighth of 192 pixels, each as a number of 64 bits
that is looked for among those of the lines before.

How many steps of the grey level there are between rows and between columns, for the check for joined frames.
Whole arrays of numpy pass ten times over all pixels. Here each pixel is fetched once, in numbers as narrow as
the pixels are, and pieces of rows that are dark throughout are passed over.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Integers
from roemetry_kernels.compiling import inlined, kernel
from roemetry_kernels.image_levels import plain_layout

_WORD = 8
"""Pixels of a byte that are looked at as one number."""
_WORDS = 3
"""Of each row. Lines of the same words may differ elsewhere: that is left to the core."""
_APART, _SAMPLES = 8, 24
"""Every eighth pixel of a column, so many of them: where noise is blurred, neighbours tell little more."""
_ODD = np.uint64(0x9E3779B97F4A7C15)
"""An odd number of 64 bits, whose products mix them."""
_BAND = 16
"""Rows that are looked at together: what is found in a column of them fits into a byte."""


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


def count_steps(pixels: NDArray[Any], least: int) -> tuple[Integers, Integers, Integers]:
    """Count steps by more than `least` at each boundary between two rows, and between two columns.

    Parameters
    ----------
    pixels
        (row, column) grey levels of 8 or 16 bits.
    least
        Grey levels.

    Returns
    -------
    tuple
        (rows − 1,) steps from row to row; (columns − 1,) from column to column; and (columns − 1,) those of
        the latter that may be a break of the image: from the pixel before to that after, the grey level
        changes by no more than one and a half steps. The first and the last of these mean nothing.
    """
    plain = plain_layout(pixels)
    rows, columns = plain.shape
    by_row, by_column, breaks = (np.zeros(many, np.int64) for many in (rows, columns, columns))
    steps = _steps_of_bytes if plain.dtype == np.uint8 else _steps_of_pairs
    steps(plain, least, by_row, by_column, breaks)
    return by_row[1:], by_column[:-1], breaks[:-1]


def _counting_made(kind: type[np.unsignedinteger[Any]]) -> Any:
    """Compile the counting for pixels of one type: in wider numbers it would take several times as long."""

    @kernel
    def count(
        pixels: NDArray[Any], least: int, by_row: Integers, by_column: Integers, breaks: Integers
    ) -> None:
        """Add to the counts of each row and column; see `count_steps`."""
        rows, columns = pixels.shape
        high, low = np.zeros(columns + 1, kind), np.zeros(columns + 1, kind)
        steep, broken = np.empty(columns, kind), np.empty(columns, kind)
        lit = np.zeros(-(-columns // _WORD) * _WORD, np.uint8)
        words = lit.view(np.uint64)
        enough, one, two, three, four = kind(least), np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
        wide = np.uint64(columns)
        x: Any
        y: Any
        for band in range(0, rows, _BAND):
            first, end = np.uint64(max(band - 1, 0)), np.uint64(min(band + _BAND, rows))
            for x in range(wide):
                high[x] = low[x] = pixels[first, x]
            y = first + one
            while y + three < end:  # four rows at a time: what is compared stays in registers
                for x in range(wide):
                    a, b, c, d = pixels[y, x], pixels[y + one, x], pixels[y + two, x], pixels[y + three, x]
                    high[x] = max(high[x], max(max(a, b), max(c, d)))
                    low[x] = min(low[x], min(min(a, b), min(c, d)))
                y += four
            while y < end:
                for x in range(wide):
                    high[x], low[x] = max(high[x], pixels[y, x]), min(low[x], pixels[y, x])
                y += one
            high[wide], low[wide] = high[wide - one], low[wide - one]
            # two columns that differ by no more over all of the band hold no step
            for x in range(wide):
                most, lowest = max(high[x], high[x + one]), min(low[x], low[x + one])
                lit[x] = kind(most - lowest) > enough
            # only from the first such word to the last
            begin, last = 0, words.shape[0]
            while begin < last and words[begin] == 0:
                begin += 1
            while last > begin and words[last - 1] == 0:
                last -= 1
            if begin == last:
                continue
            left, right = np.uint64(begin * _WORD), min(last * _WORD, columns)
            for y in range(first + one, end):
                found = 0
                for x in range(left, np.uint64(right)):
                    here, above = pixels[y, x], pixels[y - one, x]
                    found += kind(max(here, above) - min(here, above)) > enough
                by_row[y] += found
            for x in range(left, np.uint64(right)):
                steep[x] = broken[x] = 0
            inner, outer = np.uint64(max(begin * _WORD, 1)), np.uint64(max(min(right, columns - 2), 0))
            for y in range(np.uint64(band), end):
                for x in range(left, np.uint64(min(right, columns - 1))):
                    here, after = pixels[y, x], pixels[y, x + one]
                    steep[x] = kind(steep[x] + kind(kind(max(here, after) - min(here, after)) > enough))
                for x in range(inner, outer):
                    here, after = pixels[y, x], pixels[y, x + one]
                    before, beyond = pixels[y, x - one], pixels[y, x + two]
                    step = kind(max(here, after) - min(here, after))
                    far = kind(max(before, beyond) - min(before, beyond))
                    more = kind(max(far, step) - step)
                    breaks_off = kind(step > enough) & kind(more <= kind(step >> kind(1)))
                    broken[x] = kind(broken[x] + breaks_off)
            for x in range(left, np.uint64(right)):
                by_column[x] += steep[x]
                breaks[x] += broken[x]

    return count


_steps_of_bytes = _counting_made(np.uint8)
_steps_of_pairs = _counting_made(np.uint16)
