"""The arithmetic of a Fisher step for sixteen peaks side by side, compiled into vector instructions.

One table of numbers holds all fields of all lanes, at constant distances, and nothing branches: that is what
the compiler needs to see that lanes do not depend on each other.
"""

from __future__ import annotations

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import kernel

LANES = 16
"""Peaks side by side; loops over fewer are not turned into vector instructions."""

# Where each field begins in the table.
X = 0 * LANES
A = 1 * LANES
S = 2 * LANES
B = 3 * LANES
SLOPE = 4 * LANES
C2 = 5 * LANES
START_X = 6 * LANES
START_S = 7 * LANES
LIMIT = 8 * LANES
FIRST = 9 * LANES
HALF_INVERSE = 10 * LANES
M = 11 * LANES
IV = 12 * LANES
W0 = 13 * LANES
W1 = 14 * LANES
W2 = 15 * LANES
W3 = 16 * LANES
N00 = 17 * LANES
N01 = 18 * LANES
N02 = 19 * LANES
N11 = 20 * LANES
N12 = 21 * LANES
N22 = 22 * LANES
G0 = 23 * LANES
G1 = 24 * LANES
G2 = 25 * LANES
H0 = 26 * LANES
H1 = 27 * LANES
H2 = 28 * LANES
U = 29 * LANES
E = 30 * LANES
MU = 31 * LANES
P1 = 32 * LANES
P2 = 33 * LANES
P3 = 34 * LANES
P4 = 35 * LANES
SPREAD = 36 * LANES
SPECKLE = 37 * LANES
GOOD = 38 * LANES
MOVES = 39 * LANES
R = 40 * LANES
ERROR = 41 * LANES
RHO = 42 * LANES
LEFT = 43 * LANES
RIGHT = 44 * LANES
TABLE = 45 * LANES
_E3, _E4, _E5, _E6, _E7, _E8 = 1 / 6, 1 / 24, 1 / 120, 1 / 720, 1 / 5040, 1 / 40320


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
        x = lanes[X + lane] + min(max(dx, -0.7 * s), 0.7 * s)
        # exp(ds) to 1e-6 of 1.
        ds = min(max(ds, -0.4), 0.4)
        s *= 1.0 + ds * (1.0 + ds * (0.5 + ds * (_E3 + ds * (_E4 + ds * (_E5 + ds * _E6)))))
        lanes[X + lane], lanes[S + lane] = x, s
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
