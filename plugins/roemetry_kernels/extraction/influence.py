"""From the pull of each pixel on a stripe's centre to the centre's standard uncertainty, compiled."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import inlined
from roemetry_kernels.extraction.stripe_scan import Pixels

PIXELS_MAX = 512
"""Room for the pixels of one stripe."""

LAGS = 4  # px, within which speckle is taken as correlated


@inlined
def variance_of(
    levels: Pixels,
    white: int,
    first: int,
    count: int,
    pull: Floats,
    light: Floats,
    background: float,
    slope_pull: float,
    unsure: float,
    noise: Floats,
    contrast2: float,
) -> float:
    """Variance of a centre from the pixels' noise, the speckle, and the slope of the background, px².

    Parameters
    ----------
    levels
        Grey levels, row after row.
    white
        Grey level from which on a pixel is saturated, and has no noise.
    first, count
        The pixels that pull: the place of the first, and how many there are.
    pull
        (count or more,) change of the centre with the grey level of a pixel, px per grey level.
    light
        (count or more,) grey levels of the stripe alone, for the speckle.
    background
        Grey level of the background.
    slope_pull
        Change of the centre with the background's slope, px per (grey level per px).
    unsure
        (variance of that slope) / (variance of a background pixel), 1/px².
    noise
        (3,) variance of a black pixel, grey levels²; grey levels per electron; NaN where they are not known;
        correlation length of the speckle, px.
    contrast2
        Square of the speckle's contrast.
    """
    dark, gain, length = noise[0], noise[1], noise[2]
    total = 0.0
    for k in range(count):
        if levels[first + k] < white:
            total += pull[k] * pull[k] * (dark + gain * levels[first + k])
    if contrast2 > 0.0:
        total += contrast2 * _speckled(levels, white, first, count, pull, light, length)
    return total + slope_pull * slope_pull * unsure * (dark + gain * background)


@inlined
def bell(far: float) -> float:
    """Give exp(−far) by the series of its eighth root: to 1e-4 up to 3.4 (2.6 standard deviations)."""
    x = -0.125 * far
    root = 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0))))
    root *= root
    root *= root
    return root * root


@inlined
def fading(far: float) -> float:
    """Give a curve like exp(−far), and darker away from 0: (1 − far/8)⁸."""
    near = 1.0 - 0.125 * far
    near *= near
    near *= near
    return near * near


@inlined
def _speckled(
    levels: Pixels, white: int, first: int, count: int, pull: Floats, light: Floats, length: float
) -> float:
    """Variance by speckle of contrast 1, px²; the parameters are those of `variance_of`."""
    total = 0.0
    for lag in range(LAGS + 1):
        together = 0.0
        for k in range(count - lag):
            if levels[first + k] < white and levels[first + k + lag] < white:
                together += pull[k] * light[k] * pull[k + lag] * light[k + lag]
        alike = np.exp(-0.25 * (lag / length) ** 2) if lag > 0 else 0.5
        total += 2.0 * alike * together
    return total


@inlined
def variance_of_middle(
    width: float, amplitude: float, background: float, noise: Floats, contrast2: float
) -> float:
    """Variance of the middle between the half-height crossings of a Gaussian stripe, px².

    Each crossing is interpolated between two pixels of which the noise is (on the mean) two thirds of one's.

    Parameters
    ----------
    width
        Full width at half height, px.
    amplitude, background
        Of the stripe, grey levels.
    noise, contrast2
        As for `variance_of`.
    """
    steepness = 2.0 * np.log(2.0) * amplitude / width  # of a Gaussian at half height, grey levels per px
    light = 0.5 * amplitude
    pixel = (noise[0] + noise[1] * (background + light)) / 1.5 + contrast2 * light * light
    return 0.5 * pixel / (steepness * steepness)
