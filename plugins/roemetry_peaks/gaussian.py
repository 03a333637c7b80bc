"""A Gaussian through the logarithms of each stripe's pixels, by weighted least squares.

Model. Above its background a stripe's row is y = a exp(−(x − x₀)² / 2σ²). Its logarithm is a parabola,

    ln y = c₀ + c₁ u + c₂ u²,   u = x − middle,   x₀ = middle − c₁ / (2 c₂),

fitted over ± 2.6 σ. A logarithm has the variance var(y) / y², so its weight is y² / var(y): dark pixels say
little (Guo 2011), and bright ones no more than their speckle lets them, for var(y) = R + g μ + C² y². In
weight and variance y is the model's, with height and half-height width as `peak_window` measured them: so
no pixel's noise chooses its own weight. Where the sensor is not known, a top has a signal-to-noise ratio of
60.

Uncertainty. x₀ follows each pixel by ∂x₀/∂y; the pixels' noise, the speckle that neighbours share, and the
uncertain slope of the background add up in squares.

Assumed: a Gaussian on a straight background. Saturated pixels are left out. Fails on flat or skewed tops,
where the width at half height is not the Gaussian's, and where stripes stand nearer together than 6 σ.

Source: Guo (2011), IEEE Signal Processing Magazine 28(5):134–137; the speckle in the weights is ours.

64 stripes go through the arithmetic side by side, which lets the compiler use vector instructions.
"""

from __future__ import annotations

import numpy as np

from roemetry.records import Frame, Peaks
from roemetry.records.arrays import Floats
from roemetry.stages import Capabilities
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_peaks.finding import PeakOptions, found
from roemetry_peaks.peak_scan import Pixels, copied
from roemetry_peaks.peak_window import FWHM_OF_SIGMA, Stripes
from roemetry_peaks.searching import RowExtractor
from roemetry_peaks.speckle_contrast import LAGS, PIXELS_MAX, bell, fading

_BEYOND_LINEAR = 7.0  # see `roemetry_peaks.finding.found`; found by drawing


class GaussianOptions(PeakOptions):
    """Options of `Gaussian`."""


