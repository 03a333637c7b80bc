"""The arithmetic of a Fisher step for sixteen peaks side by side, compiled into vector instructions.

One table of numbers holds all fields of all lanes, at constant distances, and nothing branches: that is what
the compiler needs to see that lanes do not depend on each other.
"""

from __future__ import annotations

import math

from roemetry.arrays import Floats
from roemetry_kernels.compiling import kernel

LANES = 16
"""Peaks side by side; loops over fewer are not turned into vector instructions."""
SPECKLE_REACH_PX = 4
"""Farthest pixels whose speckle is taken to be correlated."""

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
TABLE = 38 * LANES
_E3, _E4, _E5, _E6, _E7, _E8 = 1 / 6, 1 / 24, 1 / 120, 1 / 720, 1 / 5040, 1 / 40320


@kernel(fastmath={"contract", "nsz"}, error_model="numpy")
def normal_sums(
    lanes: Floats,
    grey: Floats,
    keep: Floats,
    used: Floats,
    n: int,
    variance: float,
    gain: float,
    rho: float,
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
            v = variance + gain * max(b + m, 0.0) + lanes[C2 + lane] * m * m
            kept = keep[LANES * i + lane] if r * r <= lanes[LIMIT + lane] * v else 0.0
            used[LANES * i + lane] = kept
            iv = kept / math.sqrt(v)
            j0 = 2.0 * m * d * inverse
            w0, w1, w2, w3 = j0 * iv, e * iv, j0 * d * iv, r * iv
            t = rho * lanes[C2 + lane] * m * iv * lanes[M + lane] * lanes[IV + lane]
            z = 1.0 / math.sqrt(1.0 - t * t)
            q0 = (w0 - t * lanes[W0 + lane]) * z
            q1 = (w1 - t * lanes[W1 + lane]) * z
            q2 = (w2 - t * lanes[W2 + lane]) * z
            q3 = (w3 - t * lanes[W3 + lane]) * z
            lanes[M + lane], lanes[IV + lane] = m, iv
            lanes[W0 + lane], lanes[W1 + lane], lanes[W2 + lane], lanes[W3 + lane] = w0, w1, w2, w3
            lanes[N00 + lane] += q0 * q0
            lanes[N01 + lane] += q0 * q1
            lanes[N02 + lane] += q0 * q2
            lanes[N11 + lane] += q1 * q1
            lanes[N12 + lane] += q1 * q2
            lanes[N22 + lane] += q2 * q2
            lanes[G0 + lane] += q0 * q3
            lanes[G1 + lane] += q1 * q3
            lanes[G2 + lane] += q2 * q3


@kernel(fastmath={"contract", "nsz"}, error_model="numpy")
def centre_variance(lanes: Floats, used: Floats, n: int, variance: float, gain: float, rho: float) -> None:
    """Variance of each lane's centre, of white noise (SPREAD) and of SPECKLE.

    H0, H1, H2 hold the centre's row of the inverse normal matrix.

    The centre moves by Σ q y with q = W J h, W the weights' tridiagonal matrix; so its variance is q' V q
    with the whole covariance V of the noise, which W is not quite the inverse of (the sandwich formula).
    """
    for lane in range(LANES):
        lanes[HALF_INVERSE + lane] = 0.5 / (lanes[S + lane] * lanes[S + lane])
    for field in (M, IV, U, E, MU, P1, P2, P3, P4, SPREAD, SPECKLE):
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
            v = variance + gain * mu + lanes[C2 + lane] * m * m
            iv = used[LANES * i + lane] / math.sqrt(v)
            j0 = 2.0 * m * d * inverse
            u = iv * (lanes[H0 + lane] * j0 + lanes[H1 + lane] * e + lanes[H2 + lane] * j0 * d)
            t = rho * lanes[C2 + lane] * m * iv * lanes[M + lane] * lanes[IV + lane]
            own = (u - t * lanes[U + lane]) / (1.0 - t * t)
            q = lanes[IV + lane] * (lanes[E + lane] - t * own)
            p = q * lanes[M + lane]
            near = (
                rho * lanes[P1 + lane] + r2 * lanes[P2 + lane] + r3 * lanes[P3 + lane] + r4 * lanes[P4 + lane]
            )
            lanes[SPREAD + lane] += q * q * (variance + gain * lanes[MU + lane])
            lanes[SPECKLE + lane] += lanes[C2 + lane] * p * (p + 2.0 * near)
            lanes[P4 + lane] = lanes[P3 + lane]
            lanes[P3 + lane] = lanes[P2 + lane]
            lanes[P2 + lane] = lanes[P1 + lane]
            lanes[P1 + lane] = p
            lanes[M + lane], lanes[IV + lane], lanes[MU + lane] = m, iv, mu
            lanes[U + lane], lanes[E + lane] = u, own


@kernel(inline="always")
def gauss(t: float) -> float:
    """exp(−t) for 0 ≤ t ≤ 12 to 1e-7 of 1, without a branch, so that it can run in lanes."""
    t = -0.0625 * min(t, 12.0)
    e = 1.0 + t * (1.0 + t * (0.5 + t * (_E3 + t * (_E4 + t * (_E5 + t * (_E6 + t * (_E7 + t * _E8)))))))
    e *= e
    e *= e
    e *= e
    return e * e
