"""The parabola through the logarithms of three or five pixels at each stripe's top.

Model. The logarithm of a Gaussian is a parabola; through pixels on equal steps, least squares are sums,

    c₁ = Σ p_j ln y_j,   c₂ = Σ q_j ln y_j,   x₀ = pixel − c₁ / (2 c₂),

with p = j/10 and q = (j² − 2)/14 for five pixels, j = −2 … 2, and y the light above the background. All
weigh the same: that is what makes it quick, and noisier than `gaussian`, since dark pixels' logarithms
scatter most.

Uncertainty. Each pixel's noise and speckle times its pull on the top, with the steepness that the stripe's
width at half height gives: as fitted, a parabola may be flat by chance. No more than a pixel is ever
stated.

Where a pixel that counts is saturated or belongs to a neighbour, and where the parabola has no top near by,
the middle between the half-height crossings is the centre.

Assumed: a Gaussian of σ 1 to 4 px. Fails on flat tops (the middle is taken) and under strong speckle (three
times the bound).

Source: Fisher, Naidu (1996), A comparison of algorithms for subpixel peak detection.

64 stripes go through the arithmetic side by side, their logarithms by a series, which lets the compiler use
vector instructions.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats
from roemetry.records.stripes import EDGE, SATURATED
from roemetry.stages import Capabilities
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_peaks.finding import PeakOptions, found
from roemetry_peaks.peak_scan import Pixels, copied
from roemetry_peaks.peak_window import FWHM_OF_SIGMA, Stripes
from roemetry_peaks.searching import RowExtractor
from roemetry_peaks.speckle_contrast import variance_of_middle

_BEYOND_LINEAR = 3.0  # see `roemetry_peaks.finding.found`; found by drawing


class LogParabolaOptions(PeakOptions):
    """Options of `LogParabola`."""

    points: Literal["three", "five"] = Field(default="five", description="pixels the parabola goes through")


class LogParabola(RowExtractor[LogParabolaOptions]):
    """Takes the top of the parabola through the logarithms of three or five pixels."""

    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        points = 3 if self.options.points == "three" else 5
        return found(frame, self.options, log_parabola_centres, points, beyond_linear=_BEYOND_LINEAR)


LANES = 64  # stripes side by side
_ASTRAY = 0.5  # of the pixels' reach, and 0.5 px more: a top farther from the middle pixel is noise
_BELIEVED_PX = 1.0  # what a top may be off at most by chance: it is one of few pixels
_DARKEST = 0.001  # grey levels above the background that anything darker is taken for
_STEEPEST = 10.0  # 1/grey levels: the logarithm's slope is taken for no more

# Where the quantities of each lane begin in one piece of memory (numba looks for overlaps in each loop else).
_LEVEL, _LOG, _INVERSE = range(0, 15 * LANES, 5 * LANES)  # of five pixels, one after the other
_AT, _USABLE, _MIDDLE, _WIDTH, _AMPLITUDE, _BACKGROUND, _SLOPE = range(15 * LANES, 22 * LANES, LANES)
_UNSURE, _X, _STD, _ROW, _LO, _HI, _CONTRAST2, _TABLE = range(22 * LANES, 30 * LANES, LANES)
_N = np.uint64(LANES)


@float_kernel
def log_parabola_centres(
    levels: Pixels,
    columns: int,
    s: Stripes,
    white: int,
    noise: Floats,
    contrast2: Floats,
    x_px: Floats,
    x_std_px: Floats,
    points: int,
) -> None:
    """Take the top of the least-squares parabola through the logarithms of `points` pixels (3 or 5).

    They lie around the pixel nearest to the middle of the half-height crossings; of 3, around the highest
    of that one and its two neighbours. Where one of them is saturated or too near to a neighbouring stripe,
    and where the parabola has no top near by, that middle is the centre. The other parameters
    are those of `roemetry_peaks.gaussian.gaussian_centres`.
    """
    # Least squares on equal steps: c1 = Σ by_1·log, c2 = Σ by_2·log; of five pixels three may count.
    by_1, by_2 = np.zeros(5), np.zeros(5)
    half = points // 2
    for j in range(2 - half, 3 + half):
        u = j - 2.0
        by_1[j] = u / (2.0 if half == 1 else 10.0)
        by_2[j] = (u * u - (2.0 / 3.0 if half == 1 else 2.0)) / (2.0 / 3.0 if half == 1 else 14.0)
    alike = np.exp(-0.25 * (np.arange(5) / noise[2]) ** 2)
    v = np.ones(_TABLE)
    v[_CONTRAST2 : _CONTRAST2 + LANES] = contrast2[0]
    row, los, his, flags, middles, widths, amplitudes, backgrounds, slopes, unsures = s
    count = row.shape[0]
    places, steps = np.empty(LANES, np.uint64), np.empty(LANES, np.uint64)
    for start in range(0, count, LANES):
        lanes = min(LANES, count - start)
        copied(middles, start, lanes, v, _MIDDLE)
        copied(widths, start, lanes, v, _WIDTH)
        copied(amplitudes, start, lanes, v, _AMPLITUDE)
        copied(backgrounds, start, lanes, v, _BACKGROUND)
        copied(slopes, start, lanes, v, _SLOPE)
        copied(unsures, start, lanes, v, _UNSURE)
        copied(row, start, lanes, v, _ROW)
        copied(los, start, lanes, v, _LO)
        copied(his, start, lanes, v, _HI)
        if contrast2.shape[0] > 1:
            copied(contrast2, start, lanes, v, _CONTRAST2)
        # the pixel nearest to the middle
        for k in range(LANES):
            v[_AT + k] = np.floor(v[_MIDDLE + k] + 0.5)
        if half == 1:
            _moved_to_highest(levels, columns, v, lanes)
        for k in range(LANES):
            v[_USABLE + k] = 1.0 if v[_AT + k] - 2.0 >= v[_LO + k] and v[_AT + k] + 2.0 <= v[_HI + k] else 0.0
        for k in range(LANES):
            place = np.int64(v[_ROW + k] * columns + v[_AT + k] - 2.0)
            usable = np.int64(v[_USABLE + k])
            places[k], steps[k] = place * usable, usable
        # The places unsigned, which none from the end can be.
        for k in range(np.uint64(lanes)):
            place, step = places[k], steps[k]
            for j in range(np.uint64(5)):
                v[j * _N + k] = levels[place + step * j]
        _without_white(v, white, half)
        _tops(v, by_1, by_2, 0.5 + _ASTRAY * half)
        _uncertainties(v, by_1, by_2, alike, noise)
        copied(v, _STD, lanes, x_std_px, start)
        begin = np.uint64(start)
        for k in range(np.uint64(lanes)):
            # Where the border leaves fewer pixels and cuts off a flank, there is no middle either.
            away = 0.5 * v[_WIDTH + k]
            one = (v[_MIDDLE + k] - away <= v[_LO + k]) | (v[_MIDDLE + k] + away >= v[_HI + k])
            cut = one & ((flags[begin + k] & (EDGE | SATURATED)) == EDGE) & (v[_USABLE + k] == 0.0)
            x_px[begin + k] = np.nan if cut else v[_X + k]


@inlined
def _moved_to_highest(levels: Pixels, columns: int, v: Floats, lanes: int) -> None:
    """Move on to the next pixel where that is higher."""
    for k in range(lanes):
        at = int(v[_AT + k])
        if v[_LO + k] < at < v[_HI + k]:
            place = int(v[_ROW + k]) * columns + at
            before, here, after = levels[place - 1], levels[place], levels[place + 1]
            if max(before, after) > here:
                v[_AT + k] += 1.0 if after > before else -1.0


@inlined
def _without_white(v: Floats, white: int, half: int) -> None:
    """Leave out lanes of which a pixel that counts is saturated."""
    if half == 1:
        for k in range(LANES):
            highest = max(max(v[_LEVEL + LANES + k], v[_LEVEL + 2 * LANES + k]), v[_LEVEL + 3 * LANES + k])
            v[_USABLE + k] = v[_USABLE + k] if highest < white else 0.0
        return
    for k in range(LANES):
        one = max(v[_LEVEL + k], v[_LEVEL + LANES + k])
        other = max(v[_LEVEL + 3 * LANES + k], v[_LEVEL + 4 * LANES + k])
        highest = max(max(one, other), v[_LEVEL + 2 * LANES + k])
        v[_USABLE + k] = v[_USABLE + k] if highest < white else 0.0


@inlined
def _tops(v: Floats, by_1: Floats, by_2: Floats, reach_px: float) -> None:
    """Find the parabolas' tops; where there is none near by, the middle."""
    for j in range(5):
        for k in range(LANES):
            # the background's line at the pixel
            line = v[_BACKGROUND + k] + v[_SLOPE + k] * (v[_AT + k] + (j - 2.0) - v[_MIDDLE + k])
            v[_LOG + j * LANES + k] = max(v[_LEVEL + j * LANES + k] - line, _DARKEST)
    logarithms(v, _LOG, _INVERSE, 5 * LANES)
    b0, b1, b2, b3, b4 = by_1[0], by_1[1], by_1[2], by_1[3], by_1[4]
    d0, d1, d2, d3, d4 = by_2[0], by_2[1], by_2[2], by_2[3], by_2[4]
    for k in range(LANES):
        l0, l1, l2 = v[_LOG + k], v[_LOG + LANES + k], v[_LOG + 2 * LANES + k]
        l3, l4 = v[_LOG + 3 * LANES + k], v[_LOG + 4 * LANES + k]
        c1 = b0 * l0 + b1 * l1 + b2 * l2 + b3 * l3 + b4 * l4
        c2 = d0 * l0 + d1 * l1 + d2 * l2 + d3 * l3 + d4 * l4
        # a top within reach of the middle pixel
        good = (v[_USABLE + k] > 0.0) & (c2 < 0.0) & (abs(c1) < -2.0 * c2 * reach_px)
        v[_USABLE + k] = 1.0 if good else 0.0
        v[_X + k] = v[_AT + k] - 0.5 * c1 / c2 if good else v[_MIDDLE + k]


