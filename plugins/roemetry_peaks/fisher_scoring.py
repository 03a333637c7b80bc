"""Centre, height and width of Gaussian stripes by Fisher scoring.

Model. A peak's pixels are y = b + a exp(−(x − x0)² / 2σ²) + noise, b the straight line of the light beside
it. The noise has the variance R + g μ + C² m² (read noise and rounding, shot noise, speckle; m the stripe's
light, μ all light), and the speckle of neighbouring pixels has the correlation ρ. The inverse of the
covariance is taken to be tridiagonal, as of a Markov chain: each pixel is predicted from the one before.
Without speckle that is the diagonal. Each step solves J'WJ δ = J'W r for x0, a and ln σ, W with the last
step's model in it, until the centre moves by less than a tenth of its standard uncertainty; then on without
pixels beyond 5 standard deviations.

Uncertainty: the centre moves by Σ q y with q = W J h, so its variance is q' V q with the whole covariance
V, speckle correlated over ± 4 pixels: W is not quite the inverse of it (the sandwich formula).

Peaks whose windows are as long as each other go through the arithmetic sixteen at a time: one table of
numbers holds all fields of all lanes, at constant distances, and nothing branches. That is what the
compiler needs to see that lanes do not depend on each other.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel

WINDOW = 3.2
"""Half of a fitted window, standard deviations of the stripe."""
ROOM = 128
"""Largest number of pixels of a window."""
FAILED, FITTED, CLIPPED = 0, 1, 2
"""State of a peak: no fit; a fit; a fit without its saturated pixels."""

_FIRST_STEPS = 1  # on the window of the start values
_STEPS_MAX = 14  # at most; the last answer stands if it has not come to rest
_LAST_STEPS = 5  # at most, without outliers
_ENOUGH = 0.1  # of its standard uncertainty: a centre that moves by less rests
_OUTLIER = 5.0  # standard deviations; pixels beyond are left out of the last steps
_SHIFT_MAX = 2.5  # standard deviations of the stripe from the start
_SIGMA_MIN_PX, _SIGMA_MAX_PX = 0.3, 0.5 * ROOM / WINDOW  # of a stripe: a wider one's window has no room

Pixels = NDArray[Any]
Bytes = NDArray[np.uint8]


class Gaussians(NamedTuple):
    """Gaussian stripes on the light beside them, a straight line; one element a peak."""

    row: Integers
    x_px: Floats
    amplitude: Floats
    sigma_px: Floats
    """x_px, amplitude, sigma_px: centre, px; height above the line, grey levels; standard deviation, px."""
    height: Floats
    slope: Floats
    """height, slope: the line's grey level at `x_px`, and its growth, grey levels per px."""


class PeakNoise(NamedTuple):
    """The noise of each peak's pixels: R + (d a)² + g μ + C² m², as in `maximum_likelihood`."""

    variance: float
    gain: float
    """variance, gain: R, grey levels²; g, grey levels."""
    correlation: float
    """Of the speckle of neighbouring pixels."""
    contrast2: Floats
    """(peak,) C²."""
    error: Floats
    """(peak,) (d a)², variance of the error of the profile's model, grey levels². Such an error is smooth
    across the profile: weights that expect correlated speckle would amplify it, so where there is one, pixels
    are weighted as if they were independent."""


class Fitted(NamedTuple):
    """Fits, one element a peak."""

    x_px: Floats
    amplitude: Floats
    sigma_px: Floats
    x_std_px: Floats
    """Standard uncertainty of the centre, px."""
    speckled: Floats
    """Share of speckle in its variance."""
    state: Bytes
    """`FAILED`, `FITTED` or `CLIPPED`."""


