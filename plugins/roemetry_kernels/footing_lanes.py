"""Width and background of 128 stripes at a time: their surroundings side by side, compiled.

One stripe after the other, most of the time goes into guessing wrong how far it is to the crossings. Here the
64 pixels around each top are turned (see `roemetry_kernels.lane_steps`) so that one vector instruction
looks at the same pixel beside many tops. What does not fit into 64 pixels is left to the general way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.lane_steps import CHUNK, LANES, WORD, Levels, Words, turn_bytes
from roemetry_kernels.stripe_scan import Pixels, Places

_TOP = CHUNK // 2  # each top's first pixel lies there among the 64, or up to seven pixels further on
_LONGEST_TOP = 16  # px
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
_FRACTIONS = 7 * LANES


@float_kernel
def measure_lanes(
    levels: Pixels,
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
    """Measure the stripes of an 8-bit image around their tops, as `roemetry_kernels.stripe_footing` has it.

    Parameters
    ----------
    levels, words, columns
        Grey levels, row after row; the same as words of eight; the length of a row.
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
    count, size = row.shape[0], words.shape[0]
    gathered = np.zeros(LANES * CHUNK // WORD, np.uint64)
    turned = np.zeros(LANES * CHUNK // WORD, np.uint64)
    f = turned.view(np.uint8)
    # What is known of each lane, in one piece of memory: else each loop would ask first which pieces overlap.
    known, v = np.zeros(_KNOWN, np.uint8), np.zeros(_FRACTIONS)
    sums = np.zeros(2 * LANES, np.uint16)
    for start in range(0, count, LANES):
        lanes = min(LANES, count - start)
        for k in range(lanes):
            i = start + k
            here, begin, end = row[i], first[i], last[i]
            before, after = max(i - 1, 0), min(i + 1, count - 1)
            shared = (i > 0) & (row[before] == here)
            lo = (last[before] + begin + 1) // 2 if shared else left
            shared = (i + 1 < count) & (row[after] == here)
            hi = (end + first[after]) // 2 if shared else right - 1
            places[0, i], places[1, i] = lo, hi
            place = here * columns + begin
            word = place // WORD - _TOP // WORD
            long = end - begin
            whole = (word >= 0) & (word + CHUNK // WORD <= size) & (long < _LONGEST_TOP)
            word = max(min(word, size - CHUNK // WORD), 0)
            at = _TOP + place % WORD
            known[_TOP_FIRST + k], known[_TOP_LAST + k] = at, at + min(long, _LONGEST_TOP)
            known[_CUT_LEFT + k], known[_CUT_RIGHT + k] = begin - lo > at, hi - begin + at >= CHUNK
            known[_BEGIN + k] = max(lo - begin + at, 0)
            known[_END + k] = min(hi - begin + at, CHUNK - 1)
            known[_WHOLE + k] = whole
            to = k % WORD * (LANES * CHUNK // WORD // WORD) + k // WORD
            for c in range(CHUNK // WORD):
                gathered[to + c * (LANES // WORD)] = words[word + c]
        turn_bytes(gathered, turned)
        _half_height(f, known)
        _crossings(f, known)
        _feet(known, v, feet_from, feet_px, feet_share_max)
        _background(f, known, sums, v)
        for k in range(lanes):
            i = start + k
            done[i] = known[_WHOLE + k]
            highs[i] = known[_HIGH + k]
            values[0, i] = v[_MIDDLE + k] + (float(first[i]) - float(known[_TOP_FIRST + k]))
            values[1, i], values[2, i] = v[_WIDTH + k], v[_AMPLITUDE + k]
            values[3, i], values[4, i] = v[_BACKGROUND + k], v[_SLOPE + k]
            values[5, i] = v[_UNSURE + k]


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
    for x in range(_TOP + WORD):
        column = np.uint8(x)
        for k in range(LANES):
            level = f[x * LANES + k]
            level = level if column >= known[_BEGIN + k] and column < known[_TOP_FIRST + k] else none
            known[_LOW_LEFT + k] = min(known[_LOW_LEFT + k], level)
    for x in range(_TOP + 1, CHUNK):
        column = np.uint8(x)
        for k in range(LANES):
            level = f[x * LANES + k]
            level = level if column <= known[_END + k] and column > known[_TOP_LAST + k] else none
            known[_LOW_RIGHT + k] = min(known[_LOW_RIGHT + k], level)
    for k in range(LANES):
        base = max(known[_LOW_LEFT + k], known[_LOW_RIGHT + k])
        known[_HALF + k] = (np.uint16(known[_HIGH + k]) + np.uint16(base) + np.uint16(1)) >> np.uint16(1)


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
            here, beside = (
                f[column * LANES : (column + 1) * LANES],
                f[(column + 1) * LANES : (column + 2) * LANES],
            )
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
            here, beside = (
                f[column * LANES : (column + 1) * LANES],
                f[(column - 1) * LANES : column * LANES],
            )
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
        from_px = float(known[_AT_LEFT + k]) + (level - outer) / (inner - outer if found else 1.0)
        outer, inner = float(known[_BELOW_RIGHT + k]), float(known[_ABOVE_RIGHT + k])
        to_px = float(known[_AT_RIGHT + k]) - (level - outer) / (inner - outer if found else 1.0)
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
        level_left, level_right = v[_LEVEL + k] / pixels_left, v[_BACKGROUND + k] / pixels_right
        mid_left = 0.5 * (float(known[_OUT_LEFT + k]) + float(known[_IN_LEFT + k]) - 1.0)
        apart = 0.5 * (float(known[_IN_RIGHT + k]) + float(known[_OUT_RIGHT + k]) - 1.0) - mid_left
        slope = (level_right - level_left) / apart
        background = level_left + slope * (v[_MIDDLE + k] - mid_left)
        v[_AMPLITUDE + k], v[_BACKGROUND + k] = float(known[_HIGH + k]) - background, background
        v[_SLOPE + k] = slope
        v[_UNSURE + k] = (1.0 / pixels_left + 1.0 / pixels_right) / (apart * apart)