class Gaussian(RowExtractor[GaussianOptions]):
    """Fits a Gaussian by weighted least squares on the logarithms of the grey levels."""

    capabilities = Capabilities(tolerance_px=0.05, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        return gaussian_peaks(frame, self.options)


def gaussian_peaks(frame: Frame, options: GaussianOptions, *, checked: bool = True) -> Peaks:
    """Find the stripes of a frame; `checked` as for `roemetry_peaks.finding.found`."""
    return found(
        frame, options, gaussian_centres, weighs_speckle=True, beyond_linear=_BEYOND_LINEAR, checked=checked
    )


_REACH = 2.6  # standard deviations to both sides that are fitted
_LOWEST, _HIGHEST = 0.3, 3.0  # of the model: a pixel beyond counts as that dark or bright
_SIGNAL_TO_NOISE = 60.0  # of a stripe's top, where the sensor is not known
_SHOT = 0.3  # of the amplitude: where shot noise equals dark noise, where the sensor is not known
_UNLIKE = 0.01  # what is correlated by less is taken for independent
LANES = 64  # stripes side by side

# Where the quantities of each lane begin in one piece of memory (numba looks for overlaps in each loop else).
# `_FIRST`, `_COUNT`: the fitted pixels, the first one's distance from the middle, and how many.
# `_PULL`, `_WEIGHT`: what a logarithm's pull on the top consists of; the last pixel's weight.
# `_MEAN`: weighted means of the distance from the middle, and of its square.
_LEVEL, _FIRST, _COUNT, _WIDTH, _NARROW, _AMPLITUDE, _BACKGROUND = range(0, 7 * LANES, LANES)
_SLOPE, _UNSURE, _GAIN, _FLOOR, _S0, _S1, _S2, _S3, _S4 = range(7 * LANES, 16 * LANES, LANES)
_T0, _T1, _T2, _LEAN, _MOVED, _STD, _PULL_1, _PULL_2 = range(16 * LANES, 24 * LANES, LANES)
_WEIGHT, _MEAN_1, _MEAN_2, _CONTRAST2, _TABLE = range(24 * LANES, 29 * LANES, LANES)


@float_kernel
def gaussian_centres(
    levels: Pixels,
    columns: int,
    s: Stripes,
    white: int,
    noise: Floats,
    contrast2: Floats,
    x_px: Floats,
    x_std_px: Floats,
) -> None:
    """Fit a Gaussian to each stripe: a parabola to the logarithms of its grey levels above the background.

    The weight of a logarithm is (model)² / variance: what is dark says little, and neither does what is
    bright but speckled. The model has the stripe's height and half-height width. The variance is that of the
    sensor or, where it is not known, the one of shot noise and a noise floor. Saturated pixels are left out.

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
    """
    v = np.ones(_TABLE)
    place, most = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    speckled = contrast2.max() > 0.0 and noise[0] + noise[1] > 0.0
    v[_CONTRAST2 : _CONTRAST2 + LANES] = contrast2[0]
    # What each pixel weighs, then by how much it pulls; lag by lag how alike the speckle is.
    pulls = np.empty((PIXELS_MAX if speckled else 1) * LANES)
    alike = np.exp(-0.25 * (np.arange(LAGS + 1) / noise[2]) ** 2)
    row, los, his, _, middles, widths, amplitudes, backgrounds, slopes, unsures = s
    count = row.shape[0]
    for start in range(0, count, LANES):
        lanes = min(LANES, count - start)
        longest = 0
        for k in range(lanes):
            i = start + k
            reach = _REACH / FWHM_OF_SIGMA * widths[i]
            first = max(los[i], int(np.floor(middles[i] - reach + 0.5)))
            last = min(his[i], int(np.floor(middles[i] + reach + 0.5)), first + PIXELS_MAX - 1)
            place[k], most[k] = row[i] * columns + first, max(last - first, 0)
            longest = max(longest, last + 1 - first)
            v[_FIRST + k], v[_COUNT + k] = first - middles[i], last + 1 - first
            v[_WIDTH + k], v[_AMPLITUDE + k] = widths[i], amplitudes[i]
            v[_BACKGROUND + k], v[_SLOPE + k], v[_UNSURE + k] = backgrounds[i], slopes[i], unsures[i]
        if contrast2.shape[0] > 1:
            copied(contrast2, start, lanes, v, _CONTRAST2)
        _begun(v, noise)
        for j in range(longest):
            for k in range(lanes):
                v[_LEVEL + k] = levels[np.uint64(place[k] + min(j, most[k]))]
            _added(v, float(j), float(white))
            if speckled:
                pulls[j * LANES : (j + 1) * LANES] = v[_WEIGHT : _WEIGHT + LANES]
        _solved(v)
        if speckled:
            _speckled(v, pulls, longest, alike)
        for k in range(lanes):
            i = start + k
            x_px[i] = middles[i] + v[_MOVED + k]
            x_std_px[i] = v[_STD + k]


@inlined
def _begun(v: Floats, noise: Floats) -> None:
    """Choose each lane's noise, and set its sums to zero."""
    dark, gain = noise[0], noise[1]
    known = dark + gain > 0.0
    for k in range(LANES):
        assumed = v[_AMPLITUDE + k] / (_SIGNAL_TO_NOISE * _SIGNAL_TO_NOISE * (1.0 + _SHOT))
        v[_GAIN + k] = gain if known else assumed
        v[_FLOOR + k] = dark + gain * v[_BACKGROUND + k] if known else _SHOT * v[_AMPLITUDE + k] * assumed
        v[_NARROW + k] = 0.5 * (FWHM_OF_SIGMA * FWHM_OF_SIGMA) / (v[_WIDTH + k] * v[_WIDTH + k])
        v[_S0 + k] = v[_S1 + k] = v[_S2 + k] = v[_S3 + k] = v[_S4 + k] = 0.0
        v[_T0 + k] = v[_T1 + k] = v[_T2 + k] = v[_LEAN + k] = 0.0
        v[_STD + k] = 0.0 if known else np.nan


@inlined
def _added(v: Floats, j: float, white: float) -> None:
    """Add the next pixel of each lane to its sums."""
    for k in range(LANES):
        u = v[_FIRST + k] + j
        far = v[_NARROW + k] * u * u
        model = v[_AMPLITUDE + k] * bell(far)
        above = v[_LEVEL + k] - v[_BACKGROUND + k] - v[_SLOPE + k] * u
        above = min(max(above, _LOWEST * model), _HIGHEST * model)
        # Far from the middle a logarithm is noisier than its variance says: it counts as darker there.
        low = v[_AMPLITUDE + k] * fading(far)
        # ln(above / model), by a ratio of polynomials: to 2e-5 where they differ by 40 %.
        squares = above * above + model * model + 4.0 * above * model
        variance = v[_FLOOR + k] + low * (v[_GAIN + k] + v[_CONTRAST2 + k] * low)
        under = 1.0 / (squares * variance)  # one division for both
        log = 3.0 * (above * above - model * model) * variance * under - far
        share = low * squares * under if v[_LEVEL + k] < white and j < v[_COUNT + k] else 0.0
        weight = low * share
        v[_WEIGHT + k] = weight
        wu = weight * u
        wuu = wu * u
        v[_S0 + k] += weight
        v[_S1 + k] += wu
        v[_S2 + k] += wuu
        v[_S3 + k] += wuu * u
        v[_S4 + k] += wuu * u * u
        v[_T0 + k] += weight * (log if share > 0.0 else 0.0)
        v[_T1 + k] += wu * (log if share > 0.0 else 0.0)
        v[_T2 + k] += wuu * (log if share > 0.0 else 0.0)
        v[_LEAN + k] += share * u * u


@inlined
def _solved(v: Floats) -> None:
    """Find the parabolas' tops, and their uncertainty by the pixels' noise and the background's slope."""
    for k in range(LANES):
        s0, s1, s2, s3, s4 = v[_S0 + k], v[_S1 + k], v[_S2 + k], v[_S3 + k], v[_S4 + k]
        t0, t1, t2 = v[_T0 + k], v[_T1 + k], v[_T2 + k]
        # Parabola c0 + c1·u + c2·u²; its top is at −c1 / (2 c2).
        m11, m12, m22 = s2 * s0 - s1 * s1, s3 * s0 - s1 * s2, s4 * s0 - s2 * s2
        d1, d2 = t1 * s0 - s1 * t0, t2 * s0 - s2 * t0
        det = m11 * m22 - m12 * m12
        c1, c2 = d1 * m22 - d2 * m12, m11 * d2 - m12 * d1
        good = (det > 0.0) & (c2 < 0.0) & (abs(c1) < -v[_WIDTH + k] * c2)
        v[_MOVED + k] = -0.5 * c1 / c2 if good else np.nan
        # Of the pull of each logarithm on the top, the part by the parabola's width is left out: it is small.
        unit = -0.5 * s0 / c2
        v[_LEAN + k] *= unit * m22
        v[_PULL_1 + k], v[_PULL_2 + k] = unit * m22, unit * m12
        lean = v[_LEAN + k] * v[_LEAN + k] * v[_UNSURE + k] * v[_FLOOR + k]
        v[_STD + k] += np.sqrt(unit * unit * m22 * det / s0 + lean) if good else np.nan


@inlined
def _speckled(v: Floats, pulls: Floats, longest: int, alike: Floats) -> None:
    """Add what neighbouring pixels' speckle has in common; each pixel's own is among the weights already."""
    for k in range(LANES):
        v[_WEIGHT + k] = 0.0
        v[_MEAN_1 + k], v[_MEAN_2 + k] = v[_S1 + k] / v[_S0 + k], v[_S2 + k] / v[_S0 + k]
    for j in range(longest):
        here = pulls[j * LANES : (j + 1) * LANES]
        for k in range(LANES):
            u = v[_FIRST + k] + j
            here[k] *= v[_PULL_1 + k] * (u - v[_MEAN_1 + k]) - v[_PULL_2 + k] * (u * u - v[_MEAN_2 + k])
    for lag in range(1, LAGS + 1):
        share = 2.0 * alike[lag]
        if share < _UNLIKE:
            break
        for j in range(longest - lag):
            here, there = pulls[j * LANES : (j + 1) * LANES], pulls[(j + lag) * LANES : (j + lag + 1) * LANES]
            for k in range(LANES):
                v[_WEIGHT + k] += share * here[k] * there[k]
    for k in range(LANES):
        variance = v[_STD + k] * v[_STD + k] + v[_CONTRAST2 + k] * v[_WEIGHT + k]
        v[_STD + k] = np.sqrt(max(variance, 0.0))
