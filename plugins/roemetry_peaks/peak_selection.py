"""Which stripes are left out: too narrow, too wide, or too faint beside the others; compiled.

Overexposed stripes with glare beside them, told by the rows above and below; compiled.

In glare as bright as half a stripe's height, or as the stripe itself, a row shows one wide run of light. But
a stripe's flanks go on from row to row: where one goes on, and the other one jumps away, what lies beyond the
stripe's width is glare.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.image_levels import outshone, usual_height
from roemetry_peaks.peak_scan import WORD, Places

# Unsigned, which no index from the end can be.
_ONE, _TWO, _THREE, _FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@float_kernel
def unfit_stripes(
    row: Places,
    width_min_px: float,
    width_max_px: float,
    share_min: float,
    height_min: float,
    values: Floats,
) -> NDArray[np.uint64]:
    """Give the numbers of what is no stripe.

    The other parameters are those of `roemetry_peaks.peak_window.stripes_around`.

    Parameters
    ----------
    row, values
        (peak,), (6, peak) image row; middle, width, amplitude, background, slope, unsure.
    """
    middles, widths, heights = values[0], values[1], values[2]
    count = row.shape[0]
    unfit, highest, lowest = 0, 0.0, np.inf
    for i in range(np.uint64(count)):
        unfit += 0 if (widths[i] >= width_min_px) & (widths[i] <= width_max_px) else 1
        highest, lowest = max(highest, heights[i]), min(lowest, heights[i])
    if unfit == 0 and lowest >= max(share_min * highest, height_min):
        return np.empty(0, np.uint64)
    least = max(share_min * usual_height(row, heights) if share_min > 0.0 else -np.inf, height_min)
    # Nearly all are kept: which may not be is asked of many at a time, and only those are looked at.
    looked_at, clear = np.zeros(-(-count // WORD) * WORD, np.uint8), max(share_min * highest, least)
    for i in range(np.uint64(count)):
        fits = (heights[i] >= clear) & (widths[i] >= width_min_px) & (widths[i] <= width_max_px)
        looked_at[i] = 0 if fits else 1
    words = looked_at.view(np.uint64)
    dropped, gone = np.empty(count, np.uint64), np.uint64(0)
    for word in range(np.uint64(words.shape[0])):
        if words[word] == 0:
            continue
        begin = np.int64(word) * WORD
        for i in range(begin, min(begin + WORD, count)):
            low = heights[i] < share_min * highest
            low = heights[i] < least or (low and outshone(row, middles, heights, i, share_min))
            dropped[gone] = i
            gone += np.uint64(low or not width_min_px <= widths[i] <= width_max_px)
    return dropped[:gone]


@float_kernel
def closed_up(
    dropped: NDArray[np.uint64],
    row: NDArray[np.int64],
    places: NDArray[np.int32],
    flags: NDArray[np.uint8],
    values: Floats,
) -> int:
    """Leave out those stripes, in place; gives the number of those that are left, which stand first.

    The other parameters are those that `roemetry_peaks.peak_window.stripes_around` gives.
    """
    gone = dropped.shape[0]
    if gone > 0:
        _closed_up(row, dropped, gone)
        _closed_up(flags, dropped, gone)
        for side in range(places.shape[0]):
            _closed_up(places[side], dropped, gone)
        for field in range(values.shape[0]):
            _closed_up(values[field], dropped, gone)
    return row.shape[0] - gone


@inlined
def _closed_up(numbers: Any, dropped: NDArray[np.uint64], gone: int) -> None:
    """Move numbers forwards over those that are dropped."""
    for g in range(np.uint64(gone)):
        by, k = g + _ONE, dropped[g] + _ONE
        end = dropped[by] if by < np.uint64(gone) else np.uint64(numbers.shape[0])
        # Four are read before one is written: so they move together.
        while k + _FOUR <= end:
            first, second, third, fourth = (
                numbers[k],
                numbers[k + _ONE],
                numbers[k + _TWO],
                numbers[k + _THREE],
            )
            to = k - by
            numbers[to], numbers[to + _ONE], numbers[to + _TWO] = first, second, third
            numbers[to + _THREE] = fourth
            k += _FOUR
        while k < end:
            numbers[k - by] = numbers[k]
            k += _ONE


GLARE = 128
"""Flag of a stripe of which one flank lies in glare, in no record: its middle is all that is known of it."""

TOO_WIDE = 2.0
"""Times as wide as stripes are on the mean: if none is, nothing is looked at."""
GLARING = 0.97
"""Of white, that a stripe with glare beside it reaches."""
_GOES_ON, _GOES_ON_PX = 0.25, 2.0  # of the stripe's width, and in px, from where a flank was leading
_JUMP, _JUMP_PX = 0.5, 3.0  # of the stripe's width, and in px, that a flank is farther out in glare
_KNOWN_ROWS = 5  # that a stripe has gone on for before
_ROWS_MAX = 40  # in glare
_TURNS = 0.2  # by how much each row counts in what a stripe leans and how wide it is


@float_kernel
def take_off_glare(
    white: int,
    share_min: float,
    row: NDArray[np.int64],
    flags: NDArray[np.uint8],
    values: Floats,
) -> None:
    """Give stripes of which one flank lies in glare the width that they had before, in place.

    Parameters
    ----------
    white
        Grey level from which on a pixel is saturated.
    share_min
        Of the highest stripe's height: what is lower, such as ripples beside stripes, is not followed.
    row, flags, values
        What `stripe_footing.stripes_around` fills, sorted; `GLARE` is added to `flags`.
    """
    middles, widths = values[0], values[1]
    least = share_min * np.max(values[2])
    seen_middles, seen_widths = middles.copy(), widths.copy()
    count = row.shape[0]
    left, right = np.empty(count), np.empty(count)
    lean, width, known, rows = np.zeros(count), np.empty(count), np.zeros(count), np.zeros(count)
    for way in (1, -1):
        first = 0 if way > 0 else count - 1
        begin = end = here = first  # those of the row before, and where this row begins
        for k in range(count):
            i = first + way * k
            if row[i] != row[here]:
                begin, end = here, i
                here = i
                if way * (row[i] - row[begin]) != 1:
                    begin = end
            left[i], right[i] = seen_middles[i] - 0.5 * seen_widths[i], seen_middles[i] + 0.5 * seen_widths[i]
            if values[2, i] < least:
                left[i] = right[i] = np.nan  # near to nothing
            lean[i], width[i], known[i], rows[i] = 0.0, seen_widths[i], 0.0, 0.0
            p = _before(left, right, lean, width, known, i, begin, end, way)
            if p < 0:
                continue
            off_left, off_right = left[i] - left[p] - lean[p], right[i] - right[p] - lean[p]
            jump = max(_JUMP * width[p], _JUMP_PX)
            if max(abs(off_left), abs(off_right)) <= jump:
                turns = _TURNS if known[p] > 0.0 else 1.0
                lean[i] = lean[p] + turns * 0.5 * (off_left + off_right)
                width[i] = width[p] + _TURNS * (seen_widths[i] - width[p])
                known[i] = known[p] + 1.0
                continue
            bright = min(values[2, i] + values[3, i], values[2, p] + values[3, p]) >= GLARING * white
            if not (bright and known[p] >= _KNOWN_ROWS and rows[p] < _ROWS_MAX):
                continue
            near = max(_GOES_ON * width[p], _GOES_ON_PX)
            if abs(off_left) < near and off_right > jump:
                left[i] -= (1.0 - _TURNS) * off_left
                right[i] = left[i] + width[p]
            elif abs(off_right) < near and off_left < -jump:
                right[i] -= (1.0 - _TURNS) * off_right
                left[i] = right[i] - width[p]
            else:
                continue
            lean[i], width[i], known[i], rows[i] = lean[p], width[p], known[p], rows[p] + 1.0
            if width[p] < widths[i]:
                middles[i], widths[i] = 0.5 * (left[i] + right[i]), width[p]
                flags[i] |= GLARE


@inlined
def _before(
    left: Floats,
    right: Floats,
    lean: Floats,
    width: Floats,
    known: Floats,
    i: int,
    begin: int,
    end: int,
    way: int,
) -> int:
    """Give the stripe of the row before that goes on as one; −1 for none.

    That is the one of which both flanks go on, else of those known and of which one does the narrowest: glare
    that has gone on for some rows is wide.
    """
    before, narrowest = -1, np.inf
    p = begin
    while p != end:
        off_left, off_right = abs(left[i] - left[p] - lean[p]), abs(right[i] - right[p] - lean[p])
        near = max(_GOES_ON * width[p], _GOES_ON_PX)
        if max(off_left, off_right) < near:
            return p
        if min(off_left, off_right) < near and known[p] >= _KNOWN_ROWS and width[p] < narrowest:
            before, narrowest = p, width[p]
        p += way
    return before