@kernel
def fit_peaks(image: Pixels, white: float, start: Gaussians, noise: PeakNoise) -> Fitted:
    """Fit all peaks of an image of grey levels; pixels from `white` on are saturated and do not count."""
    row, height, slope = start.row, start.height, start.slope
    peaks = row.shape[0]
    x_px, amplitude, sigma_px = start.x_px.copy(), start.amplitude.copy(), start.sigma_px.copy()
    x_std_px, speckled, state = np.full(peaks, np.nan), np.zeros(peaks), np.full(peaks, FITTED, np.uint8)
    order = np.empty(peaks, np.int64)
    lanes = np.zeros(TABLE)
    grey = np.zeros((ROOM + 1) * LANES)
    keep, used = np.zeros_like(grey), np.zeros_like(grey)
    gain, rho = noise.gain, noise.correlation
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
                    for p in members:
                        state[p] = FAILED
                    continue
                for lane in range(LANES):
                    p = members[min(lane, count - 1)]
                    first = _first(x_px[p], sigma_px[p])
                    lanes[X + lane], lanes[A + lane], lanes[S + lane] = x_px[p], amplitude[p], sigma_px[p]
                    lanes[B + lane], lanes[SLOPE + lane] = height[p], slope[p]
                    lanes[C2 + lane], lanes[R + lane] = noise.contrast2[p], noise.variance
                    lanes[ERROR + lane] = noise.error[p]
                    lanes[RHO + lane] = 0.0 if noise.error[p] > 0.0 else rho
                    lanes[START_X + lane], lanes[START_S + lane] = start.x_px[p], start.sigma_px[p]
                    lanes[FIRST + lane] = first
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
                    speckle = max(lanes[SPECKLE + lane], 0.0)
                    x_std_px[p] = math.sqrt(lanes[SPREAD + lane] + speckle)
                    speckled[p] = speckle / (lanes[SPREAD + lane] + speckle + 1e-300)
                    x_px[p], amplitude[p], sigma_px[p] = lanes[X + lane], lanes[A + lane], lanes[S + lane]
                    if lanes[GOOD + lane] == 0.0:
                        state[p] = FAILED
    return Fitted(x_px, amplitude, sigma_px, x_std_px, speckled, state)


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
    lanes[GOOD : GOOD + LANES] = 1.0
    lanes[LIMIT : LIMIT + LANES] = np.inf
    for step in range(_STEPS_MAX if to_the_end else _FIRST_STEPS):
        last = lanes[LIMIT] < np.inf
        normal_sums(lanes, grey, keep, used, n, gain)
        steps(lanes, _ENOUGH, _SHIFT_MAX, _SIGMA_MIN_PX, _SIGMA_MAX_PX)
        rests = True
        for lane in range(LANES):
            rests &= lanes[MOVES + lane] == 0.0
        if last and rests:
            break
        # Which pixels are outliers is asked at each step anew: one hot pixel makes good ones look bad.
        if to_the_end and (rests or step == _STEPS_MAX - _LAST_STEPS):
            lanes[LIMIT : LIMIT + LANES] = _OUTLIER * _OUTLIER


LANES = 16
"""Peaks side by side; loops over fewer are not turned into vector instructions."""

# Where each field begins in the table.
X, A, S, B, SLOPE, C2, START_X, START_S, LIMIT, FIRST = range(0, 10 * LANES, LANES)
HALF_INVERSE, M, IV, W0, W1, W2, W3 = range(10 * LANES, 17 * LANES, LANES)
N00, N01, N02, N11, N12, N22, G0, G1, G2, H0, H1, H2 = range(17 * LANES, 29 * LANES, LANES)
U, E, MU, P1, P2, P3, P4, SPREAD, SPECKLE = range(29 * LANES, 38 * LANES, LANES)
GOOD, MOVES, R, ERROR, RHO, LEFT, RIGHT, TABLE = range(38 * LANES, 46 * LANES, LANES)
_E3, _E4, _E5, _E6, _E7, _E8 = 1 / 6, 1 / 24, 1 / 120, 1 / 720, 1 / 5040, 1 / 40320  # 1/n!: exp as a series


