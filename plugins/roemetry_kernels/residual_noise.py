"""What noise is left beside fitted peaks, compiled: products of residuals, and what to expect of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from roemetry.arrays import Floats, Integers
from roemetry_kernels.gaussian_fisher import FAILED, ROOM, WINDOW

_LAGS = 5
_OUTLIER = 8.0

Pixels = NDArray[Any]


@njit(cache=True, nogil=True)
def residual_products(
    image: Pixels,
    white: float,
    row: Integers,
    x_px: Floats,
    amplitude: Floats,
    sigma_px: Floats,
    height: Floats,
    slope: Floats,
    variance: float,
    gain: float,
    contrast2: Floats,
    rho: float,
    state: NDArray[np.uint8],
) -> Floats:
    """Sum products of residuals of each peak, and their expectation by cause.

    Residuals of a fit are smaller than the noise, by the fitted parameters' leverage. With P what takes the
    pixels to the residuals, the expectation of a product is an element of P V P', linear in what the noise
    V is made of: R + g μ on the diagonal, C² m m' ρ^(lag²) everywhere.

    Returns
    -------
    ndarray
        (peak, 4, 7): for products weighted as for R, for g, for C² (all at lag 0), and at lag 1: the sum, and
        what one unit of R, of g, of C², and of C² ρ adds to it.
    """
    columns = image.shape[1]
    out = np.zeros((row.shape[0], 4, 7))
    m = np.empty(ROOM)
    mu = np.empty(ROOM)
    w = np.empty(ROOM)
    r = np.empty(ROOM)
    jac = np.empty((3, ROOM))
    gv = np.empty((3, ROOM))
    hat = np.empty((3, ROOM))
    v1 = np.empty(ROOM)
    k3 = np.empty((3, 3))
    for p in range(row.shape[0]):
        if state[p] == FAILED:
            continue
        f = image[row[p]]
        s, x0, a, c2 = sigma_px[p], x_px[p], amplitude[p], contrast2[p]
        half = min(WINDOW * s, 0.5 * (ROOM - 2))
        first = max(int(math.ceil(x0 - half)), 0)
        n = min(int(math.floor(x0 + half)), columns - 1) - first + 1
        normal = np.zeros((3, 3))
        bad = n < 6
        for i in range(n):
            d = first + i - x0
            e = math.exp(-0.5 * d * d / (s * s))
            m[i] = a * e
            mu[i] = max(height[p] + slope[p] * d + m[i], 0.0)
            r[i] = f[first + i] - height[p] - slope[p] * d - m[i]
            v = variance + gain * mu[i] + c2 * m[i] * m[i]
            w[i] = 1.0 / v
            if f[first + i] >= white:
                w[i] = 0.0
            elif r[i] * r[i] > _OUTLIER * _OUTLIER * v:
                bad = True
                break
            jac[0, i] = m[i] * d / (s * s)
            jac[1, i] = e
            jac[2, i] = jac[0, i] * d
            for j in range(3):
                for k in range(3):
                    normal[j, k] += w[i] * jac[j, i] * jac[k, i]
        if bad:
            continue
        inv = _inverse(normal)
        for i in range(n):
            for j in range(3):
                hat[j, i] = w[i] * (inv[j, 0] * jac[0, i] + inv[j, 1] * jac[1, i] + inv[j, 2] * jac[2, i])
        for i in range(n):
            out[p, 0, 0] += w[i] * w[i] * r[i] * r[i]
            out[p, 1, 0] += w[i] * w[i] * mu[i] * r[i] * r[i]
            out[p, 2, 0] += (w[i] * m[i] * r[i]) ** 2
            if i + 1 < n:
                out[p, 3, 0] += w[i] * w[i + 1] * m[i] * m[i + 1] * r[i] * r[i + 1]
        for cause in range(6):
            # V is diagonal for the first three causes; off the diagonal for the last.
            for i in range(n):
                for j in range(3):
                    gv[j, i] = 0.0
            if cause < 3:
                for i in range(n):
                    v1[i] = 1.0 if cause == 0 else (mu[i] if cause == 1 else m[i] * m[i])
                    for j in range(3):
                        gv[j, i] = hat[j, i] * v1[i]
            else:
                lag = cause - 2
                for i in range(n - lag):
                    t = m[i] * m[i + lag]
                    for j in range(3):
                        gv[j, i] += hat[j, i + lag] * t
                        gv[j, i + lag] += hat[j, i] * t
            for j in range(3):
                for k in range(3):
                    total = 0.0
                    for i in range(n):
                        total += gv[j, i] * hat[k, i]
                    k3[j, k] = total
            for i in range(n):
                own = v1[i] if cause < 3 else 0.0
                jg, jkj = 0.0, 0.0
                for j in range(3):
                    jg += jac[j, i] * gv[j, i]
                    for k in range(3):
                        jkj += jac[j, i] * k3[j, k] * jac[k, i]
                expected = own - 2.0 * jg + jkj
                out[p, 0, 1 + cause] += w[i] * w[i] * expected
                out[p, 1, 1 + cause] += w[i] * w[i] * mu[i] * expected
                out[p, 2, 1 + cause] += w[i] * w[i] * m[i] * m[i] * expected
                if i + 1 < n:
                    cross = m[i] * m[i + 1] if cause == 3 else 0.0
                    for j in range(3):
                        cross -= jac[j, i] * gv[j, i + 1] + jac[j, i + 1] * gv[j, i]
                        for k in range(3):
                            cross += jac[j, i] * k3[j, k] * jac[k, i + 1]
                    out[p, 3, 1 + cause] += w[i] * w[i + 1] * m[i] * m[i + 1] * cross
    return out


@njit(cache=True, nogil=True)
def _inverse(a: Floats) -> Floats:
    c = np.empty((3, 3))
    c[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] ** 2
    c[0, 1] = c[1, 0] = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c[0, 2] = c[2, 0] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    c[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] ** 2
    c[1, 2] = c[2, 1] = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    c[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] ** 2
    det = a[0, 0] * c[0, 0] + a[0, 1] * c[0, 1] + a[0, 2] * c[0, 2]
    return c / det
