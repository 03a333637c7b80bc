"""What stands around the top of a peak: one stripe or two, width at half height, background.

Tops with a shallow valley between are one stripe; a top that both neighbours fall below half of may be a
spike. What belongs to a stripe ends halfway to the next top, or at the darkest pixel between where halfway
lies in the light of one. Half height lies between the top and the higher of the two sides' lowest levels;
width and middle are those of its crossings. The background is a straight line through up to 8 pixels on
both sides, from 3.6 standard deviations outwards.

Where the image's border cuts a side off, the other side tells background and width; of a top cut off at
white as well, a pixel on one flank is matched with its like on the other.

It fails where stripes stand so near to each other that the valley between is shallow: they are one then.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry.records.stripes import EDGE, SATURATED
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_peaks.peak_scan import (
    GLARING,
    TOO_WIDE,
    Pixels,
    Places,
    Tops,
    closed_up,
    take_off_glare,
    unfit_stripes,
)
from roemetry_peaks.searching import Area

FWHM_OF_SIGMA = 2.354820045030949  # √(8 ln 2), of a Gaussian

_FEET_FROM = 3.6  # standard deviations from the middle: what lies farther out is background
_FEET_PX = 8  # pixels on each side that the background is taken from
_FEET_SHARE_MAX = 0.25  # of the amplitude: what is brighter is taken for that much (hot pixels)
_BORDER_PX = 64  # nearer than that the border may cut off a stripe's foot
_EDGE_SIGMAS = 2.5  # a stripe nearer to the border than that is not seen whole


_ONE = np.uint64(1)  # unsigned, which no index from the end can be


class Stripes(NamedTuple):
    """Stripes that cross image rows, measured roughly, sorted by row, then column; one element a peak."""

    row: NDArray[np.int64]
    """(peak,) image row."""
    lo: Places
    hi: Places
    """lo, hi: (peak,) first and last column that belong to no neighbouring stripe."""
    flags: NDArray[np.uint8]
    """(peak,) `SATURATED` and `EDGE` of `roemetry.records.stripes`."""
    middle: Floats
    """(peak,) middle between the crossings of half height, px."""
    width: Floats
    """(peak,) full width there, px."""
    amplitude: Floats
    """(peak,) highest grey level above the background."""
    background: Floats
    slope: Floats
    """background, slope: (peak,) grey level of the background at `middle`, and its slope, grey levels per px.
    """
    unsure: Floats
    """(peak,) (variance of the slope) / (variance of a background pixel), 1/px²."""


class Rows(NamedTuple):
    """Grey levels, row after row, with a row's length; the columns searched; the saturated level."""

    levels: Pixels
    columns: int
    left: int
    right: int
    white: int


class Limits(NamedTuple):
    """What may be a stripe; see `stripes_around`."""

    width_min_px: float
    width_max_px: float
    share_min: float
    height_min: float


class Measured(NamedTuple):
    """What is measured of each top: `done` says of which already.

    `high` highest grey level; `places` (2, peak) first and last column that are its own; `values` (6, peak)
    middle, width, amplitude, background, slope, unsure.
    """

    done: NDArray[np.uint8]
    high: Floats
    places: NDArray[np.int32]
    values: Floats


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
        As `roemetry_peaks.peak_scan.stripe_tops` gave them; changed.
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
    rows = Rows(image.reshape(-1), image.shape[1], area.left, area.right, white)
    count = join_tops(rows, width_min_px, tops)
    tops = Tops(*(columns[:count] for columns in tops))
    places, values = np.empty((2, count), np.int32), np.empty((6, count))
    found = Measured(np.zeros(count, np.uint8), np.empty(count), places, values)
    row, flags = np.empty(count, np.int64), np.empty(count, np.uint8)
    limits = Limits(width_min_px, width_max_px, share_min, height_min)
    count = _measure(rows, tops, limits, found, row, flags)
    lo, hi = places[:, :count]
    middle, width, amplitude, background, slope, unsure = values[:, :count]
    return Stripes(row[:count], lo, hi, flags[:count], middle, width, amplitude, background, slope, unsure)


