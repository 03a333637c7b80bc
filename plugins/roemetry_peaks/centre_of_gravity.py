"""The centre of gravity of each stripe's profile above its background.

Model. x₀ = Σ w x y / Σ w y over the pixels within 2.5 σ of the centre, y the light above the background, w
the part of a pixel within the window. The window is moved until the centre is its middle: three times, each
step longer by 1/(1 − f), f the share by which a Gaussian's centre follows the window.

Uncertainty. x₀ follows each pixel by ∂x₀/∂y = w (x − x₀) / (Σ w y (1 − f)); noise, speckle and the
background's slope add up in squares.

Assumed: a symmetric profile on a straight background, of any shape. Fails where a neighbour's light reaches
into the window; where the border cuts a flank off, as much is taken of the other one.

Source: Fisher, Naidu (1996), A comparison of algorithms for subpixel peak detection; the moving window is
ours.
"""

from __future__ import annotations

import math

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

_BEYOND_LINEAR = 3.5  # see `roemetry_peaks.finding.found`; found by drawing


class CentreOfGravityOptions(PeakOptions):
    """Options of `CentreOfGravity`."""

    reach_sigmas: float = Field(
        default=2.5,
        ge=1.5,
        le=4.0,
        description="what is summed over, to both sides of the centre: standard deviations of the stripe",
    )


class CentreOfGravity(RowExtractor[CentreOfGravityOptions]):
    """Takes the centre of gravity of the grey levels above the background, in a window around it."""

    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        return found(
            frame, self.options, centres_of_gravity, self.options.reach_sigmas, beyond_linear=_BEYOND_LINEAR
        )


_PASSES = 3  # of the window around the centre of the pass before
_SIGMAS_MIN = 0.75  # what is left of a window at the border: less says next to nothing


@inlined
def _follows(sigmas: float) -> float:
    """By how much the centre of a Gaussian follows a shift of the window."""
    within = np.sqrt(2.0 * np.pi) * math.erf(sigmas / np.sqrt(2.0))
    return 2.0 * sigmas * np.exp(-0.5 * sigmas**2) / within


@float_kernel
def centres_of_gravity(
    levels: Pixels,
    columns: int,
    s: Stripes,
    white: int,
    noise: Floats,
    contrast2: Floats,
    x_px: Floats,
    x_std_px: Floats,
    sigmas: float,
) -> None:
    """Measure stripes by their centre of gravity, in a window that is moved until the centre is its middle.

    Parameters
    ----------
    levels, columns
        Grey levels, row after row, and the length of a row.
    s
        Stripes, as `roemetry_peaks.peak_window.stripes_around` gave them.
    white
        Grey level from which on a pixel is saturated.
    noise
        As for `roemetry_peaks.speckle_contrast.variance_of`.
    contrast2
        (peak,) square of the speckle's contrast, or (1,) that of all.
    x_px, x_std_px
        (peak,) to be filled; `x_px` is NaN where there is no result, `x_std_px` where the sensor is unknown.
    sigmas
        What is summed over, to both sides: standard deviations of the stripe.
    """
    pull, light = np.empty(PIXELS_MAX), np.empty(PIXELS_MAX)
    each = contrast2.shape[0] > 1
    whole = _follows(sigmas)
    row, los, his, flags, middles, widths, _, backgrounds, slopes, unsures = s
    for i in range(row.shape[0]):
        begins = row[i] * columns
        lo, hi = los[i], his[i]
        middle, background, slope = middles[i], backgrounds[i], slopes[i]
        reach = sigmas * widths[i] / FWHM_OF_SIGMA
        centre, follows = middle, whole
        if flags[i] & EDGE:
            # The border leaves less of one side: as much is taken of the other one.
            seen = min(middle - lo, hi - middle) + 0.5
            if seen < reach:
                least = seen * FWHM_OF_SIGMA / widths[i]
                if least < _SIGMAS_MIN:
                    x_px[i] = np.nan
                    continue
                reach, follows = seen, _follows(least)
        total = 0.0
        # each pass around the centre of the one before
        for _ in range(_PASSES):
            total = moment = 0.0
            begin, end = centre - reach, centre + reach
            for x in range(max(lo, int(np.floor(begin + 0.5))), min(hi, int(np.floor(end + 0.5))) + 1):
                # pixels that the window cuts count by what lies within
                inside = min(1.0, min(x + 0.5 - begin, end - x + 0.5))
                level = inside * (levels[begins + x] - background - slope * (x - middle))
                total += level
                moment += level * (x - centre)
            # the window holds the centre back by what it follows of its shift
            centre += moment / max(total, 1e-9) / (1.0 - follows)
        x_px[i] = np.nan
        if not total > 0.0 or not abs(centre - middle) < 0.5 * widths[i]:
            continue
        begin, end = centre - reach, centre + reach
        first = max(lo, int(np.floor(begin + 0.5)))
        count = min(min(hi, int(np.floor(end + 0.5))) + 1 - first, PIXELS_MAX)
        # pull: by how much a grey level moves the centre
        unit = 1.0 / (total * (1.0 - follows))
        second = 0.0
        for k in range(count):
            x = first + k
            inside = min(1.0, min(x + 0.5 - begin, end - x + 0.5))
            pull[k] = unit * inside * (x - centre)
            light[k] = levels[begins + x] - background - slope * (x - middle)
            second += pull[k] * (x - centre)
        x_px[i] = centre
        speckle = contrast2[i if each else 0]
        x_std_px[i] = np.sqrt(
            variance_of(
                levels,
                white,
                begins + first,
                count,
                pull,
                light,
                background,
                second,
                unsures[i],
                noise,
                speckle,
            )
        )