@kernel(fastmath={"contract", "nsz"}, error_model="numpy")
def normal_sums(
    lanes: Floats,
    grey: Floats,
    keep: Floats,
    used: Floats,
    n: int,
    gain: float,
) -> None:
    """Sums of each lane's normal equations, for x0, a and ln σ; `used` are those of `keep` within LIMIT."""
    for lane in range(LANES):
        lanes[HALF_INVERSE + lane] = 0.5 / (lanes[S + lane] * lanes[S + lane])
    for field in (M, IV, W0, W1, W2, W3, N00, N01, N02, N11, N12, N22, G0, G1, G2):
        for lane in range(LANES):
            lanes[field + lane] = 0.0
    for i in range(n):
        for lane in range(LANES):
            x = lanes[FIRST + lane] + i
            d = x - lanes[X + lane]
            inverse = lanes[HALF_INVERSE + lane]
            e = gauss(d * d * inverse)
            m = lanes[A + lane] * e
            b = lanes[B + lane] + lanes[SLOPE + lane] * (x - lanes[START_X + lane])
            r = grey[LANES * i + lane] - b - m
            v = lanes[R + lane] + lanes[ERROR + lane] + gain * max(b + m, 0.0) + lanes[C2 + lane] * m * m
            kept = keep[LANES * i + lane] if r * r <= lanes[LIMIT + lane] * v else 0.0
            used[LANES * i + lane] = kept
            j0 = 2.0 * m * d * inverse
            j2 = j0 * d
            # What the pixel before tells of this one by the speckle both share is taken off; what is left
            # has the variance v − c²/v'. One division serves for both variances.
            before = lanes[IV + lane]
            c = lanes[RHO + lane] * lanes[C2 + lane] * m * lanes[M + lane]
            told = c * before
            left = v - c * told
            over = kept / (v * left)
            q0, q1 = j0 - told * lanes[W0 + lane], e - told * lanes[W1 + lane]
            q2, q3 = j2 - told * lanes[W2 + lane], r - told * lanes[W3 + lane]
            weight = v * over
            p0, p1, p2 = weight * q0, weight * q1, weight * q2
            lanes[M + lane], lanes[IV + lane] = m, left * over
            lanes[W0 + lane], lanes[W1 + lane], lanes[W2 + lane], lanes[W3 + lane] = j0, e, j2, r
            lanes[N00 + lane] += p0 * q0
            lanes[N01 + lane] += p0 * q1
            lanes[N02 + lane] += p0 * q2
            lanes[N11 + lane] += p1 * q1
            lanes[N12 + lane] += p1 * q2
            lanes[N22 + lane] += p2 * q2
            lanes[G0 + lane] += p0 * q3
            lanes[G1 + lane] += p1 * q3
            lanes[G2 + lane] += p2 * q3


@kernel(fastmath={"contract", "nsz"}, error_model="numpy")
def steps(lanes: Floats, enough: float, shift_max: float, sigma_min: float, sigma_max: float) -> None:
    """Take each lane's step from its normal equations; GOOD and MOVES say of each 1 or 0.

    A lane is no longer GOOD where the equations have no solution, or where it left what is near its start or
    a stripe's width. It MOVES where the step is longer than `enough` of the centre's standard uncertainty.
    `shift_max` is in standard deviations of the stripe, `sigma_min` and `sigma_max` in px.
    """
    for lane in range(LANES):
        n00, n01, n02 = lanes[N00 + lane], lanes[N01 + lane], lanes[N02 + lane]
        n11, n12, n22 = lanes[N11 + lane], lanes[N12 + lane], lanes[N22 + lane]
        g0, g1, g2 = lanes[G0 + lane], lanes[G1 + lane], lanes[G2 + lane]
        c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
        c11, c12, c22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
        det = n00 * c00 + n01 * c01 + n02 * c02
        # as good as singular: not solved
        solved = det > 1e-9 * n00 * n11 * n22
        one = 1.0 / (det if solved else 1.0)
        a, s = lanes[A + lane], lanes[S + lane]
        dx = (c00 * g0 + c01 * g1 + c02 * g2) * one
        da = (c01 * g0 + c11 * g1 + c12 * g2) * one
        ds = (c02 * g0 + c12 * g1 + c22 * g2) * one
        far = abs(dx) + 0.3 * s * abs(ds)
        good = lanes[GOOD + lane] if solved else 0.0
        lanes[MOVES + lane] = good if far * far > enough * enough * c00 * one else 0.0
        # A lane that is not good stays where it is.
        dx, da, ds = (dx, da, ds) if good > 0.0 else (0.0, 0.0, 0.0)
        lanes[H0 + lane] = c00 * one if good > 0.0 else lanes[H0 + lane]
        lanes[H1 + lane] = c01 * one if good > 0.0 else lanes[H1 + lane]
        lanes[H2 + lane] = c02 * one if good > 0.0 else lanes[H2 + lane]
        # 0.7 σ a step at most: farther the model is not linear
        x = lanes[X + lane] + min(max(dx, -0.7 * s), 0.7 * s)
        # exp(ds) to 1e-6 of 1.
        ds = min(max(ds, -0.4), 0.4)
        s *= 1.0 + ds * (1.0 + ds * (0.5 + ds * (_E3 + ds * (_E4 + ds * (_E5 + ds * _E6)))))
        lanes[X + lane], lanes[S + lane] = x, s
        # the height changes by factors of 0.4 to 2.5 at most
        lanes[A + lane] = min(max(a + da, 0.4 * a), 2.5 * a)
        near = abs(x - lanes[START_X + lane]) <= shift_max * max(lanes[START_S + lane], 1.0)
        near &= (s >= sigma_min) & (s <= sigma_max)
        lanes[GOOD + lane] = good if near else 0.0