@inlined
def _crossings(levels: Pixels, level: float, first: int, last: int, lo: int, hi: int) -> tuple[float, float]:
    """Places, px, where the grey levels cross a level on both sides of a top, between pixels.

    Where they do not within `lo` … `hi`, the crossing is put there.
    """
    # grey levels are whole: not below the level is not below its ceiling
    whole, from_at, to_at = int(np.ceil(level)), np.uint64(first), np.uint64(last)
    lowest, highest = np.uint64(lo), np.uint64(hi)
    # inwards from the ends of the top to what is not below the level
    while levels[from_at] < whole and from_at < to_at:
        from_at += _ONE
    while levels[to_at] < whole and to_at > from_at:
        to_at -= _ONE
    # outwards to the first pixel below; the crossing lies before it
    x = from_at
    while x > lowest and levels[x] >= whole:
        x -= _ONE
    left = float(np.int64(x))
    if levels[x] < whole:
        left += (level - levels[x]) / (float(levels[x + _ONE]) - float(levels[x]))
    x = to_at
    while x < highest and levels[x] >= whole:
        x += _ONE
    right = float(np.int64(x))
    if levels[x] < whole:
        right -= (level - levels[x]) / (float(levels[x - _ONE]) - float(levels[x]))
    return left, right


@inlined
def _cut_off(levels: Pixels, half: float, begin: int, end: int, lo: int, hi: int, side: int) -> bool:
    """Say whether the border is nearer on a side than the stripe's foot, by its width on the other one."""
    from_px, to_px = _crossings(levels, half, begin, end, lo, hi)
    top = 0.5 * (begin + end)
    seen = top - lo if side < 0 else hi - top
    # a stripe is as wide on the side that is not seen
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
    for x in range(np.uint64(begin), np.uint64(max(begin, end))):
        total += min(int(levels[x]), most)
    return total / max(end - begin, 1)


@float_kernel
def _measure(
    rows: Rows,
    tops: Tops,
    limits: Limits,
    found: Measured,
    out_row: NDArray[np.int64],
    flags: NDArray[np.uint8],
) -> Any:
    """Fill the fields of `Stripes`; gives the number of those within the width limits."""
    row, first, last = tops
    done, highs, places, values = found
    left, right, white = rows.left, rows.right, rows.white
    count = row.shape[0]
    for i in range(count):
        if not done[i]:
            follows, leads = i > 0 and row[i - 1] == row[i], i + 1 < count and row[i + 1] == row[i]
            # halfway to the tops beside it in the row
            places[0, i] = (last[i - 1] + first[i] + 1) // 2 if follows else left
            places[1, i] = (last[i] + first[i + 1]) // 2 if leads else right - 1
    _measure_rest(rows, tops, found)
    # limits are looked for anew only where one is unfit
    unfit = unfit_stripes(row, limits, values)
    changed = limits_out_of_light(rows, tops, unfit, found)
    if changed:
        _measure_rest(rows, tops, found)
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
        take_off_glare(white, limits.share_min, out_row, flags, values)
        changed = True
    if changed:
        unfit = unfit_stripes(row, limits, values)
    return closed_up(unfit, out_row, places, flags, values)


@float_kernel
def _measure_rest(rows: Rows, tops: Tops, found: Measured) -> None:
    """Measure within `places` what is not done."""
    levels, columns, left, right, white = rows
    row, first, last = tops
    done, highs, places, values = found
    for i in range(row.shape[0]):
        if done[i]:
            continue
        lo, hi = places[0, i], places[1, i]
        at = row[i] * columns
        at_left = lo == left and first[i] - lo < _BORDER_PX
        at_right = hi == right - 1 and hi - last[i] < _BORDER_PX
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
        # the side that is cut off knows no background
        if cut_left != cut_right:
            base = float(low_right if cut_left else low_left)
    half = 0.5 * (high + base)
    from_px, to_px = _crossings(levels, half, begin, end, lo, hi)
    ends_left = at_left and from_px <= lo and levels[lo] >= half
    ends_right = at_right and to_px >= hi and levels[hi] >= half
    # of one flank alone the border shows nothing: the other is mirrored at the top
    if ends_left != ends_right:
        top = 0.5 * (begin + end)
        if high >= white and ends_left and begin > lo:
            top = mirrored(levels, max(lo, begin - 2), begin, end, float(low_right), hi)
        elif high >= white and ends_right and end < hi:
            top = mirrored(levels, min(hi, end + 2), begin, end, float(low_left), lo)
        elif begin == end and lo < begin < hi:
            # vertex of the parabola through three pixels
            before, after = float(levels[begin - 1]), float(levels[begin + 1])
            top += 0.5 * (after - before) / max(2.0 * high - before - after, 1.0)
        if ends_left:
            from_px = 2.0 * top - to_px
        else:
            to_px = 2.0 * top - from_px
    middle, width = 0.5 * (from_px + to_px), to_px - from_px
    reach = _FEET_FROM * width / FWHM_OF_SIGMA
    # what is brighter in the feet than a quarter of the height counts as that
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
        # a line through the means of both feet
        left_px = 0.5 * (outer_left + inner_left - 1)
        apart = 0.5 * (inner_right + outer_right - 1) - left_px
        slope = (level_right - level_left) / apart
        background = level_left + slope * (middle - left_px)
        # variance of the difference of two means, over their distance squared
        unsure = (1.0 / pixels_left + 1.0 / pixels_right) / (apart * apart)
    elif pixels_left > 0:
        background = level_left
    elif pixels_right > 0:
        background = level_right
    else:
        background = base
    return high, middle, width, background, slope, unsure