@inlined
def _uncertainties(v: Floats, by_1: Floats, by_2: Floats, alike: Floats, noise: Floats) -> None:
    """Carry the pixels' noise, the speckle and the background's slope over to the tops.

    How steep the parabola is comes from the width: as fitted it may be flat by chance, which would give a
    peak an uncertainty beyond all measure.
    """
    dark, gain = noise[0], noise[1]
    b0, b1, b2, b3, b4 = by_1[0], by_1[1], by_1[2], by_1[3], by_1[4]
    d0, d1, d2, d3, d4 = by_2[0], by_2[1], by_2[2], by_2[3], by_2[4]
    a0, a1, a2, a3, a4 = alike[0], 2.0 * alike[1], 2.0 * alike[2], 2.0 * alike[3], 2.0 * alike[4]
    for k in range(LANES):
        # Pulls of the five pixels on the top: r on what is relative to their light, q on grey levels.
        broad = v[_WIDTH + k] * v[_WIDTH + k] / (FWHM_OF_SIGMA * FWHM_OF_SIGMA)
        off = 2.0 * (v[_AT + k] - v[_X + k])
        r0, r1, r2 = broad * (b0 - off * d0), broad * (b1 - off * d1), broad * (b2 - off * d2)
        r3, r4 = broad * (b3 - off * d3), broad * (b4 - off * d4)
        q0 = r0 * min(v[_INVERSE + k], _STEEPEST)
        q1 = r1 * min(v[_INVERSE + LANES + k], _STEEPEST)
        q2 = r2 * min(v[_INVERSE + 2 * LANES + k], _STEEPEST)
        q3 = r3 * min(v[_INVERSE + 3 * LANES + k], _STEEPEST)
        q4 = r4 * min(v[_INVERSE + 4 * LANES + k], _STEEPEST)
        lean = (q0 + q1 + q2 + q3 + q4) * (v[_AT + k] - v[_MIDDLE + k]) + 2.0 * (q4 - q0) + (q3 - q1)
        variance = q0 * q0 * (dark + gain * v[_LEVEL + k]) + q1 * q1 * (dark + gain * v[_LEVEL + LANES + k])
        variance += q2 * q2 * (dark + gain * v[_LEVEL + 2 * LANES + k])
        variance += q3 * q3 * (dark + gain * v[_LEVEL + 3 * LANES + k])
        variance += q4 * q4 * (dark + gain * v[_LEVEL + 4 * LANES + k])
        together = a0 * (r0 * r0 + r1 * r1 + r2 * r2 + r3 * r3 + r4 * r4)
        together += a1 * (r0 * r1 + r1 * r2 + r2 * r3 + r3 * r4)
        together += a2 * (r0 * r2 + r1 * r3 + r2 * r4) + a3 * (r0 * r3 + r1 * r4) + a4 * r0 * r4
        background = dark + gain * v[_BACKGROUND + k]
        variance += v[_CONTRAST2 + k] * together + lean * lean * v[_UNSURE + k] * background
        # bounded: it is one of few pixels at any rate
        of_top = variance / (1.0 + variance / (_BELIEVED_PX * _BELIEVED_PX))
        of_middle = variance_of_middle(
            v[_WIDTH + k], v[_AMPLITUDE + k], v[_BACKGROUND + k], noise, v[_CONTRAST2 + k]
        )
        v[_STD + k] = np.sqrt(of_top if v[_USABLE + k] > 0.0 else of_middle)


