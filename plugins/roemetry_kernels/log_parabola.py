"""The parabola through the logarithms of three or five pixels at a stripe's top, compiled."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.influence import variance_of_middle
from roemetry_kernels.lane_logs import logarithms
from roemetry_kernels.stripe_footing import FWHM_OF_SIGMA, Stripes
from roemetry_kernels.stripe_scan import Pixels

LANES = 64  # stripes side by side
_ASTRAY = 0.5  # of the pixels' reach, and 0.5 px more: a top farther from the middle pixel is noise
_BELIEVED_PX = 1.0  # what a top may be off at most by chance: it is one of few pixels
_DARKEST = 0.001  # grey levels above the background that anything darker is taken for
_STEEPEST = 10.0  # 1/grey levels: the logarithm's slope is taken for no more

# Where the quantities of each lane begin in one piece of memory (numba looks for overlaps in each loop else).
_LEVEL = 0  # of five pixels
_LOG = 5 * LANES
_INVERSE = 10 * LANES
_PULL = 15 * LANES
_AT = 20 * LANES
_USABLE = 21 * LANES
_MIDDLE = 22 * LANES
_WIDTH = 23 * LANES
_AMPLITUDE = 24 * LANES
_BACKGROUND = 25 * LANES
_SLOPE = 26 * LANES
_UNSURE = 27 * LANES
_C1 = 28 * LANES
_C2 = 29 * LANES
_X = 30 * LANES
_STD = 31 * LANES
_TABLE = 32 * LANES


@float_kernel
def log_parabola_centres(
    levels: Pixels,
    columns: int,
    s: Stripes,
    white: int,
    noise: Floats,
    x_px: Floats,
    x_std_px: Floats,
    points: int,
) -> None:
    """Take the top of the least-squares parabola through the logarithms of `points` pixels (3 or 5).

    They lie around the pixel nearest to the middle of the half-height crossings; of 3, around the highest
    of that one and its two neighbours. Where one of them is saturated or too near to a neighbouring stripe,
    and where the parabola has no top near by, that middle is the centre. The other parameters
    are those of `roemetry_kernels.gaussian_fit.gaussian_centres`.
    """
    # Least squares on equal steps: c1 = Σ by_1·log, c2 = Σ by_2·log; of five pixels three may count.
    by_1, by_2 = np.zeros(5), np.zeros(5)
    half = points // 2
    for j in range(2 - half, 3 + half):
        u = j - 2.0
        by_1[j] = u / (2.0 if half == 1 else 10.0)
        by_2[j] = (u * u - (2.0 / 3.0 if half == 1 else 2.0)) / (2.0 / 3.0 if half == 1 else 14.0)
    alike = np.exp(-0.25 * (np.arange(5) / noise[3]) ** 2)
    v = np.ones(_TABLE)
    row, los, his, _, middles, widths, amplitudes, backgrounds, slopes, unsures = s
    count = row.shape[0]
    for start in range(0, count, LANES):
        lanes = min(LANES, count - start)
        for k in range(lanes):
            i = start + k
            begins = row[i] * columns
            at = int(np.floor(middles[i] + 0.5))
            if half == 1 and los[i] < at < his[i]:
                before, here, after = levels[begins + at - 1], levels[begins + at], levels[begins + at + 1]
                if max(before, after) > here:
                    at += 1 if after > before else -1
            usable = (at - 2 >= los[i]) & (at + 2 <= his[i])
            place, step = np.uint64(begins + at - 2 if usable else 0), np.uint64(usable)
            for j in range(np.uint64(5)):
                level = levels[place + step * j]
                usable &= (level < white) | (abs(np.int64(j) - 2) > half)
                v[_LEVEL + np.int64(j) * LANES + k] = level
            v[_AT + k], v[_USABLE + k] = at, usable
            v[_MIDDLE + k], v[_WIDTH + k], v[_AMPLITUDE + k] = middles[i], widths[i], amplitudes[i]
            v[_BACKGROUND + k], v[_SLOPE + k], v[_UNSURE + k] = backgrounds[i], slopes[i], unsures[i]
        _tops(v, by_1, by_2, 0.5 + _ASTRAY * half)
        _uncertainties(v, by_1, by_2, alike, noise)
        for k in range(lanes):
            x_px[start + k], x_std_px[start + k] = v[_X + k], v[_STD + k]


@inlined
def _tops(v: Floats, by_1: Floats, by_2: Floats, reach_px: float) -> None:
    """Find the parabolas' tops; where there is none near by, the middle."""
    for j in range(5):
        for k in range(LANES):
            line = v[_BACKGROUND + k] + v[_SLOPE + k] * (v[_AT + k] + (j - 2.0) - v[_MIDDLE + k])
            v[_LOG + j * LANES + k] = max(v[_LEVEL + j * LANES + k] - line, _DARKEST)
    logarithms(v, _LOG, _INVERSE, 5 * LANES)
    for k in range(LANES):
        v[_C1 + k] = v[_C2 + k] = 0.0
    for j in range(5):
        one, two = by_1[j], by_2[j]
        for k in range(LANES):
            v[_C1 + k] += one * v[_LOG + j * LANES + k]
            v[_C2 + k] += two * v[_LOG + j * LANES + k]
    for k in range(LANES):
        c1, c2 = v[_C1 + k], v[_C2 + k]
        good = (v[_USABLE + k] > 0.0) & (c2 < 0.0) & (abs(c1) < -2.0 * c2 * reach_px)
        v[_USABLE + k] = 1.0 if good else 0.0
        v[_X + k] = v[_AT + k] - 0.5 * c1 / c2 if good else v[_MIDDLE + k]