SEEN_PX = 64  # how far from a top its surroundings are looked at
_NEAR_PX = 4  # where a stripe of usual width has fallen to the background
_BLOCK = 16  # pixels looked at together: one vector
_DARKER = 0.125  # of the height: by less it does not get darker
_SHALLOW = 0.45  # a valley less deep than that share of the lower of two tops is a dent in one stripe
_SHALLOW_OF_300 = round(300 * _SHALLOW)
_NEAR = np.uint64(_NEAR_PX)


@float_kernel
def join_tops(rows: Rows, width_min_px: float, tops: Tops) -> int:
    """Leave out spikes and join tops of one stripe, in place; gives the number of peaks that are left.

    Of joined tops the first pixel of the first and the last of the last are kept.
    """
    levels, columns, left, right, _ = rows
    row, first, last = tops
    looked_at = np.empty(row.shape[0], np.uint8)
    if not _may_be_one_or_none(rows, tops, looked_at):
        return row.shape[0]
    count = 0
    changed = False  # what comes before is not what the quick look compared with
    for i in range(row.shape[0]):
        if looked_at[i] or changed:
            at = row[i] * columns
            changed = True
            if _spike_width(levels, at + first[i], at + last[i], at + left, at + right) < width_min_px:
                continue
            p = count - 1
            near = p >= 0 and row[p] == row[i] and first[i] - last[p] <= SEEN_PX
            if near and _is_one(
                levels, at + first[p], at + last[p], at + first[i], at + last[i], at + left, at + right
            ):
                last[p] = last[i]
                continue
            changed = False
        row[count], first[count], last[count] = row[i], first[i], last[i]
        count += 1
    return count


@inlined
def _may_be_one_or_none(rows: Rows, tops: Tops, looked_at: NDArray[np.uint8]) -> int:
    """Mark tops that may be a spike, or one with the top before; gives how many there are.

    Nearly none is. So this is all that is done to most tops: whole numbers, and nothing to branch on.
    """
    levels, columns, left, right, _ = rows
    row, first, last = tops
    found = 0
    before_row: Any = -1
    before_last: Any = 0
    before_high: Any = 0
    for i in range(np.uint64(row.shape[0])):
        begin: Any = np.int64(first[i])
        end: Any = np.int64(last[i])
        here: Any = np.int64(row[i])
        from_at, to_at = np.uint64(here * columns + begin), np.uint64(here * columns + end)
        high = np.int64(levels[from_at])
        if begin < left + _NEAR_PX or end >= right - _NEAR_PX:
            looked_at[i] = 1
            found += 1
            before_row, before_last, before_high = here, end, high
            continue
        beside = max(np.int64(levels[from_at - _ONE]), np.int64(levels[to_at + _ONE]))
        near = min(np.int64(levels[from_at - _NEAR]), np.int64(levels[to_at + _NEAR]))
        # both neighbours lie below half of the top
        spike = 2 * (high - beside) >= high - near
        same = before_row == here
        middle = np.uint64(here * columns + ((before_last + begin) >> 1 if same else begin))
        valley = np.int64(levels[middle - _ONE]) + np.int64(levels[middle]) + np.int64(levels[middle + _ONE])
        lower = min(high, before_high)
        # As `_is_one` asks first, in whole numbers; what lies on the limit is looked at as well.
        dent = same & (300 * lower - 100 * valley <= _SHALLOW_OF_300 * lower + 1)
        looked_at[i] = spike | dent
        found += looked_at[i]
        before_row, before_last, before_high = here, end, high
    return found


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
    # on straight flanks half height lies half/fall beside the top
    return half / before + half / after + (last - first)


