"""Width and background of 128 stripes at a time: their surroundings side by side, compiled.

One stripe after the other, most of the time goes into guessing wrong how far it is to the crossings. Here the
64 pixels around each top are turned (see `roemetry_kernels.lane_steps`) so that one vector instruction
looks at the same pixel beside many tops. What does not fit into 64 pixels is left to the general way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.lane_steps import CHUNK, LANES, WORD, Words, turn_bytes
from roemetry_kernels.stripe_scan import Pixels, Places

_TOP = CHUNK // 2  # each top's first pixel lies there among the 64, or up to seven pixels further on
_LONGEST_TOP = 16  # px

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
    known = np.zeros(15 * LANES, np.uint8)
    sums = np.zeros(2 * LANES, np.uint16)
    zero, none = np.uint8(0), np.uint8(255)
    for start in range(0, count, LANES):
        lanes = min(LANES, count - start)
        for k in range(lanes):
            i = start + k
            lo, hi = left, right - 1
            if i > 0 and row[i - 1] == row[i]:
                lo = (last[i - 1] + first[i] + 1) // 2
            if i + 1 < count and row[i + 1] == row[i]:
                hi = (last[i] + first[i + 1]) // 2
            places[0, i], places[1, i] = lo, hi
            place = row[i] * columns + first[i]
            word = place // WORD - _TOP // WORD
            long = last[i] - first[i]
            done[i] = word >= 0 and word + CHUNK // WORD <= size and long < _LONGEST_TOP
            word = max(min(word, size - CHUNK // WORD), 0)
            at = _TOP + place % WORD
            known[_TOP_FIRST + k], known[_TOP_LAST + k] = at, at + min(long, _LONGEST_TOP)
            known[_BEGIN + k], known[_END + k] = (
                max(lo - first[i] + at, 0),
                min(hi - first[i] + at, CHUNK - 1),
            )
            known[_HIGH + k] = levels[place]
            for x in range(place + 1, place + 1 + long):
                known[_HIGH + k] = max(known[_HIGH + k], levels[x])
            to = k % WORD * (LANES * CHUNK // WORD // WORD) + k // WORD
            for c in range(CHUNK // WORD):
                gathered[to + c * (LANES // WORD)] = words[word + c]
        turn_bytes(gathered, turned)
        for k in range(LANES):
            known[_LOW_LEFT + k] = known[_LOW_RIGHT + k] = none
            known[_AT_LEFT + k], known[_AT_RIGHT + k] = zero, none
            sums[k] = sums[LANES + k] = 0
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
        for x in range(_TOP + WORD):
            column = np.uint8(x)
            for k in range(LANES):
                level = f[x * LANES + k]
                level = level if column >= known[_BEGIN + k] and column < known[_TOP_FIRST + k] else none
                known[_AT_LEFT + k] = max(known[_AT_LEFT + k], column if level < known[_HALF + k] else zero)
        for x in range(_TOP + 1, CHUNK):
            column = np.uint8(x)
            for k in range(LANES):
                level = f[x * LANES + k]
                level = level if column <= known[_END + k] and column > known[_TOP_LAST + k] else none
                known[_AT_RIGHT + k] = min(known[_AT_RIGHT + k], column if level < known[_HALF + k] else none)
        for k in range(lanes):
            i = start + k
            found = (known[_AT_LEFT + k] != zero) & (known[_AT_RIGHT + k] != none)
            found &= (f[known[_TOP_FIRST + k] * LANES + k] >= known[_HALF + k]) & (
                f[known[_TOP_LAST + k] * LANES + k] >= known[_HALF + k]
            )
            at = int(known[_AT_LEFT + k]) if found else 0
            to = int(known[_AT_RIGHT + k]) if found else CHUNK - 1
            base = float(max(known[_LOW_LEFT + k], known[_LOW_RIGHT + k]))
            level = 0.5 * (float(known[_HIGH + k]) + base)
            outer = float(f[at * LANES + k])
            from_px = at + (level - outer) / (float(f[(at + 1) * LANES + k]) - outer)
            outer = float(f[to * LANES + k])
            to_px = to - (level - outer) / (float(f[(to - 1) * LANES + k]) - outer)
            middle, width = 0.5 * (from_px + to_px), to_px - from_px
            reach = feet_from * width
            found &= (middle > reach) & (middle + reach < CHUNK)
            reach = reach if found else 0.0
            highs[i] = known[_HIGH + k]
            values[0, i], values[1, i] = middle, width
            known[_CAP + k] = int(base + feet_share_max * (float(known[_HIGH + k]) - base))
            inner = (
                min(max(int(middle - reach) + 1, int(known[_BEGIN + k])), int(known[_TOP_FIRST + k]))
                if found
                else 1
            )
            known[_IN_LEFT + k], known[_OUT_LEFT + k] = inner, max(inner - feet_px, int(known[_BEGIN + k]))
            own = (
                first[i] - places[0, i] <= known[_TOP_FIRST + k]
            )  # the stripe's own pixels end within the 64
            found &= (inner >= feet_px) | own
            inner = (
                max(min(int(middle + reach) + 1, int(known[_END + k]) + 1), int(known[_TOP_LAST + k]) + 1)
                if found
                else 1
            )
            known[_IN_RIGHT + k], known[_OUT_RIGHT + k] = (
                inner,
                min(inner + feet_px, int(known[_END + k]) + 1),
            )
            own = places[1, i] - first[i] + known[_TOP_FIRST + k] < CHUNK
            found &= (inner + feet_px <= CHUNK) | own
            done[i] &= np.uint8(
                found
                & (known[_IN_LEFT + k] > known[_OUT_LEFT + k])
                & (known[_IN_RIGHT + k] < known[_OUT_RIGHT + k])
            )
        for x in range(_TOP + WORD):
            column = np.uint8(x)
            for k in range(LANES):
                level = min(f[x * LANES + k], known[_CAP + k])
                sums[k] += np.uint16(
                    level if column >= known[_OUT_LEFT + k] and column < known[_IN_LEFT + k] else zero
                )
        for x in range(_TOP + 1, CHUNK):
            column = np.uint8(x)
            for k in range(LANES):
                level = min(f[x * LANES + k], known[_CAP + k])
                sums[LANES + k] += np.uint16(
                    level if column >= known[_IN_RIGHT + k] and column < known[_OUT_RIGHT + k] else zero
                )
        for k in range(lanes):
            i = start + k
            pixels_left = float(known[_IN_LEFT + k]) - float(known[_OUT_LEFT + k])
            pixels_right = float(known[_OUT_RIGHT + k]) - float(known[_IN_RIGHT + k])
            level_left, level_right = float(sums[k]) / pixels_left, float(sums[LANES + k]) / pixels_right
            mid_left = 0.5 * (float(known[_OUT_LEFT + k]) + float(known[_IN_LEFT + k]) - 1.0)
            apart = 0.5 * (float(known[_IN_RIGHT + k]) + float(known[_OUT_RIGHT + k]) - 1.0) - mid_left
            slope = (level_right - level_left) / apart
            background = level_left + slope * (values[0, i] - mid_left)
            values[0, i] += float(first[i]) - float(known[_TOP_FIRST + k])
            values[2, i], values[3, i], values[4, i] = highs[i] - background, background, slope
            values[5, i] = (1.0 / pixels_left + 1.0 / pixels_right) / (apart * apart)
