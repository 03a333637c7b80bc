"""What stands around the top of a peak: one stripe or two, width at half height, background; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry.records.peaks import EDGE, SATURATED
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.stripe_scan import Area, Pixels, Places, Tops

FWHM_OF_SIGMA = 2.354820045030949

_SEEN_PX = 64  # how far from a top its surroundings are looked at
_NEAR_PX = 4  # where a stripe of usual width has fallen to the background
_BLOCK = 16  # pixels looked at together: one vector
_DARKER = 0.125  # of the height: by less it does not get darker
_SHALLOW = 0.45  # a valley less deep than that share of the lower of two tops is a dent in one stripe
_FEET_FROM = 3.6  # standard deviations from the middle: what lies farther out is background
_FEET_PX = 8  # pixels on each side that the background is taken from
_FEET_SHARE_MAX = 0.25  # of the amplitude: what is brighter is taken for that much (hot pixels)
_EDGE_SIGMAS = 2.5  # a stripe nearer to the border than that is not seen whole


class Stripes(NamedTuple):
    """Stripes that cross image rows, measured roughly, sorted by row, then column; one element a peak.

    Attributes
    ----------
    row : ndarray of int64, shape (peak,)
        Image row.
    lo, hi : ndarray of int32, shape (peak,)
        First and last column that belong to no neighbouring stripe.
    flags : ndarray of uint8, shape (peak,)
        `SATURATED` and `EDGE` of `roemetry.records.peaks`.
    middle : ndarray of float64, shape (peak,)
        Middle between the crossings of half height, px.
    width : ndarray of float64, shape (peak,)
        Full width there, px.
    amplitude : ndarray of float64, shape (peak,)
        Highest grey level above the background.
    background, slope : ndarray of float64, shape (peak,)
        Grey level of the background at `middle`, and its slope, grey levels per px.
    unsure : ndarray of float64, shape (peak,)
        (variance of the slope) / (variance of a background pixel), 1/px².
    """

    row: NDArray[np.int64]
    lo: Places
    hi: Places
    flags: NDArray[np.uint8]
    middle: Floats
    width: Floats
    amplitude: Floats
    background: Floats
    slope: Floats
    unsure: Floats


def stripes_around(
    image: Pixels, tops: Tops, area: Area, *, white: int, width_min_px: float, width_max_px: float
) -> Stripes:
    """Measure what stands around tops, join tops of one stripe, leave out what is too narrow or too wide.

    Two tops belong to one stripe if the valley between them (mean of three pixels) is shallow: less than 0.45
    of the lower top's height above the lowest levels around both. The background is a line through the means
    of up to 8 pixels on both sides, from 3.6 standard deviations outwards, not past halfway to a neighbour.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels, contiguous and read-only.
    tops
        As `roemetry_kernels.stripe_scan.stripe_tops` gave them; changed.
    area
        What is looked at.
    white
        Grey level from which on a pixel is saturated.
    width_min_px, width_max_px
        Full width at half height of what may be a stripe, px.
    """
    levels, columns = image.reshape(-1), image.shape[1]
    count = _join(levels, columns, area.left, area.right, width_min_px, *tops)
    row, places = np.empty(count, np.int64), np.empty((2, count), np.int32)
    flags, values = np.empty(count, np.uint8), np.empty((6, count))
    first = tops.first[:count], tops.last[:count]
    limits = area.left, area.right, white, width_min_px, width_max_px
    count = _measure(levels, columns, *limits, tops.row[:count], *first, row, places, flags, values)
    lo, hi = places[:, :count]
    middle, width, amplitude, background, slope, unsure = values[:, :count]
    return Stripes(row[:count], lo, hi, flags[:count], middle, width, amplitude, background, slope, unsure)


@float_kernel
def _join(
    levels: Pixels,
    columns: int,
    left: int,
    right: int,
    width_min_px: float,
    row: Places,
    first: Places,
    last: Places,
) -> int:
    """Leave out spikes and join tops of one stripe, in place; gives the number of peaks that are left.

    Of joined tops the first pixel of the first and the last pixel of the last are kept.
    """
    count = 0
    for i in range(row.shape[0]):
        at = row[i] * columns
        if _spike_width(levels, at + first[i], at + last[i], at + left, at + right) < width_min_px:
            continue
        p = count - 1
        near = p >= 0 and row[p] == row[i] and first[i] - last[p] <= _SEEN_PX
        if near and _is_one(
            levels, at + first[p], at + last[p], at + first[i], at + last[i], at + left, at + right
        ):
            last[p] = last[i]
            continue
        row[count], first[count], last[count] = row[i], first[i], last[i]
        count += 1
    return count


@inlined
def _spike_width(levels: Pixels, first: int, last: int, left: int, right: int) -> float:
    """Full width at half height of a top that both neighbours lie below half of; infinite for any other."""
    if first == left or last + 1 == right:
        return np.inf
    high = float(levels[first])
    before, after = high - float(levels[first - 1]), high - float(levels[last + 1])
    # Whatever lies a few pixels off is no lower than the base: that settles it for all but narrow tops.
    near = min(float(levels[max(first - _NEAR_PX, left)]), float(levels[min(last + _NEAR_PX, right - 1)]))
    if min(before, after) < 0.5 * (high - near):
        return np.inf
    half = 0.5 * (high - float(_base(levels, first, last, left, right)))
    if before < half or after < half:
        return np.inf
    return half / before + half / after + (last - first)


@inlined
def _base(levels: Pixels, first: int, last: int, left: int, right: int) -> int:
    """Give the lowest grey level around a top."""
    return min(
        _lowest_before(levels, max(left, first - _SEEN_PX), first),
        _lowest_after(levels, last + 1, min(right, last + 1 + _SEEN_PX)),
    )


@inlined
def _is_one(
    levels: Pixels, first: int, last: int, next_first: int, next_last: int, left: int, right: int
) -> bool:
    """Whether the valley between two tops is a dent in one stripe."""
    lower = min(min(float(levels[first]), float(levels[last])), float(levels[next_first]))
    # Halfway it is usually dark, which settles it: the base is not below black.
    valley = _mean_of_three(levels, (last + next_first) // 2)
    if lower - valley >= _SHALLOW * lower:
        return False
    for x in range(last + 1, next_first):
        valley = min(valley, _mean_of_three(levels, x))
    base = float(_base(levels, first, next_last, left, right))
    return lower - valley < _SHALLOW * (lower - base)


@inlined
def _mean_of_three(levels: Pixels, x: int) -> float:
    return (float(levels[x - 1]) + float(levels[x]) + float(levels[x + 1])) / 3.0


@inlined
def _lowest_before(levels: Pixels, begin: int, end: int) -> int:
    """Lowest grey level from `begin` up to `end`, looked for from `end` on while it gets darker."""
    low = int(levels[max(end - 1, begin)])
    x = end
    while x - _BLOCK >= begin:
        x -= _BLOCK
        found = _lowest_of_block(levels, x)
        if found + _DARKER * (int(levels[end]) - found) >= low and x + _BLOCK < end:
            return min(low, found)
        low = min(low, found)
    for k in range(begin, x):
        low = min(low, int(levels[k]))
    return low


@inlined
def _lowest_after(levels: Pixels, begin: int, end: int) -> int:
    """Lowest grey level from `begin` up to `end`, looked for from `begin` on while it gets darker."""
    low = int(levels[min(begin, end - 1)])
    x = begin
    while x + _BLOCK <= end:
        found = _lowest_of_block(levels, x)
        if found + _DARKER * (int(levels[begin - 1]) - found) >= low and x > begin:
            return min(low, found)
        low = min(low, found)
        x += _BLOCK
    for k in range(x, end):
        low = min(low, int(levels[k]))
    return low


@inlined
def _lowest_of_block(levels: Pixels, begin: int) -> int:
    # Unsigned, which no index from the end can be; four minima at a time, which need not wait for each other.
    at = np.uint64(begin)
    one, two, four = np.uint64(1), np.uint64(2), np.uint64(4)
    low_0, low_1 = levels[at], levels[at + one]
    low_2, low_3 = levels[at + two], levels[at + two + one]
    for k in range(four, np.uint64(_BLOCK), four):
        low_0, low_1 = min(low_0, levels[at + k]), min(low_1, levels[at + k + one])
        low_2, low_3 = min(low_2, levels[at + k + two]), min(low_3, levels[at + k + two + one])
    return int(min(min(low_0, low_1), min(low_2, low_3)))


@inlined
def _crossings(levels: Pixels, level: float, first: int, last: int, lo: int, hi: int) -> tuple[float, float]:
    """Places, px, where the grey levels cross a level on both sides of a top, between pixels.

    Where they do not within `lo` … `hi`, the crossing is put there.
    """
    whole = int(np.ceil(level))
    while levels[first] < whole and first < last:
        first += 1
    while levels[last] < whole and last > first:
        last -= 1
    x = first
    while x > lo and levels[x] >= whole:
        x -= 1
    left = float(x)
    if levels[x] < whole:
        left += (level - levels[x]) / (float(levels[x + 1]) - float(levels[x]))
    x = last
    while x < hi and levels[x] >= whole:
        x += 1
    right = float(x)
    if levels[x] < whole:
        right -= (level - levels[x]) / (float(levels[x - 1]) - float(levels[x]))
    return left, right


@inlined
def _foot(levels: Pixels, begin: int, end: int, high: float) -> float:
    """Mean grey level of the pixels from `begin` up to `end`; levels above `high` count as `high`."""
    total, most = np.int64(0), int(high)
    if end - begin == _FEET_PX:
        at = np.uint64(begin)
        for k in range(np.uint64(_FEET_PX)):
            total += min(int(levels[at + k]), most)
        return total / _FEET_PX
    for x in range(begin, end):
        total += min(int(levels[x]), most)
    return total / max(end - begin, 1)


@float_kernel
def _measure(
    levels: Pixels,
    columns: int,
    left: int,
    right: int,
    white: int,
    width_min_px: float,
    width_max_px: float,
    row: Places,
    first: Places,
    last: Places,
    out_row: NDArray[np.int64],
    places: NDArray[np.int32],
    flags: NDArray[np.uint8],
    values: Floats,
) -> int:
    """Fill the fields of `Stripes`; gives the number of those within the width limits."""
    count = 0
    for i in range(row.shape[0]):
        lo, hi = left, right - 1
        if i > 0 and row[i - 1] == row[i]:
            lo = (last[i - 1] + first[i] + 1) // 2
        if i + 1 < row.shape[0] and row[i + 1] == row[i]:
            hi = (last[i] + first[i + 1]) // 2
        # From here on places in `levels`, until they are written down.
        begins = row[i] * columns
        begin, end = begins + first[i], begins + last[i]
        lo, hi = begins + lo, begins + hi
        high = 0.0
        for x in range(begin, end + 1):
            high = max(high, float(levels[x]))
        base = float(
            max(
                _lowest_before(levels, max(lo, begin - _SEEN_PX), begin),
                _lowest_after(levels, end + 1, min(hi, end + _SEEN_PX) + 1),
            )
        )
        from_px, to_px = _crossings(levels, 0.5 * (high + base), begin, end, lo, hi)
        middle, width = 0.5 * (from_px + to_px), to_px - from_px
        if not width_min_px <= width <= width_max_px:
            continue
        reach = _FEET_FROM * width / FWHM_OF_SIGMA
        cap = base + _FEET_SHARE_MAX * (high - base)
        inner_left = min(max(int(middle - reach) + 1, lo), begin)
        inner_right = max(min(int(middle + reach) + 1, hi + 1), end + 1)
        outer_left, outer_right = max(inner_left - _FEET_PX, lo), min(inner_right + _FEET_PX, hi + 1)
        level_left, level_right = (
            _foot(levels, outer_left, inner_left, cap),
            _foot(levels, inner_right, outer_right, cap),
        )
        pixels_left, pixels_right = inner_left - outer_left, outer_right - inner_right
        slope = unsure = 0.0
        if pixels_left > 0 and pixels_right > 0:
            at_left = 0.5 * (outer_left + inner_left - 1)
            apart = 0.5 * (inner_right + outer_right - 1) - at_left
            slope = (level_right - level_left) / apart
            background = level_left + slope * (middle - at_left)
            unsure = (1.0 / pixels_left + 1.0 / pixels_right) / (apart * apart)
        elif pixels_left > 0:
            background = level_left
        elif pixels_right > 0:
            background = level_right
        else:
            background = base
        out_row[count] = row[i]
        places[0, count], places[1, count] = lo - begins, hi - begins
        middle -= begins
        values[0, count], values[1, count], values[2, count] = middle, width, high - background
        values[3, count], values[4, count], values[5, count] = background, slope, unsure
        margin = _EDGE_SIGMAS * width / FWHM_OF_SIGMA
        flags[count] = (SATURATED if high >= white else 0) | (
            EDGE if middle - margin < left or middle + margin > right - 1 else 0
        )
        count += 1
    return count
