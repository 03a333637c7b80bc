"""Width and background of 128 stripes at a time: their surroundings side by side, compiled.

One stripe after the other, most of the time goes into guessing wrong how far it is to the crossings. Here the
64 pixels around each top are turned (see `lane_steps`) so that one vector instruction
looks at the same pixel beside many tops. What does not fit into 64 pixels is left to the general way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.extraction.lane_steps import CHUNK, LANES, WORD, Levels, Words, copied, turn_bytes
from roemetry_kernels.extraction.stripe_scan import Places

_TOP = CHUNK // 2  # each top's first pixel lies there among the 64, or up to seven pixels further on
_LONGEST_TOP = 16  # px
_BORDER_PX = 24  # what begins nearer to the border may be cut off by it, and is left to the general way
_STEP = 4  # columns looked at before asking whether that was far enough

# Where the quantities of each lane begin in one piece of memory: its first and last pixel that are the
# stripe's own, those of its top, levels, crossings, and the pixels that the background is taken from.
_BEGIN = 0
_END = 1 * LANES
_TOP_FIRST = 2 * LANES
_TOP_LAST = 3 * LANES
_HIGH = 4 * LANES
_HALF = 5 * LANES
_CAP = 6 * LANES
_LOW_LEFT = 7 * LANES
_LOW_RIGHT = 8 * LANES
_AT_LEFT = 9 * LANES
_AT_RIGHT = 10 * LANES
_OUT_LEFT = 11 * LANES
_IN_LEFT = 12 * LANES
_IN_RIGHT = 13 * LANES
_OUT_RIGHT = 14 * LANES
_BELOW_LEFT = 15 * LANES  # grey levels outside and inside of the crossings of half height
_ABOVE_LEFT = 16 * LANES
_BELOW_RIGHT = 17 * LANES
_ABOVE_RIGHT = 18 * LANES
_LEVEL_FIRST = 19 * LANES  # and at both ends of the top
_LEVEL_LAST = 20 * LANES
_CUT_LEFT = 21 * LANES  # 1 where the stripe's own pixels go on beyond the 64
_CUT_RIGHT = 22 * LANES
_WHOLE = 23 * LANES  # 1 where the stripe fits
_KNOWN = 24 * LANES

# And of those that are no whole numbers.
_MIDDLE = 0
_WIDTH = 1 * LANES
_AMPLITUDE = 2 * LANES
_BACKGROUND = 3 * LANES
_SLOPE = 4 * LANES
_UNSURE = 5 * LANES
_LEVEL = 6 * LANES
_FROM = 7 * LANES  # the column that the first of the 64 pixels is
_FRACTIONS = 8 * LANES

# Tops, each list with one element before the lanes' and one after them, and columns that are a stripe's own.
_BESIDE = LANES + 2
_ROW = 1
_FIRST = _BESIDE + 1
_LAST = 2 * _BESIDE + 1
_LO = 3 * _BESIDE
_HI = 3 * _BESIDE + LANES
_TOPS = 3 * _BESIDE + 2 * LANES

# Unsigned, which no index from the end can be.
_W = np.uint64(WORD)
_GROUPS = np.uint64(LANES // WORD)
_APART = np.uint64(LANES * CHUNK // WORD // WORD)  # from words of one row of eight to those of the next


@float_kernel
def measure_lanes(
    words: Words,
    columns: int,
    left: int,
    right: int,
    feet_from: float,
    feet_px: int,
    feet_share_max: float,
    row: Places,
    first: Places,
    last: Places,
    places: NDArray[np.int32],
    highs: Floats,
    values: Floats,
    done: NDArray[np.uint8],
) -> None:
    """Measure the stripes of an 8-bit image around their tops, as `stripe_footing` has it.

    Parameters
    ----------
    words, columns
        Grey levels, row after row, as words of eight; the length of a row.
    left, right
        Columns that may be used, from the first to the one after the last.
    feet_from, feet_px, feet_share_max
        Where the background begins, full widths from the middle; from how many pixels it is taken; what of
        the height counts at most.
    row, first, last
        (peak,) tops.
    places, highs, values, done
        (2, peak), (peak,), (6, peak), (peak,) to be filled: lo and hi; highest level; middle, width,
        amplitude, background, slope, unsure; 0 where the stripe does not fit into the 64 pixels.
    """
    count = row.shape[0]
    own_pixels, measured = places.reshape(-1), values.reshape(-1)
    gathered = np.zeros(LANES * CHUNK // WORD, np.uint64)
    turned = np.zeros(LANES * CHUNK // WORD, np.uint64)
    f = turned.view(np.uint8)
    # What is known of each lane, in one piece of memory: else each loop would ask first which pieces overlap.
    known, v = np.zeros(_KNOWN, np.uint8), np.zeros(_FRACTIONS)
    tops, words_at = np.zeros(_TOPS, np.int64), np.zeros(LANES, np.uint64)
    sums = np.zeros(2 * LANES, np.uint16)
    for start in range(0, count, LANES):
        lanes = min(LANES, count - start)
        _tops_of(row, first, last, start, lanes, tops)
        _own_pixels(tops, columns, left, right, words.shape[0], known, words_at, v)
        for k in range(np.uint64(lanes)):
            at, to = words_at[k], k % _W * _APART + k // _W
            for c in range(_W):
                gathered[to + c * _GROUPS] = words[at + c]
        turn_bytes(gathered, turned)
        _half_height(f, known)
        _crossings(f, known)
        _feet(known, v, feet_from, feet_px, feet_share_max)
        _background(f, known, sums, v)
        copied(tops, _LO, lanes, own_pixels, start)
        copied(tops, _HI, lanes, own_pixels, count + start)
        copied(known, _WHOLE, lanes, done, start)
        copied(known, _HIGH, lanes, highs, start)
        for k in range(LANES):
            v[_MIDDLE + k] += v[_FROM + k]
        for field in range(values.shape[0]):
            copied(v, field * LANES, lanes, measured, field * count + start)


@inlined
def _tops_of(row: Places, first: Places, last: Places, start: int, lanes: int, tops: Integers) -> None:
    """Copy the lanes' tops, with the one before and the one after; there is none in row −1."""
    copied(row, start, lanes, tops, _ROW)
    copied(first, start, lanes, tops, _FIRST)
    copied(last, start, lanes, tops, _LAST)
    tops[_ROW - 1] = tops[_ROW + lanes] = -1
    if start > 0:
        tops[_ROW - 1], tops[_LAST - 1] = row[start - 1], last[start - 1]
    if start + lanes < row.shape[0]:
        tops[_ROW + lanes], tops[_FIRST + lanes] = row[start + lanes], first[start + lanes]