@inlined
def _uncertainties(v: Floats, by_1: Floats, by_2: Floats, alike: Floats, noise: Floats) -> None:
    """Carry the pixels' noise, the speckle and the background's slope over to the tops."""
    dark, gain, speckle = noise[0], noise[1], noise[2] * noise[2]
    # How steep the parabola is comes from the width: as fitted it may be flat by chance, which would give
    # this peak an uncertainty beyond all measure.
    for k in range(LANES):
        v[_C1 + k] = v[_C2 + k] = 0.0
    for j in range(5):
        one, two = by_1[j], by_2[j]
        for k in range(LANES):
            broad = v[_WIDTH + k] * v[_WIDTH + k] / (FWHM_OF_SIGMA * FWHM_OF_SIGMA)
            inverse = min(v[_INVERSE + j * LANES + k], _STEEPEST)
            relative = broad * (one - 2.0 * two * (v[_AT + k] - v[_X + k]))
            pull = relative * inverse
            v[_PULL + j * LANES + k] = relative
            v[_C1 + k] += pull * (v[_AT + k] + (j - 2.0) - v[_MIDDLE + k])
            v[_C2 + k] += pull * pull * (dark + gain * v[_LEVEL + j * LANES + k])
    for lag in range(5):
        share = speckle * alike[lag] * (1.0 if lag == 0 else 2.0)
        for j in range(5 - lag):
            for k in range(LANES):
                v[_C2 + k] += share * v[_PULL + j * LANES + k] * v[_PULL + (j + lag) * LANES + k]
    for k in range(LANES):
        background = dark + gain * v[_BACKGROUND + k]
        variance = v[_C2 + k] + v[_C1 + k] * v[_C1 + k] * v[_UNSURE + k] * background
        of_top = variance / (1.0 + variance / (_BELIEVED_PX * _BELIEVED_PX))
        of_middle = variance_of_middle(v[_WIDTH + k], v[_AMPLITUDE + k], v[_BACKGROUND + k], noise)
        v[_STD + k] = np.sqrt(of_top if v[_USABLE + k] > 0.0 else of_middle)
