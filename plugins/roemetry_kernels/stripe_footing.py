"""What stands around the top of a peak: half-height crossings, and the background as a line, compiled."""

from __future__ import annotations

from roemetry_kernels.compiling import kernel
from roemetry_kernels.stripe_scan import Pixels, Places

FWHM_OF_SIGMA = 2.354820045030949

_FEET_FROM = 3.6  # standard deviations from the middle: what lies farther out is background
_FEET_PX = 8  # pixels on each side that the background is taken from
_FEET_SHARE_MAX = 0.25  # of the amplitude: what is brighter is taken for that much (hot pixels)


@kernel
def between(row: Places, first: Places, last: Places, i: int, left: int, right: int) -> tuple[int, int]:
    """Give the columns that belong to peak `i`, first and last: up to halfway to its neighbours."""
    lo, hi = left, right - 1
    if i > 0 and row[i - 1] == row[i]:
        lo = (last[i - 1] + first[i] + 1) // 2
    if i + 1 < row.shape[0] and row[i + 1] == row[i]:
        hi = (last[i] + first[i + 1]) // 2
    return lo, hi


@kernel
def crossings(f: Pixels, level: float, first: int, last: int, lo: int, hi: int) -> tuple[float, float]:
    """Columns, px, where the grey levels `f` cross a level on both sides of a top, between pixels.

    Where they do not within `lo` … `hi`, the crossing is put there.
    """
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
def foot(f: Pixels, begin: int, end: int, low: float, high: float) -> tuple[float, float, int]:
    """Mean grey level of the pixels from `begin` up to `end`, their middle, px, and how many there are.

    Levels above `high` count as `high`. No pixel gives the level `low`.
    """
    total, count = 0.0, 0
    for x in range(begin, end):
        total += min(float(f[x]), high)
        count += 1
    if count == 0:
        return low, 0.0, 0
    return total / count, 0.5 * (begin + end - 1), count


@kernel
def footing(
    f: Pixels, first: int, last: int, lo: int, hi: int
) -> tuple[float, float, float, float, float, float]:
    """Middle of the half-height crossings and full width there, px; background there and its slope.

    Returns
    -------
    tuple
        middle, px; full width at half height, px; amplitude, grey levels; background at the middle, grey
        levels; its slope, grey levels per px; (variance of the slope) / (variance of one pixel), 1/px².
    """
    high = float(f[first])
    low_left = low_right = high
    for x in range(lo, first):
        low_left = min(low_left, float(f[x]))
    for x in range(last + 1, hi + 1):
        low_right = min(low_right, float(f[x]))
    base = max(low_left, low_right)
    left, right = crossings(f, 0.5 * (high + base), first, last, lo, hi)
    middle, width = 0.5 * (left + right), right - left
    reach = _FEET_FROM * width / FWHM_OF_SIGMA
    cap = base + _FEET_SHARE_MAX * (high - base)
    end = min(max(int(middle - reach) + 1, lo), first)
    left_level, left_at, left_count = foot(f, max(end - _FEET_PX, lo), end, low_left, cap)
    begin = max(min(int(middle + reach) + 1, hi), last + 1)
    right_level, right_at, right_count = foot(f, begin, min(begin + _FEET_PX, hi + 1), low_right, cap)
    if left_count == 0 or right_count == 0:
        level = right_level if left_count == 0 else left_level
        return middle, width, high - level, level, 0.0, 0.0
    apart = right_at - left_at
    slope = (right_level - left_level) / apart
    level = left_level + slope * (middle - left_at)
    unsure = (1.0 / left_count + 1.0 / right_count) / (apart * apart)
    return middle, width, high - level, level, slope, unsure
