"""Which stripes are left out: too narrow, too wide, or too faint beside the others; compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.extraction.lane_steps import WORD
from roemetry_kernels.extraction.local_contrast import outshone, usual_height
from roemetry_kernels.extraction.stripe_scan import Places

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

    The other parameters are those of `roemetry_kernels.extraction.stripe_footing.stripes_around`.

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

    The other parameters are those that `roemetry_kernels.extraction.stripe_footing.stripes_around` gives.
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