@inlined
def _own_pixels(
    tops: Integers, columns: int, left: int, right: int, size: int, known: Levels, words_at: Words, v: Floats
) -> None:
    """Say which pixels are a stripe's own, down to halfway to its neighbours, and which words hold them."""
    for k in range(LANES):
        begin, end = tops[_FIRST + k], tops[_LAST + k]
        before = tops[_ROW + k - 1] == tops[_ROW + k]
        after = tops[_ROW + k + 1] == tops[_ROW + k]
        lo = (tops[_LAST + k - 1] + begin + 1) >> 1 if before else left
        hi = (end + tops[_FIRST + k + 1]) >> 1 if after else right - 1
        place = tops[_ROW + k] * columns + begin
        word, at, long = (place // WORD) - _TOP // WORD, _TOP + (place & (WORD - 1)), end - begin
        cut = ((not before) & (begin - left < _BORDER_PX)) | ((not after) & (right - 1 - end < _BORDER_PX))
        fits = (word >= 0) & (word + CHUNK // WORD <= size) & (long < _LONGEST_TOP)
        known[_WHOLE + k] = fits & (not cut)
        words_at[k] = max(min(word, size - CHUNK // WORD), 0)
        tops[_LO + k], tops[_HI + k] = lo, hi
        known[_TOP_FIRST + k], known[_TOP_LAST + k] = at, at + min(long, _LONGEST_TOP)
        known[_CUT_LEFT + k], known[_CUT_RIGHT + k] = begin - lo > at, hi - begin + at >= CHUNK
        known[_BEGIN + k], known[_END + k] = max(lo - begin + at, 0), min(hi - begin + at, CHUNK - 1)
        v[_FROM + k] = begin - at


@inlined
def _half_height(f: Levels, known: Levels) -> None:
    """Find highest and lowest levels, and half height between them."""
    zero, none = np.uint8(0), np.uint8(255)
    for k in range(LANES):
        known[_LOW_LEFT + k] = known[_LOW_RIGHT + k] = none
        known[_HIGH + k] = known[_LEVEL_FIRST + k] = known[_LEVEL_LAST + k] = zero
    longest = zero
    for k in range(LANES):
        longest = max(longest, known[_TOP_LAST + k])
    for x in range(_TOP, int(longest) + 1):
        column, here = np.uint8(x), f[x * LANES : (x + 1) * LANES]
        for k in range(LANES):
            level = here[k]
            begins, ends = column >= known[_TOP_FIRST + k], column <= known[_TOP_LAST + k]
            known[_HIGH + k] = max(known[_HIGH + k], level if begins and ends else zero)
            known[_LEVEL_FIRST + k] |= level if column == known[_TOP_FIRST + k] else zero
            known[_LEVEL_LAST + k] |= level if column == known[_TOP_LAST + k] else zero
    _lowest(f, known, 0, _TOP + WORD, _BEGIN, _TOP_FIRST, zero, _LOW_LEFT)
    _lowest(f, known, _TOP, CHUNK, _TOP_LAST, _END, np.uint8(1), _LOW_RIGHT)
    for k in range(LANES):
        base = max(known[_LOW_LEFT + k], known[_LOW_RIGHT + k])
        known[_HALF + k] = (np.uint16(known[_HIGH + k]) + np.uint16(base) + np.uint16(1)) >> np.uint16(1)


@inlined
def _lowest(f: Levels, known: Levels, x0: int, x1: int, begins: int, ends: int, later: int, low: int) -> None:
    """Lower `low` to the lowest level of the lanes' pixels from `begins` up to `ends`, both moved by `later`.

    Four columns in one go: what is written has not to be read again at once.
    """
    none = np.uint8(255)
    for x in range(x0, x1, 4):
        c0, c1, c2, c3 = np.uint8(x), np.uint8(x + 1), np.uint8(x + 2), np.uint8(x + 3)
        here = f[x * LANES : (x + 4) * LANES]
        for k in range(LANES):
            begin, end = np.uint8(known[begins + k] + later), np.uint8(known[ends + k] + later)
            level_0 = here[k] if c0 >= begin and c0 < end else none
            level_1 = here[LANES + k] if c1 >= begin and c1 < end else none
            level_2 = here[2 * LANES + k] if c2 >= begin and c2 < end else none
            level_3 = here[3 * LANES + k] if c3 >= begin and c3 < end else none
            lowest = min(min(level_0, level_1), min(level_2, level_3))
            known[low + k] = min(known[low + k], lowest)


@inlined
def _crossings(f: Levels, known: Levels) -> None:
    """Find the pixels below half height that are nearest to the top."""
    zero, none = np.uint8(0), np.uint8(255)
    for k in range(LANES):
        known[_AT_LEFT + k], known[_AT_RIGHT + k] = zero, none
        known[_BELOW_LEFT + k] = known[_ABOVE_LEFT + k] = zero
        known[_BELOW_RIGHT + k] = known[_ABOVE_RIGHT + k] = zero
    # Outwards from the tops, as far as any lane has not crossed yet: usually not far.
    x = _TOP + WORD - 1
    while x >= 0 and _any_is(known, _AT_LEFT, zero):
        for column in range(x, max(x - _STEP, -1), -1):
            # As slices: numba would ask of each place whether it counts from the end.
            here = f[column * LANES : (column + 1) * LANES]
            beside = f[(column + 1) * LANES : (column + 2) * LANES]
            for k in range(LANES):
                level, inner = here[k], beside[k]
                own = np.uint8(column) >= known[_BEGIN + k] and np.uint8(column) < known[_TOP_FIRST + k]
                crossed = own and level < known[_HALF + k] and known[_AT_LEFT + k] == zero
                known[_AT_LEFT + k] = np.uint8(column) if crossed else known[_AT_LEFT + k]
                known[_BELOW_LEFT + k] = level if crossed else known[_BELOW_LEFT + k]
                known[_ABOVE_LEFT + k] = inner if crossed else known[_ABOVE_LEFT + k]
        x -= _STEP
    x = _TOP + 1
    while x < CHUNK and _any_is(known, _AT_RIGHT, none):
        for column in range(x, min(x + _STEP, CHUNK)):
            here = f[column * LANES : (column + 1) * LANES]
            beside = f[(column - 1) * LANES : column * LANES]
            for k in range(LANES):
                level, inner = here[k], beside[k]
                own = np.uint8(column) <= known[_END + k] and np.uint8(column) > known[_TOP_LAST + k]
                crossed = own and level < known[_HALF + k] and known[_AT_RIGHT + k] == none
                known[_AT_RIGHT + k] = np.uint8(column) if crossed else known[_AT_RIGHT + k]
                known[_BELOW_RIGHT + k] = level if crossed else known[_BELOW_RIGHT + k]
                known[_ABOVE_RIGHT + k] = inner if crossed else known[_ABOVE_RIGHT + k]
        x += _STEP


@inlined
def _any_is(known: Levels, begin: int, wanted: int) -> bool:
    found = np.uint8(0)
    for k in range(LANES):
        found |= np.uint8(known[begin + k] == wanted)
    return found != 0


@inlined
def _feet(known: Levels, v: Floats, feet_from: float, feet_px: int, feet_share_max: float) -> None:
    """Interpolate the crossings, and say which pixels are background."""
    room = float(CHUNK)
    for k in range(LANES):
        high, half = float(known[_HIGH + k]), known[_HALF + k]
        base = float(max(known[_LOW_LEFT + k], known[_LOW_RIGHT + k]))
        found = (known[_AT_LEFT + k] != 0) & (known[_AT_RIGHT + k] != 255)
        found &= (known[_LEVEL_FIRST + k] >= half) & (known[_LEVEL_LAST + k] >= half)
        level = 0.5 * (high + base)
        outer, inner = float(known[_BELOW_LEFT + k]), float(known[_ABOVE_LEFT + k])
        rise, up = inner - outer if found else 1.0, level - outer
        outer, inner = float(known[_BELOW_RIGHT + k]), float(known[_ABOVE_RIGHT + k])
        fall, down = inner - outer if found else 1.0, level - outer
        under = 1.0 / (rise * fall)  # one division for both
        from_px = float(known[_AT_LEFT + k]) + up * fall * under
        to_px = float(known[_AT_RIGHT + k]) - down * rise * under
        middle, width = 0.5 * (from_px + to_px), to_px - from_px
        reach = feet_from * width
        found &= (middle > reach) & (middle + reach < room)
        v[_MIDDLE + k], v[_WIDTH + k] = middle, width
        known[_CAP + k] = np.uint8(base + feet_share_max * (high - base))
        begin, end = float(known[_BEGIN + k]), float(known[_END + k]) + 1.0
        top_first, top_last = float(known[_TOP_FIRST + k]), float(known[_TOP_LAST + k]) + 1.0
        inner = np.floor(middle - reach) + 1.0
        inner = min(max(inner, begin), top_first) if found else 1.0
        outer = max(inner - feet_px, begin)
        found &= (inner >= feet_px) | (known[_CUT_LEFT + k] == 0)
        found &= inner > outer
        known[_IN_LEFT + k], known[_OUT_LEFT + k] = np.uint8(inner), np.uint8(outer)
        inner = np.floor(middle + reach) + 1.0
        inner = max(min(inner, end), top_last) if found else 1.0
        outer = min(inner + feet_px, end)
        found &= (inner + feet_px <= room) | (known[_CUT_RIGHT + k] == 0)
        found &= inner < outer
        known[_IN_RIGHT + k], known[_OUT_RIGHT + k] = np.uint8(inner), np.uint8(outer)
        known[_WHOLE + k] &= np.uint8(found)


@inlined
def _background(f: Levels, known: Levels, sums: NDArray[np.uint16], v: Floats) -> None:
    """Lay a line through the means on both sides."""
    zero = np.uint8(0)
    for k in range(LANES):
        sums[k] = sums[LANES + k] = 0
    farthest, nearest = _TOP + WORD, 0
    outermost, innermost = 0, CHUNK
    for k in range(LANES):
        farthest = min(farthest, int(known[_OUT_LEFT + k]))
        nearest = max(nearest, int(known[_IN_LEFT + k]))
        innermost = min(innermost, int(known[_IN_RIGHT + k]))
        outermost = max(outermost, int(known[_OUT_RIGHT + k]))
    for x in range(farthest, min(nearest, _TOP + WORD)):
        column, here = np.uint8(x), f[x * LANES : (x + 1) * LANES]
        for k in range(LANES):
            level = min(here[k], known[_CAP + k])
            own = column >= known[_OUT_LEFT + k] and column < known[_IN_LEFT + k]
            sums[k] += np.uint16(level if own else zero)
    for x in range(max(innermost, _TOP + 1), min(outermost, CHUNK)):
        column, here = np.uint8(x), f[x * LANES : (x + 1) * LANES]
        for k in range(LANES):
            level = min(here[k], known[_CAP + k])
            own = column >= known[_IN_RIGHT + k] and column < known[_OUT_RIGHT + k]
            sums[LANES + k] += np.uint16(level if own else zero)
    for k in range(LANES):
        v[_LEVEL + k] = float(sums[k])
        v[_BACKGROUND + k] = float(sums[LANES + k])
    for k in range(LANES):
        pixels_left = float(known[_IN_LEFT + k]) - float(known[_OUT_LEFT + k])
        pixels_right = float(known[_OUT_RIGHT + k]) - float(known[_IN_RIGHT + k])
        mid_left = 0.5 * (float(known[_OUT_LEFT + k]) + float(known[_IN_LEFT + k]) - 1.0)
        apart = 0.5 * (float(known[_IN_RIGHT + k]) + float(known[_OUT_RIGHT + k]) - 1.0) - mid_left
        # one division for all
        under = 1.0 / (pixels_left * pixels_right * apart * apart)
        sum_left, sum_right = v[_LEVEL + k] * pixels_right, v[_BACKGROUND + k] * pixels_left
        slope = (sum_right - sum_left) * apart * under
        background = sum_left * apart * apart * under + slope * (v[_MIDDLE + k] - mid_left)
        v[_AMPLITUDE + k], v[_BACKGROUND + k] = float(known[_HIGH + k]) - background, background
        v[_SLOPE + k] = slope
        v[_UNSURE + k] = (pixels_left + pixels_right) * under
