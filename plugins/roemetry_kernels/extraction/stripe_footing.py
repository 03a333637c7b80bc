"""What stands around the top of a peak: one stripe or two, width at half height, background; compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry.records.peaks import EDGE, SATURATED
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.extraction.border_tops import mirrored
from roemetry_kernels.extraction.stripe_glare import GLARING, TOO_WIDE, take_off_glare
from roemetry_kernels.extraction.stripe_joining import SEEN_PX, join_tops, lowest_after, lowest_before
from roemetry_kernels.extraction.stripe_limits import limits_out_of_light
from roemetry_kernels.extraction.stripe_scan import Area, Pixels, Places, Tops
from roemetry_kernels.extraction.unfit_stripes import closed_up, unfit_stripes

FWHM_OF_SIGMA = 2.354820045030949

_FEET_FROM = 3.6  # standard deviations from the middle: what lies farther out is background
_FEET_PX = 8  # pixels on each side that the background is taken from
_FEET_SHARE_MAX = 0.25  # of the amplitude: what is brighter is taken for that much (hot pixels)
_BORDER_PX = 64  # nearer than that the border may cut off a stripe's foot
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
    image: Pixels,
    tops: Tops,
    area: Area,
    *,
    white: int,
    width_min_px: float,
    width_max_px: float,
    share_min: float = 0.0,
    height_min: float = 0.0,
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
        As `roemetry_kernels.extraction.stripe_scan.stripe_tops` gave them; changed.
    area
        What is looked at.
    white
        Grey level from which on a pixel is saturated.
    width_min_px, width_max_px
        Full width at half height of what may be a stripe, px.
    share_min
        What rises by less than this share of a stripe near by (16 px), or of what the highest stripe of a
        row usually has, is ringing, glare or what a JPEG made of noise: left out.
    height_min
        What stands less above the background beside it, grey levels, is a bump on bright ground: left out.
    """
    levels, columns = image.reshape(-1), image.shape[1]
    count = join_tops(levels, columns, area.left, area.right, width_min_px, *tops)
    row, places = np.empty(count, np.int64), np.empty((2, count), np.int32)
    flags, values, highs = np.empty(count, np.uint8), np.empty((6, count)), np.empty(count)
    found = tops.row[:count], tops.first[:count], tops.last[:count]
    done = np.zeros(count, np.uint8)
    sides = area.left, area.right
    limits = white, width_min_px, width_max_px, share_min, height_min
    count = _measure(levels, columns, *sides, *limits, *found, done, highs, row, places, flags, values)
    lo, hi = places[:, :count]
    middle, width, amplitude, background, slope, unsure = values[:, :count]
    return Stripes(row[:count], lo, hi, flags[:count], middle, width, amplitude, background, slope, unsure)


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
def _cut_off(levels: Pixels, half: float, begin: int, end: int, lo: int, hi: int, side: int) -> bool:
    """Say whether the border is nearer on a side than the stripe's foot, by its width on the other one."""
    from_px, to_px = _crossings(levels, half, begin, end, lo, hi)
    top = 0.5 * (begin + end)
    seen = top - lo if side < 0 else hi - top
    wide = to_px - top if side < 0 else top - from_px
    return seen < _FEET_FROM * 2.0 * wide / FWHM_OF_SIGMA


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
    share_min: float,
    height_min: float,
    row: Places,
    first: Places,
    last: Places,
    done: NDArray[np.uint8],
    highs: Floats,
    out_row: NDArray[np.int64],
    places: NDArray[np.int32],
    flags: NDArray[np.uint8],
    values: Floats,
) -> Any:
    """Fill the fields of `Stripes`; gives the number of those within the width limits."""
    count = row.shape[0]
    for i in range(count):
        if not done[i]:
            follows, leads = i > 0 and row[i - 1] == row[i], i + 1 < count and row[i + 1] == row[i]
            places[0, i] = (last[i - 1] + first[i] + 1) // 2 if follows else left
            places[1, i] = (last[i] + first[i + 1]) // 2 if leads else right - 1
    _measure_rest(levels, columns, left, right, white, row, first, last, done, highs, places, values)
    limits = width_min_px, width_max_px, share_min, height_min
    unfit = unfit_stripes(row, *limits, values)
    changed = limits_out_of_light(levels, columns, row, first, last, unfit, highs, places, done)
    if changed:
        _measure_rest(levels, columns, left, right, white, row, first, last, done, highs, places, values)
    # Loops that write to one place each, and unsigned numbers, which none from the end can be.
    middles, widths = values[0], values[1]
    for i in range(np.uint64(count)):
        margin = _EDGE_SIGMAS / FWHM_OF_SIGMA * widths[i]
        cut = (middles[i] - margin < left) | (middles[i] + margin > right - 1)
        flags[i] = (SATURATED if highs[i] >= white else 0) | (EDGE if cut else 0)
    for i in range(np.uint64(count)):
        out_row[i] = row[i]
    total, wide, glaring = 0.0, 0, GLARING * white
    for i in range(np.uint64(count)):
        total += widths[i]
    too_wide = TOO_WIDE * total / max(count, 1)
    for i in range(np.uint64(count)):
        wide += 1 if (widths[i] > too_wide) & (highs[i] >= glaring) else 0
    if wide > 0:
        take_off_glare(white, share_min, out_row, flags, values)
        changed = True
    if changed:
        unfit = unfit_stripes(row, *limits, values)
    return closed_up(unfit, out_row, places, flags, values)


