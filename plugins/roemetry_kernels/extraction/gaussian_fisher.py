"""Centre, height and width of Gaussian stripes by Fisher scoring, compiled.

A peak's pixels are y = b + a exp(−(x − x0)² / 2σ²) + noise, b the straight line of the light beside it. The
noise has the variance R + g μ + C² m² (read noise and rounding, shot noise, speckle; m the stripe's light, μ
all light), and the speckle of neighbouring pixels has the correlation ρ. The inverse of the covariance is
taken to be tridiagonal, as of a Markov chain: each pixel is predicted from the one before. Without speckle
that is the diagonal.

Peaks whose windows are as long as each other go through the arithmetic in lanes, so that the compiler can use
vector instructions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.extraction import fisher_lanes as at
from roemetry_kernels.extraction.fisher_lanes import LANES, centre_variance, normal_sums, steps

WINDOW = 3.2
"""Half of a fitted window, standard deviations of the stripe."""
ROOM = 128
"""Largest number of pixels of a window."""
FAILED, FITTED, CLIPPED = 0, 1, 2
"""State of a peak: no fit; a fit; a fit without its saturated pixels."""

_FIRST_STEPS = 1  # on the window of the start values
_STEPS_MAX = 14
_LAST_STEPS = 5  # at most, without outliers
_ENOUGH = 0.1  # of its standard uncertainty: a centre that moves by less rests
_OUTLIER = 5.0  # standard deviations; pixels beyond are left out of the last steps
_SHIFT_MAX = 2.5  # standard deviations of the stripe from the start
_SIGMA_MIN_PX, _SIGMA_MAX_PX = 0.3, 0.5 * ROOM / WINDOW

Pixels = NDArray[Any]
Bytes = NDArray[np.uint8]


@kernel
def fit_peaks(
    image: Pixels,
    white: float,
    row: Integers,
    x_px: Floats,
    amplitude: Floats,
    sigma_px: Floats,
    height: Floats,
    slope: Floats,
    variance: float,
    error: Floats,
    gain: float,
    contrast2: Floats,
    rho: float,
    x_std_px: Floats,
    speckled: Floats,
    state: Bytes,
) -> None:
    """Fit all peaks, in place.

    Parameters
    ----------
    image
        (row, column) grey levels.
    white
        Grey level from which on a pixel is saturated and does not count.
    row
        (peak,) image row.
    x_px, amplitude, sigma_px
        (peak,) start values, replaced by the fit: centre, px; height above the light beside it, grey
        levels; standard deviation, px.
    height, slope
        (peak,) light beside the stripe: grey levels at the start's `x_px`, grey levels per px.
    variance, gain
        R, grey levels²; g, grey levels.
    error
        (peak,) variance of the error of the profile's model, grey levels². Such an error is smooth across the
        profile: weights that expect correlated speckle would amplify it, so where there is one, pixels are
        weighted as if they were independent.
    contrast2
        (peak,) C².
    rho
        Correlation of the speckle of neighbouring pixels.
    x_std_px
        (peak,) becomes the standard uncertainty of the centre, px.
    speckled
        (peak,) becomes the share of speckle in its variance.
    state
        (peak,) becomes `FAILED`, `FITTED` or `CLIPPED`.
    """
    peaks = row.shape[0]
    order = np.empty(peaks, np.int64)
    lanes = np.zeros(at.TABLE)
    grey = np.zeros((ROOM + 1) * LANES)
    keep = np.zeros((ROOM + 1) * LANES)
    used = np.zeros((ROOM + 1) * LANES)
    start_x, start_s = x_px.copy(), sigma_px.copy()
    state[:] = FITTED
    for phase in range(2):
        lengths = _by_length(x_px, sigma_px, state, image.shape[1], order)
        begin = 0
        for n in range(ROOM + 1):
            end = begin + lengths[n]
            while begin < end:
                count = min(LANES, end - begin)
                members = order[begin : begin + count]
                begin += count
                if n < 4:
                    state[members] = FAILED
                    continue
                for lane in range(LANES):
                    p = members[min(lane, count - 1)]
                    first = _first(x_px[p], sigma_px[p])
                    lanes[at.X + lane], lanes[at.A + lane], lanes[at.S + lane] = (
                        x_px[p],
                        amplitude[p],
                        sigma_px[p],
                    )
                    lanes[at.B + lane], lanes[at.SLOPE + lane] = height[p], slope[p]
                    lanes[at.C2 + lane], lanes[at.R + lane] = contrast2[p], variance
                    lanes[at.ERROR + lane] = error[p]
                    lanes[at.RHO + lane] = 0.0 if error[p] > 0.0 else rho
                    lanes[at.START_X + lane], lanes[at.START_S + lane] = start_x[p], start_s[p]
                    lanes[at.FIRST + lane] = first
                    clipped = False
                    for i in range(n):
                        grey[LANES * i + lane] = image[row[p], first + i]
                        keep[LANES * i + lane] = 1.0
                        if grey[LANES * i + lane] >= white:
                            keep[LANES * i + lane] = 0.0
                            clipped = True
                    used[LANES * n + lane] = 0.0
                    if clipped and phase == 1 and lane < count:
                        state[p] = CLIPPED
                _fit_lanes(lanes, grey, keep, used, n, gain, phase == 1)
                if phase == 1:
                    centre_variance(lanes, used, n, gain, rho)
                for lane in range(count):
                    p = members[lane]
                    speckle = max(lanes[at.SPECKLE + lane], 0.0)
                    x_std_px[p] = math.sqrt(lanes[at.SPREAD + lane] + speckle)
                    speckled[p] = speckle / (lanes[at.SPREAD + lane] + speckle + 1e-300)
                    x_px[p], amplitude[p], sigma_px[p] = (
                        lanes[at.X + lane],
                        lanes[at.A + lane],
                        lanes[at.S + lane],
                    )
                    if lanes[at.GOOD + lane] == 0.0:
                        state[p] = FAILED


@kernel
def _first(x: float, sigma: float) -> int:
    return max(math.ceil(x - min(WINDOW * sigma, 0.5 * (ROOM - 2))), 0)


@kernel
def _by_length(x_px: Floats, sigma_px: Floats, state: Bytes, columns: int, order: Integers) -> Integers:
    """Sort the peaks that are left by the length of their windows; gives how many have each length."""
    length = np.zeros(x_px.shape[0], np.int64)
    lengths = np.zeros(ROOM + 2, np.int64)
    for p in range(x_px.shape[0]):
        if state[p] == FAILED:
            length[p] = ROOM + 1
        else:
            last = math.floor(x_px[p] + min(WINDOW * sigma_px[p], 0.5 * (ROOM - 2)))
            length[p] = max(min(last, columns - 1) - _first(x_px[p], sigma_px[p]) + 1, 0)
        lengths[length[p]] += 1
    at = np.cumsum(lengths) - lengths
    for p in range(x_px.shape[0]):
        order[at[length[p]]] = p
        at[length[p]] += 1
    return lengths


@kernel
def _fit_lanes(
    lanes: Floats,
    grey: Floats,
    keep: Floats,
    used: Floats,
    n: int,
    gain: float,
    to_the_end: bool,
) -> None:
    """Step until all lanes rest, then on without outliers."""
    lanes[at.GOOD : at.GOOD + LANES] = 1.0
    lanes[at.LIMIT : at.LIMIT + LANES] = np.inf
    for step in range(_STEPS_MAX if to_the_end else _FIRST_STEPS):
        last = lanes[at.LIMIT] < np.inf
        normal_sums(lanes, grey, keep, used, n, gain)
        steps(lanes, _ENOUGH, _SHIFT_MAX, _SIGMA_MIN_PX, _SIGMA_MAX_PX)
        rests = True
        for lane in range(LANES):
            rests &= lanes[at.MOVES + lane] == 0.0
        if last and rests:
            break
        # Which pixels are outliers is asked at each step anew: one hot pixel makes good ones look bad.
        if to_the_end and (rests or step == _STEPS_MAX - _LAST_STEPS):
            lanes[at.LIMIT : at.LIMIT + LANES] = _OUTLIER * _OUTLIER
