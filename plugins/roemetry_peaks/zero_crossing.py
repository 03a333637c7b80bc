"""The zero crossing of each stripe's filtered derivative.

Model. d(x) = Σ_{k=1…n} y(x + k) − y(x − k) is the profile's derivative, smoothed by a box of n pixels to
each side; its zero is the centre, found between the two pixels where d changes its sign, on a straight
line. n is 1.6 standard deviations of the stripe, where d is steepest. The background's slope s adds s n (n
+ 1), taken off.

Uncertainty. The zero follows each pixel by one over the slope of d; noise, speckle and the background's
slope add up in squares.

Assumed: a symmetric profile. A step of the background beside the stripe cancels only if it lies beyond n.
Fails on flat tops wider than 2 n, where d is zero over several pixels.

Source: Blais, Rioux (1986), Real-time numerical peak detector, Signal Processing 11(2):145–155.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats
from roemetry.records.stripes import EDGE
from roemetry.stages import Capabilities
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_peaks.finding import PeakOptions, found
from roemetry_peaks.peak_scan import Pixels
from roemetry_peaks.peak_window import FWHM_OF_SIGMA, Stripes
from roemetry_peaks.searching import RowExtractor
from roemetry_peaks.speckle_contrast import PIXELS_MAX, variance_of

_BEYOND_LINEAR = 1.0  # see `roemetry_peaks.finding.found`; found by drawing


class ZeroCrossingOptions(PeakOptions):
    """Options of `ZeroCrossing`."""

    half_length: Annotated[int, Field(ge=1, le=64)] | Literal["auto"] = Field(
        default="auto",
        description="pixels to each side that the filter sums over; auto: 1.6 standard deviations of "
        "the stripe",
    )


class ZeroCrossing(RowExtractor[ZeroCrossingOptions]):
    """Finds where the sum of the pixels to the right equals that of those to the left."""

    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        half_length = 0 if self.options.half_length == "auto" else self.options.half_length
        return found(frame, self.options, zero_crossings, half_length, beyond_linear=_BEYOND_LINEAR)


_LENGTH_OF_SIGMA = 1.6  # of a half of the filter, over the stripe's standard deviation


@float_kernel
def zero_crossings(
    levels: Pixels,
    columns: int,
    s: Stripes,
    white: int,
    noise: Floats,
    contrast2: Floats,
    x_px: Floats,
    x_std_px: Floats,
    half_length: int,
) -> None:
    """Find where the sum of the pixels to the right equals the sum of those to the left.

    That is the zero of the derivative, smoothed by a box of `half_length` pixels to each side (0: 1.6
    standard deviations of the stripe; less where the border leaves less), between pixels by a straight line.
    The background's slope is taken off. The other parameters are those of
    `roemetry_peaks.gaussian.gaussian_centres`.
    """
    pull, light = np.empty(PIXELS_MAX), np.empty(PIXELS_MAX)
    each = contrast2.shape[0] > 1
    row, los, his, flags, middles, widths, _, backgrounds, slopes, unsures = s
    for i in range(row.shape[0]):
        begins = row[i] * columns
        half = half_length
        if half == 0:
            half = max(1, int(np.rint(_LENGTH_OF_SIGMA * widths[i] / FWHM_OF_SIGMA)))
        if flags[i] & EDGE:
            # not beyond the border on either side
            here = int(np.floor(middles[i]))
            half = max(1, min(half, min(here - los[i], his[i] - here - 1)))
        # what the background's slope adds to the difference: Σ 2 k over the half's pixels
        tilt = slopes[i] * half * (half + 1)
        lowest, highest = los[i] + half, his[i] - half
        x_px[i] = x_std_px[i] = np.nan
        before = int(np.floor(middles[i]))
        if before < lowest or before + 1 > highest:
            continue
        # the difference falls from plus to minus at the centre: a pixel on either side of that
        left = _difference(levels, begins + before, half) - tilt
        while left <= 0.0 and before > lowest:
            before -= 1
            left = _difference(levels, begins + before, half) - tilt
        after = before + 1
        right = _difference(levels, begins + after, half) - tilt
        while right >= 0.0 and after < highest:
            if right > 0.0:
                before, left = after, right
            after += 1
            right = _difference(levels, begins + after, half) - tilt
        if not (left > 0.0 > right and abs(0.5 * (before + after) - middles[i]) < widths[i]):
            continue
        # a straight line between both
        part = left / (left - right)
        x_px[i] = before + part * (after - before)
        first, count = before - half, after - before + 2 * half + 1
        if count > PIXELS_MAX:
            continue
        # by how much a grey level moves the zero
        unit = (after - before) / (left - right)
        lean = 0.0
        for k in range(count):
            x = first + k
            pull[k] = unit * ((1.0 - part) * _side(x - before, half) + part * _side(x - after, half))
            light[k] = levels[begins + x] - backgrounds[i] - slopes[i] * (x - middles[i])
            lean += pull[k] * (x - middles[i])
        speckle = contrast2[i if each else 0]
        x_std_px[i] = np.sqrt(
            variance_of(
                levels,
                white,
                begins + first,
                count,
                pull,
                light,
                backgrounds[i],
                lean,
                unsures[i],
                noise,
                speckle,
            )
        )


@inlined
def _difference(levels: Pixels, place: int, half: int) -> float:
    """Sum of the `half` pixels to the right of a pixel less the sum of those to the left."""
    total = np.int64(0)
    for k in range(1, half + 1):
        total += np.int64(levels[place + k]) - np.int64(levels[place - k])
    return float(total)


@inlined
def _side(off: int, half: int) -> float:
    if off == 0 or abs(off) > half:
        return 0.0
    return 1.0 if off > 0 else -1.0