@inlined
def _base(levels: Pixels, first: int, last: int, left: int, right: int) -> int:
    """Give the lowest grey level around a top."""
    return min(
        lowest_before(levels, max(left, first - SEEN_PX), first),
        lowest_after(levels, last + 1, min(right, last + 1 + SEEN_PX)),
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
def lowest_before(levels: Pixels, begin: int, end: int) -> int:
    """Lowest grey level from `begin` up to `end`, looked for from `end` on while it gets darker."""
    low = int(levels[max(end - 1, begin)])
    x = end
    while x - _BLOCK >= begin:
        x -= _BLOCK
        found = _lowest_of_block(levels, x)
        # a block darker by less than an eighth of the height ends the search
        if found + _DARKER * (int(levels[end]) - found) >= low and x + _BLOCK < end:
            return min(low, found)
        low = min(low, found)
    for k in range(np.uint64(begin), np.uint64(max(x, begin))):
        low = min(low, int(levels[k]))
    return low


@inlined
def lowest_after(levels: Pixels, begin: int, end: int) -> int:
    """Lowest grey level from `begin` up to `end`, looked for from `begin` on while it gets darker."""
    low = int(levels[min(begin, end - 1)])
    x = begin
    while x + _BLOCK <= end:
        found = _lowest_of_block(levels, x)
        if found + _DARKER * (int(levels[begin - 1]) - found) >= low and x > begin:
            return min(low, found)
        low = min(low, found)
        x += _BLOCK
    for k in range(np.uint64(x), np.uint64(max(x, end))):
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


_IN_LIGHT = 0.25
"""Of the brighter top's height above the darkest pixel between: what is brighter is its light."""
_BRIGHT = 0.25  # of the highest top: what is lower has no ripples beside it that are tops


@float_kernel
def limits_out_of_light(rows: Rows, tops: Tops, unfit: NDArray[np.uint64], found: Measured) -> bool:
    """Put limits between stripes at the darkest pixel where halfway lies in the light of one, in place.

    Beside a wide stripe a faint top, such as the ripples that a JPEG makes, takes half of what is between
    the two tops: the stripe's own light would then be its background, and it would be too narrow or too
    faint. So only where that has happened to one that is unfit, or to its neighbour, are all looked at.

    Parameters
    ----------
    rows, tops, found
        As `_measure` has them; `done` becomes 0 for the stripes that have another limit now, and `places` is
        changed.
    unfit
        Numbers of the tops that are no stripes by the limits so far.

    Returns
    -------
    bool
        Whether there are any.
    """
    done, highs, places, _ = found
    if unfit.shape[0] == 0:
        return False
    some, least = False, _BRIGHT * np.max(highs)
    for g in range(unfit.shape[0]):
        k: Any = np.int64(unfit[g])
        for i in range(max(k, 1), min(k + 2, done.shape[0])):
            some |= _darkest(rows, tops, found, least, i) >= 0
    if some:
        done[:] = 1
        for i in range(1, done.shape[0]):
            darkest = _darkest(rows, tops, found, least, i)
            if darkest >= 0:
                places[1, i - 1] = places[0, i] = darkest
                done[i - 1] = done[i] = 0
    return some


@inlined
def _darkest(rows: Rows, tops: Tops, found: Measured, least: float, i: int) -> int:
    """Column of the darkest pixel between a top and the one before it, if halfway is in light; else −1."""
    levels, columns, _, _, _ = rows
    row, first, last = tops
    highs, places = found.high, found.places
    if row[i] != row[i - 1]:
        return -1
    high, at = max(highs[i - 1], highs[i]), row[i] * columns
    # The last pixel of the one and the first of the other: the same, or neighbours.
    halfway = max(levels[at + places[1, i - 1]], levels[at + places[0, i]])
    if high < least or halfway <= _IN_LIGHT * high:
        return -1
    darkest = at + last[i - 1]
    for x in range(at + last[i - 1] + 1, at + first[i]):
        darkest = x if levels[x] < levels[darkest] else darkest
    low = float(levels[darkest])
    return darkest - at if halfway - low > _IN_LIGHT * (high - low) else -1


@inlined
def mirrored(levels: Pixels, outer: int, first: int, last: int, base: float, end: int) -> float:
    """Middle of a top cut off at white, from a pixel `outer` on the side that the border cuts off.

    That pixel has its like on the other flank, where that is as bright: on the parabola through logarithms of
    the three pixels that come after the top (`first` … `last`) there. Halfway is the middle.
    """
    way = 1 if end > last else -1
    at = last if way > 0 else first
    most = abs(end - at)
    near = np.log(max(float(levels[at + way * min(1, most)]) - base, 1.0))
    next_ = np.log(max(float(levels[at + way * min(2, most)]) - base, 1.0))
    far = np.log(max(float(levels[at + way * min(3, most)]) - base, 1.0))
    wanted = np.log(max(float(levels[outer]) - base, 1.0))
    # Steps from the first of the three pixels; a parabola's value there, slope and bend.
    bend = min(near - 2.0 * next_ + far, 0.0)
    slope = next_ - near - 0.5 * bend
    step = 0.0
    # Newton's steps; the slope stays negative, on this side of the top
    for _ in range(4):
        step -= (near + slope * step + 0.5 * bend * step * step - wanted) / min(slope + bend * step, -0.05)
        step = min(max(step, -1.0), 3.0)
    return 0.5 * (outer + at + way * (1.0 + step))
