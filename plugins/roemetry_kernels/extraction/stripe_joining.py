"""Which tops are of one stripe, and which are spikes, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.extraction.stripe_scan import Pixels, Places

SEEN_PX = 64  # how far from a top its surroundings are looked at
_NEAR_PX = 4  # where a stripe of usual width has fallen to the background
_BLOCK = 16  # pixels looked at together: one vector
_DARKER = 0.125  # of the height: by less it does not get darker
_SHALLOW = 0.45  # a valley less deep than that share of the lower of two tops is a dent in one stripe
_SHALLOW_OF_300 = round(300 * _SHALLOW)
# Unsigned, which no index from the end can be.
_ONE, _NEAR = np.uint64(1), np.uint64(_NEAR_PX)


@float_kernel
def join_tops(
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

    Of joined tops the first pixel of the first and the last of the last are kept. The parameters are those
    of `roemetry_kernels.extraction.stripe_footing.stripes_around`.
    """
    tops = row.shape[0]
    looked_at = np.empty(tops, np.uint8)
    if not _may_be_one_or_none(levels, columns, left, right, row, first, last, looked_at):
        return tops
    count = 0
    changed = False  # what comes before is not what the quick look compared with
    for i in range(tops):
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
def _may_be_one_or_none(
    levels: Pixels,
    columns: int,
    left: int,
    right: int,
    row: Places,
    first: Places,
    last: Places,
    looked_at: NDArray[np.uint8],
) -> int:
    """Mark tops that may be a spike, or one with the top before; gives how many there are.

    Nearly none is. So this is all that is done to most tops: whole numbers, and nothing to branch on.
    """
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
        if found + _DARKER * (int(levels[end]) - found) >= low and x + _BLOCK < end:
            return min(low, found)
        low = min(low, found)
    for k in range(begin, x):
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
