"""What noise is left beside fitted peaks, compiled: products of residuals, and what to expect of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.extraction.gaussian_fisher import FAILED, ROOM, WINDOW

CAUSES = 6
"""Read noise, shot noise, speckle within a pixel, and of pixels 1, 2 and 3 apart."""
_OUTLIER = 8.0  # times what a peak's other residuals are: it says nothing of the noise
_PIXELS_MIN = 6

Pixels = NDArray[Any]
Bytes = NDArray[np.uint8]


@kernel
def residual_products(
    image: Pixels,
    white: float,
    row: Integers,
    x_px: Floats,
    amplitude: Floats,
    sigma_px: Floats,
    height: Floats,
    slope: Floats,
    variance: Floats,
    gain: float,
    contrast2: Floats,
    state: Bytes,
) -> Floats:
    """Sum products of each peak's residuals, and what each cause of noise is expected to add to them.

    Residuals are smaller than the noise, by the leverage of the fitted parameters. With P the matrix that
    takes pixels to residuals, the expected products are the elements of P V P', linear in what the noise's
    covariance V is made of: a unit of R, of g μ, of C² m², and of C² m m' between pixels 1, 2, 3 apart.

    Parameters
    ----------
    image, white, row, x_px, amplitude, sigma_px, variance, gain, contrast2, state
        As `fit_peaks` takes and gives them; fitted without correlation.
    height, slope
        (peak,) light beside the stripe at the fitted centre, grey levels, grey levels per px.

    Returns
    -------
    ndarray
        (peak, 4, 7): products that tell of R, of g, of C² (a pixel with itself) and of the correlation (with
        the next pixel): their sum, then what a unit of each cause adds. All 0 where a peak says nothing.
    """
    columns = image.shape[1]
    out = np.zeros((row.shape[0], 4, 1 + CAUSES))
    m, mu, w, r = np.empty(ROOM), np.empty(ROOM), np.empty(ROOM), np.empty(ROOM)
    jac, hat, carried = np.empty((ROOM, 3)), np.empty((ROOM, 3)), np.empty((ROOM, 3))
    weight = np.zeros((ROOM, 4))
    for p in range(row.shape[0]):
        if state[p] == FAILED:
            continue
        f = image[row[p]]
        half = min(WINDOW * sigma_px[p], 0.5 * (ROOM - 2))
        first = max(math.ceil(x_px[p] - half), 0)
        n = min(math.floor(x_px[p] + half), columns - 1) - first + 1
        squares, largest = 0.0, 0.0
        for i in range(n):
            d = first + i - x_px[p]
            z = d / (sigma_px[p] * sigma_px[p])
            e = math.exp(-0.5 * d * z)
            m[i] = amplitude[p] * e
            mu[i] = max(height[p] + slope[p] * d + m[i], 0.0)
            r[i] = f[first + i] - height[p] - slope[p] * d - m[i]
            v = variance[p] + gain * mu[i] + contrast2[p] * m[i] * m[i]
            w[i] = 0.0 if f[first + i] >= white else 1.0 / v
            squares += w[i] * r[i] * r[i]
            largest = max(largest, w[i] * r[i] * r[i])
            jac[i, 0], jac[i, 1], jac[i, 2] = m[i] * z, e, m[i] * z * d
        # A hot pixel is unlike the others; where all are large, that is how these stripes are.
        others = max((squares - largest) / max(n - 3.0, 1.0), 1.0)
        good = n >= _PIXELS_MIN and largest <= _OUTLIER * _OUTLIER * others
        if not good or not _hat(jac, w, n, hat):
            continue
        for i in range(n):
            weight[i, 0] = w[i] * w[i]
            weight[i, 1] = weight[i, 0] * mu[i]
            weight[i, 2] = weight[i, 0] * m[i] * m[i]
            weight[i, 3] = w[i] * w[i + 1] * m[i] * m[i + 1] if i + 1 < n else 0.0
            for kind in range(3):
                out[p, kind, 0] += weight[i, kind] * r[i] * r[i]
            if i + 1 < n:
                out[p, 3, 0] += weight[i, 3] * r[i] * r[i + 1]
        _expected(jac, hat, weight, m, mu, n, carried, out[p])
    return out


@kernel
def _hat(jac: Floats, w: Floats, n: int, hat: Floats) -> bool:
    """(pixel, parameter) what a unit in a pixel adds to the fitted parameters: (J'WJ)⁻¹ J'W.

    Gives whether the pixels below white determine the parameters at all.
    """
    a = np.zeros((3, 3))
    for i in range(n):
        for j in range(3):
            for k in range(j + 1):
                a[j, k] += w[i] * jac[i, j] * jac[i, k]
    a01, a02, a12 = a[1, 0], a[2, 0], a[2, 1]
    c00, c01, c02 = a[1, 1] * a[2, 2] - a12 * a12, a02 * a12 - a01 * a[2, 2], a01 * a12 - a02 * a[1, 1]
    c11, c12 = a[0, 0] * a[2, 2] - a02 * a02, a01 * a02 - a[0, 0] * a12
    c22 = a[0, 0] * a[1, 1] - a01 * a01
    det = a[0, 0] * c00 + a01 * c01 + a02 * c02
    if not det > 0.0:
        return False
    for i in range(n):
        j0, j1, j2, s = jac[i, 0], jac[i, 1], jac[i, 2], w[i] / det
        hat[i, 0] = s * (c00 * j0 + c01 * j1 + c02 * j2)
        hat[i, 1] = s * (c01 * j0 + c11 * j1 + c12 * j2)
        hat[i, 2] = s * (c02 * j0 + c12 * j1 + c22 * j2)
    return True


@kernel
def _expected(
    jac: Floats, hat: Floats, weight: Floats, m: Floats, mu: Floats, n: int, carried: Floats, out: Floats
) -> None:
    """Sums of weights times elements of P V P' = V − J G V − (J G V)' + J G V G' J', G the `hat`'s transpose.

    Σ weight · (J K J') is the sum of the elements of K times those of Σ weight · J J', the same for every
    cause.
    """
    outer = np.zeros((4, 3, 3))
    for i in range(n):
        for j in range(3):
            for k in range(3):
                t = jac[i, j] * jac[i, k]
                for kind in range(3):
                    outer[kind, j, k] += weight[i, kind] * t
                if i + 1 < n:
                    outer[3, j, k] += weight[i, 3] * jac[i, j] * jac[i + 1, k]
    inner = np.empty((3, 3))
    for cause in range(CAUSES):
        lag = max(cause - 2, 0)
        for i in range(n):
            for j in range(3):
                carried[i, j] = 0.0
        for i in range(n - lag):
            if lag:
                t = m[i] * m[i + lag]
                for j in range(3):
                    carried[i, j] += hat[i + lag, j] * t
                    carried[i + lag, j] += hat[i, j] * t
            else:
                t = 1.0 if cause == 0 else mu[i] if cause == 1 else m[i] * m[i]
                for j in range(3):
                    carried[i, j] = hat[i, j] * t
                for kind in range(3):
                    out[kind, 1 + cause] += weight[i, kind] * t
        inner[:] = 0.0
        for i in range(n):
            both, cross = 0.0, 0.0
            for j in range(3):
                both += jac[i, j] * carried[i, j]
                if i + 1 < n:
                    cross += jac[i, j] * carried[i + 1, j] + jac[i + 1, j] * carried[i, j]
                for k in range(3):
                    inner[j, k] += carried[i, j] * hat[i, k]
            for kind in range(3):
                out[kind, 1 + cause] -= 2.0 * weight[i, kind] * both
            if lag == 1 and i + 1 < n:
                cross -= m[i] * m[i + 1]
            out[3, 1 + cause] -= weight[i, 3] * cross
        for kind in range(4):
            for j in range(3):
                for k in range(3):
                    out[kind, 1 + cause] += inner[j, k] * outer[kind, j, k]