_FRACTION_BITS = 52  # of a float64, below those of its exponent
_FRACTION = (1 << _FRACTION_BITS) - 1
_BIAS = 1023  # of a float64's exponent (IEEE 754)
_ONE = _BIAS << _FRACTION_BITS
_LN_2 = 0.6931471805599453
_SQRT_2 = 1.4142135623730951


@inlined
def logarithms(v: Floats, begin: int, inverse: int, count: int) -> None:
    """Take logarithms in place, to 1e-10, and put the reciprocals elsewhere in the same piece of memory.

    A number is taken apart into m·2ⁿ, 0.7 < m < 1.42, of which ln m is twice the series of artanh s with
    s = (m − 1) / (m + 1).

    Parameters
    ----------
    v
        Holds positive numbers from `begin` on; changed.
    begin, inverse
        Where the numbers begin, and where their reciprocals are to begin.
    count
        How many there are.
    """
    bits = v.view(np.int64)
    for k in range(count):
        bits[inverse + k] = (bits[begin + k] & _FRACTION) | _ONE
    for k in range(count):
        exponent = (bits[begin + k] >> _FRACTION_BITS) - _BIAS
        x, m = v[begin + k], v[inverse + k]
        large = m > _SQRT_2
        m = 0.5 * m if large else m
        power = float(exponent + 1) if large else float(exponent)
        # one division for both
        under = 1.0 / (x * (m + 1.0))
        s = (m - 1.0) * x * under
        z = s * s
        series = 1.0 + z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z * (1 / 9 + z / 11))))
        v[begin + k] = power * _LN_2 + 2.0 * s * series
        v[inverse + k] = (m + 1.0) * under
