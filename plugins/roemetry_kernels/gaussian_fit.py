"""The Gaussian sub-pixel peak: weighted least squares on the logarithms of a stripe's profile, compiled."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.influence import PIXELS_MAX, bell, fading, variance_of
from roemetry_kernels.stripe_footing import FWHM_OF_SIGMA, Stripes
from roemetry_kernels.stripe_scan import Pixels

_REACH = 2.6  # standard deviations to both sides that are fitted
_LOWEST, _HIGHEST = 0.3, 3.0  # of the model: a pixel beyond counts as that dark or bright
_SIGNAL_TO_NOISE = 60.0  # of a stripe's top, where the sensor is not known
_SHOT = 0.3  # of the amplitude: where shot noise equals dark noise, where the sensor is not known


@float_kernel
def gaussian_centres(
    levels: Pixels,
    columns: int,
    s: Stripes,
    white: int,
    noise: Floats,
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
        Stripes, as `roemetry_kernels.stripe_footing.stripes_around` gave them.
    white
        Grey level from which on a pixel is saturated.
    noise
        As for `roemetry_kernels.influence.variance_of`.
    x_px, x_std_px
        (peak,) to be filled; `x_px` is NaN where there is no result, `x_std_px` where the sensor is unknown.
    """
    pull, light = np.empty(PIXELS_MAX), np.empty(PIXELS_MAX)
    known = noise[0] + noise[1] > 0.0
    speckle = noise[2] * noise[2]
    row, los, his, _, middles, widths, amplitudes, backgrounds, slopes, unsures = s
    for i in range(row.shape[0]):
        begins = row[i] * columns
        middle, background, slope, amplitude = middles[i], backgrounds[i], slopes[i], amplitudes[i]
        sigma = widths[i] / FWHM_OF_SIGMA
        reach, narrow = _REACH * sigma, 0.5 / (sigma * sigma)
        first = max(los[i], int(np.floor(middle - reach + 0.5)))
        last = min(his[i], int(np.floor(middle + reach + 0.5)), first + PIXELS_MAX - 1)
        gain = noise[1] if known else amplitude / (_SIGNAL_TO_NOISE * _SIGNAL_TO_NOISE * (1.0 + _SHOT))
        floor = noise[0] + gain * background if known else _SHOT * amplitude * gain
        s0 = s1 = s2 = s3 = s4 = t0 = t1 = t2 = leaning = 0.0
        # Places are unsigned, so that none can count from the end: only then does the loop run in vectors.
        place, from_middle = np.uint64(begins + first), first - middle
        for k in range(np.uint64(max(last + 1 - first, 0))):
            u = from_middle + np.int64(k)
            far = narrow * u * u
            model = amplitude * bell(far)
            level = float(levels[place + k])
            above = min(max(level - background - slope * u, _LOWEST * model), _HIGHEST * model)
            # ln(above / model), by a ratio of polynomials: to 2e-5 where they differ by 40 %.
            both = above * above + model * model
            log = 3.0 * (above * above - model * model) / (both + 4.0 * above * model) - far
            # Far from the middle a logarithm is noisier than its variance says: it counts as darker there.
            low = amplitude * fading(far)
            share = low / (floor + low * (gain + speckle * low))
            share = share if level < white else 0.0
            weight = low * share
            wu = weight * u
            wuu = wu * u
            s0 += weight
            s1 += wu
            s2 += wuu
            s3 += wuu * u
            s4 += wuu * u * u
            t0 += weight * log
            t1 += wu * log
            t2 += wuu * log
            leaning += share * u * u
        # Parabola c0 + c1·u + c2·u²; its top is at −c1 / (2 c2).
        m11, m12, m22 = s2 * s0 - s1 * s1, s3 * s0 - s1 * s2, s4 * s0 - s2 * s2
        d1, d2 = t1 * s0 - s1 * t0, t2 * s0 - s2 * t0
        det = m11 * m22 - m12 * m12
        c1, c2 = d1 * m22 - d2 * m12, m11 * d2 - m12 * d1
        x_px[i] = x_std_px[i] = np.nan
        if not (det > 0.0 and c2 < 0.0 and abs(c1) < -widths[i] * c2):
            continue
        x_px[i] = middle - 0.5 * c1 / c2
        if not known:
            continue
        # Of the pull of each logarithm on the top, the part by the parabola's width is left out: it is small.
        unit = -0.5 * s0 / c2
        if speckle > 0.0:
            for k in range(last + 1 - first):
                u = first + k - middle
                model, low = amplitude * bell(narrow * u * u), amplitude * fading(narrow * u * u)
                share = low * low / (floor + low * (gain + speckle * low)) / model
                pull[k] = unit * share * (m22 * (u - s1 / s0) - m12 * (u * u - s2 / s0))
                light[k] = model
            lean = unit * m22 * leaning
            x_std_px[i] = np.sqrt(
                variance_of(
                    levels,
                    white,
                    begins + first,
                    last + 1 - first,
                    pull,
                    light,
                    background,
                    lean,
                    unsures[i],
                    noise,
                )
            )
        else:
            lean = unit * m22 * leaning
            variance = unit * unit * m22 * det / s0 + lean * lean * unsures[i] * floor
            x_std_px[i] = np.sqrt(variance)