@float_kernel
def _measure_rest(
    levels: Pixels,
    columns: int,
    left: int,
    right: int,
    white: int,
    row: Places,
    first: Places,
    last: Places,
    done: NDArray[np.uint8],
    highs: Floats,
    places: NDArray[np.int32],
    values: Floats,
) -> None:
    """Measure within `places` what is not done."""
    for i in range(row.shape[0]):
        if done[i]:
            continue
        lo, hi = places[0, i], places[1, i]
        at = row[i] * columns
        at_left, at_right = (
            lo == left and first[i] - lo < _BORDER_PX,
            hi == right - 1 and hi - last[i] < _BORDER_PX,
        )
        highs[i], middle, values[1, i], values[3, i], values[4, i], values[5, i] = _measured(
            levels, white, at + first[i], at + last[i], at + lo, at + hi, at_left, at_right
        )
        values[0, i], values[2, i] = middle - at, highs[i] - values[3, i]


@inlined
def _measured(
    levels: Pixels, white: int, begin: int, end: int, lo: int, hi: int, at_left: bool, at_right: bool
) -> tuple[float, float, float, float, float, float]:
    """Highest level, middle, width, background, slope, unsure of one stripe, from places in `levels`.

    Where the border (`at_left`, `at_right`) cuts a side off before its foot, that side tells neither the
    background nor, if it ends above half height, the width: the other one does.
    """
    high = 0.0
    for x in range(begin, end + 1):
        high = max(high, float(levels[x]))
    low_left = lowest_before(levels, max(lo, begin - SEEN_PX), begin)
    low_right = lowest_after(levels, end + 1, min(hi, end + SEEN_PX) + 1)
    base = float(max(low_left, low_right))
    if at_left or at_right:
        cut_left = at_left & _cut_off(levels, 0.5 * (high + low_right), begin, end, lo, hi, -1)
        cut_right = at_right & _cut_off(levels, 0.5 * (high + low_left), begin, end, lo, hi, 1)
        if cut_left != cut_right:
            base = float(low_right if cut_left else low_left)
    half = 0.5 * (high + base)
    from_px, to_px = _crossings(levels, half, begin, end, lo, hi)
    ends_left = at_left and from_px <= lo and levels[lo] >= half
    ends_right = at_right and to_px >= hi and levels[hi] >= half
    if ends_left != ends_right:
        top = 0.5 * (begin + end)
        if high >= white and ends_left and begin > lo:
            top = mirrored(levels, max(lo, begin - 2), begin, end, float(low_right), hi)
        elif high >= white and ends_right and end < hi:
            top = mirrored(levels, min(hi, end + 2), begin, end, float(low_left), lo)
        elif begin == end and lo < begin < hi:
            before, after = float(levels[begin - 1]), float(levels[begin + 1])
            top += 0.5 * (after - before) / max(2.0 * high - before - after, 1.0)
        if ends_left:
            from_px = 2.0 * top - to_px
        else:
            to_px = 2.0 * top - from_px
    middle, width = 0.5 * (from_px + to_px), to_px - from_px
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
        left_px = 0.5 * (outer_left + inner_left - 1)
        apart = 0.5 * (inner_right + outer_right - 1) - left_px
        slope = (level_right - level_left) / apart
        background = level_left + slope * (middle - left_px)
        unsure = (1.0 / pixels_left + 1.0 / pixels_right) / (apart * apart)
    elif pixels_left > 0:
        background = level_left
    elif pixels_right > 0:
        background = level_right
    else:
        background = base
    return high, middle, width, background, slope, unsure
