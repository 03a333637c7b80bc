"""The centre of gravity of a stripe's profile above its background, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry.records.peaks import EDGE, SATURATED
from roemetry_kernels.compiling import kernel
from roemetry_kernels.stripe_footing import FWHM_OF_SIGMA, between, footing
from roemetry_kernels.stripe_scan import Pixels, Places

_REACH = 2.4  # standard deviations to both sides that are summed over


@kernel
def centres_of_gravity(
    image: Pixels,
    left: int,
    right: int,
    white: int,
    width_min_px: float,
    width_max_px: float,
    row: Places,
    first: Places,
    last: Places,
    out_row: NDArray[np.int64],
    out: Floats,
    flags: NDArray[np.uint8],
) -> int:
    """Measure peaks by their centre of gravity; gives the number of those within the width limits.

    Parameters
    ----------
    image
        (row, column) grey levels, contiguous and read-only.
    left, right
        Columns that may be used, from the first to the one after the last.
    white
        Grey level from which on a pixel is saturated.
    width_min_px, width_max_px
        Full width at half height of what may be a stripe, px.
    row, first, last
        (peak,) as `roemetry_kernels.stripe_scan.stripe_tops` gave them.
    out_row, out, flags
        (peak,), (5, peak), (peak,) to be filled: row; x_px, x_std_px, amplitude, background, width_px; flags.
    """
    count = 0
    for i in range(row.shape[0]):
        f = image[row[i]]
        lo, hi = between(row, first, last, i, left, right)
        middle, width, amplitude, background, slope, _ = footing(f, first[i], last[i], lo, hi)
        if not width_min_px <= width <= width_max_px:
            continue
        reach = _REACH * width / FWHM_OF_SIGMA
        begin, end = middle - reach, middle + reach
        total = moment = 0.0
        for x in range(max(lo, int(np.floor(begin + 0.5))), min(hi, int(np.floor(end + 0.5))) + 1):
            inside = min(1.0, min(x + 0.5 - begin, end - x + 0.5))
            level = inside * (f[x] - background - slope * (x - middle))
            total += level
            moment += level * (x - middle)
        if not total > 0.0 or not abs(moment) < 0.5 * width * total:
            continue
        out_row[count] = row[i]
        out[0, count] = middle + moment / total
        out[1, count] = np.nan
        out[2, count] = amplitude
        out[3, count] = background
        out[4, count] = width
        flags[count] = 0
        if f[first[i]] >= white:
            flags[count] |= SATURATED
        if begin <= left or end >= right - 1:
            flags[count] |= EDGE
        count += 1
    return count
