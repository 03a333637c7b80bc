"""What stands around the top of a peak: one stripe or two, width at half height, background; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry.records.peaks import EDGE, SATURATED
from roemetry_kernels.compiling import kernel
from roemetry_kernels.stripe_scan import Area, Pixels, Places, Tops

FWHM_OF_SIGMA = 2.354820045030949

_SEEN_PX = 64  # how far from a top its surroundings are looked at
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
    count = _join(image, area.left, area.right, width_min_px, *tops)
    row, places = np.empty(count, np.int64), np.empty((2, count), np.int32)
    flags, values = np.empty(count, np.uint8), np.empty((6, count))
    first = tops.first[:count], tops.last[:count]
    limits = area.left, area.right, white, width_min_px, width_max_px
    count = _measure(image, *limits, tops.row[:count], *first, row, places, flags, values)
    return Stripes(row[:count], *places[:, :count], flags[:count], *values[:, :count])


@kernel
def _join(
    image: Pixels, left: int, right: int, width_min_px: float, row: Places, first: Places, last: Places
) -> int:
    """Leave out spikes and join tops of one stripe, in place; gives the number of peaks that are left.

    Of joined tops the first pixel of the first and the last pixel of the last are kept.
    """
    count = 0
    for i in range(row.shape[0]):
        f = image[row[i]]
        if _spike_width(f, first[i], last[i], left, right) < width_min_px:
            continue
        p = count - 1
        near = p >= 0 and row[p] == row[i] and first[i] - last[p] <= _SEEN_PX
        if near and _is_one(f, first[p], last[p], first[i], last[i], left, right):
            last[p] = last[i]
            continue
        row[count], first[count], last[count] = row[i], first[i], last[i]
        count += 1
    return count


@kernel
def _spike_width(f: Pixels, first: int, last: int, left: int, right: int) -> float:
    """Full width at half height of a top that both neighbours lie below half of; infinite for any other."""
    if first == left or last + 1 == right:
        return np.inf
    high = float(f[first])
    before, after = high - float(f[first - 1]), high - float(f[last + 1])
    half = 0.5 * (high - float(_base(f, first, last, left, right)))
    if before < half or after < half:
        return np.inf
    return half / before + half / after + (last - first)


@kernel
def _base(f: Pixels, first: int, last: int, left: int, right: int) -> int:
    """Give the lowest grey level around a top."""
    return min(
        lowest(f, max(left, first - _SEEN_PX), first),
        lowest(f, last + 1, min(right, last + 1 + _SEEN_PX)),
    )


@kernel
def _is_one(f: Pixels, first: int, last: int, next_first: int, next_last: int, left: int, right: int) -> bool:
    """Whether the valley between two tops is a dent in one stripe."""
    lower = min(float(f[first]), float(f[last]))
    lower = min(lower, float(f[next_first]))
    at = last + 1
    for x in range(last + 1, next_first):
        if f[x] < f[at]:
            at = x
    valley = (float(f[at - 1]) + float(f[at]) + float(f[at + 1])) / 3.0
    base = float(_base(f, first, next_last, left, right))
    return lower - valley < _SHALLOW * (lower - base)


@kernel
def lowest(f: Pixels, begin: int, end: int) -> int:
    """Give the lowest grey level from `begin` up to `end`, of the pixel at `begin` if there are none."""
    low = f[min(begin, f.shape[0] - 1)]
    for x in range(begin, end):
        low = min(low, f[x])
    return np.int64(low)  # type: ignore[return-value]


@kernel
def crossings(f: Pixels, level: float, first: int, last: int, lo: int, hi: int) -> tuple[float, float]:
    """Columns, px, where the grey levels `f` cross a level on both sides of a top, between pixels.

    Where they do not within `lo` … `hi`, the crossing is put there.
    """
    while f[first] < level and first < last:
        first += 1
    while f[last] < level and last > first:
        last -= 1
    x = first
    while x > lo and f[x] >= level:
        x -= 1
    left = float(x)
    if f[x] < level:
        left += (level - f[x]) / (float(f[x + 1]) - float(f[x]))
    x = last
    while x < hi and f[x] >= level:
        x += 1
    right = float(x)
    if f[x] < level:
        right -= (level - f[x]) / (float(f[x - 1]) - float(f[x]))
    return left, right


@kernel
def _foot(f: Pixels, begin: int, end: int, high: float) -> float:
    """Mean grey level of the pixels from `begin` up to `end`; levels above `high` count as `high`."""
    total = 0.0
    for x in range(begin, end):
        total += min(float(f[x]), high)
    return total / max(end - begin, 1)


@kernel
def _measure(
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
    places: NDArray[np.int32],
    flags: NDArray[np.uint8],
    values: Floats,
) -> int:
    """Fill the fields of `Stripes`; gives the number of those within the width limits."""
    count = 0
    for i in range(row.shape[0]):
        f = image[row[i]]
        begin, end = first[i], last[i]
        lo, hi = left, right - 1
        if i > 0 and row[i - 1] == row[i]:
            lo = (last[i - 1] + begin + 1) // 2
        if i + 1 < row.shape[0] and row[i + 1] == row[i]:
            hi = (end + first[i + 1]) // 2
        high = 0.0
        for x in range(begin, end + 1):
            high = max(high, float(f[x]))
        low_left = float(lowest(f, max(lo, begin - _SEEN_PX), begin))
        low_right = float(lowest(f, end + 1, min(hi, end + _SEEN_PX) + 1))
        base = max(low_left, low_right)
        from_px, to_px = crossings(f, 0.5 * (high + base), begin, end, lo, hi)
        middle, width = 0.5 * (from_px + to_px), to_px - from_px
        if not width_min_px <= width <= width_max_px:
            continue
        reach = _FEET_FROM * width / FWHM_OF_SIGMA
        cap = base + _FEET_SHARE_MAX * (high - base)
        inner_left = min(max(int(middle - reach) + 1, lo), begin)
        inner_right = max(min(int(middle + reach) + 1, hi + 1), end + 1)
        outer_left, outer_right = max(inner_left - _FEET_PX, lo), min(inner_right + _FEET_PX, hi + 1)
        level_left, level_right = (
            _foot(f, outer_left, inner_left, cap),
            _foot(f, inner_right, outer_right, cap),
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
        places[0, count], places[1, count] = lo, hi
        values[0, count], values[1, count], values[2, count] = middle, width, high - background
        values[3, count], values[4, count], values[5, count] = background, slope, unsure
        margin = _EDGE_SIGMAS * width / FWHM_OF_SIGMA
        flags[count] = (SATURATED if high >= white else 0) | (
            EDGE if middle - margin < left or middle + margin > right - 1 else 0
        )
        count += 1
    return count