@kernel(fastmath={"contract", "nsz"}, error_model="numpy")
def centre_variance(lanes: Floats, used: Floats, n: int, gain: float, rho: float) -> None:
    """Variance of each lane's centre, of white noise (SPREAD) and of SPECKLE.

    H0, H1, H2 hold the centre's row of the inverse normal matrix.

    The centre moves by Σ q y with q = W J h, W the weights' tridiagonal matrix; so its variance is q' V q
    with the whole covariance V of the noise, which W is not quite the inverse of (the sandwich formula).
    """
    for lane in range(LANES):
        lanes[HALF_INVERSE + lane] = 0.5 / (lanes[S + lane] * lanes[S + lane])
    for field in (M, IV, U, E, MU, P1, P2, P3, P4, SPREAD, SPECKLE, LEFT, RIGHT):
        for lane in range(LANES):
            lanes[field + lane] = 0.0
    # a Gaussian correlation: ρ to the square of the lag
    r2, r3, r4 = rho**4, rho**9, rho**16
    # One more than there are pixels: a pixel's influence is known once the next one's is.
    for i in range(n + 1):
        for lane in range(LANES):
            x = lanes[FIRST + lane] + i
            d = x - lanes[X + lane]
            inverse = lanes[HALF_INVERSE + lane]
            e = gauss(d * d * inverse)
            m = lanes[A + lane] * e
            mu = max(lanes[B + lane] + lanes[SLOPE + lane] * (x - lanes[START_X + lane]) + m, 0.0)
            v = lanes[R + lane] + lanes[ERROR + lane] + gain * mu + lanes[C2 + lane] * m * m
            j0 = 2.0 * m * d * inverse
            before = lanes[IV + lane]
            c = lanes[RHO + lane] * lanes[C2 + lane] * m * lanes[M + lane]
            told = c * before
            left = v - c * told
            over = used[LANES * i + lane] / (v * left)
            u = lanes[H0 + lane] * j0 + lanes[H1 + lane] * e + lanes[H2 + lane] * j0 * d
            own = v * over * (u - told * lanes[U + lane])
            q = lanes[E + lane] - told * own
            p = q * lanes[M + lane]
            near = (
                rho * lanes[P1 + lane] + r2 * lanes[P2 + lane] + r3 * lanes[P3 + lane] + r4 * lanes[P4 + lane]
            )
            before_top = x - 1.0 < lanes[X + lane]
            lanes[LEFT + lane] += q if before_top else 0.0
            lanes[RIGHT + lane] += 0.0 if before_top else q
            lanes[SPREAD + lane] += q * q * (lanes[R + lane] + gain * lanes[MU + lane])
            lanes[SPECKLE + lane] += lanes[C2 + lane] * p * (p + 2.0 * near)
            lanes[P4 + lane] = lanes[P3 + lane]
            lanes[P3 + lane] = lanes[P2 + lane]
            lanes[P2 + lane] = lanes[P1 + lane]
            lanes[P1 + lane] = p
            lanes[M + lane], lanes[IV + lane], lanes[MU + lane] = m, left * over, mu
            lanes[U + lane], lanes[E + lane] = u, own
    # The model errs alike in all pixels of one flank.
    for lane in range(LANES):
        left, right = lanes[LEFT + lane], lanes[RIGHT + lane]
        lanes[SPREAD + lane] += lanes[ERROR + lane] * (left * left + right * right)


@kernel(inline="always")
def gauss(t: float) -> float:
    """exp(−t) for 0 ≤ t ≤ 12 to 1e-7 of 1, without a branch, so that it can run in lanes."""
    t = -0.0625 * min(t, 12.0)
    e = 1.0 + t * (1.0 + t * (0.5 + t * (_E3 + t * (_E4 + t * (_E5 + t * (_E6 + t * (_E7 + t * _E8)))))))
    e *= e
    e *= e
    e *= e
    return e * e
