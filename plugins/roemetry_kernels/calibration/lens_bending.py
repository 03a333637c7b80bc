"""Lens distortion put on many places at once, in OpenCV's rational model, with its derivatives."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel


@float_kernel
def bend(xy: Floats, coefficients: Floats) -> tuple[Floats, Floats, Floats]:
    """Give where the lens bends places (n, 2) on the plane at distance 1, and the derivatives of that.

    Parameters
    ----------
    xy
        (n, 2) as they would be without a lens.
    coefficients
        (8,) k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's model.

    Returns
    -------
    tuple of ndarray
        (n, 2) as seen; (n, 2, 2) its derivatives by the place; (n, 2, 8) by the coefficients.
    """
    k1, k2, p1, p2 = coefficients[0], coefficients[1], coefficients[2], coefficients[3]
    k3, k4, k5, k6 = coefficients[4], coefficients[5], coefficients[6], coefficients[7]
    seen = np.empty(xy.shape)
    by_place = np.empty((xy.shape[0], 2, 2))
    by_coefficient = np.empty((xy.shape[0], 2, 8))
    for n in range(xy.shape[0]):
        x, y = xy[n, 0], xy[n, 1]
        xx, yy, xy2 = x * x, y * y, 2.0 * x * y
        r2 = xx + yy
        r4, r6 = r2 * r2, r2 * r2 * r2
        over = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) * over
        slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
        slope = (slope - radial * (k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6))) * over
        along_x, along_y = r2 + 2.0 * xx, r2 + 2.0 * yy
        seen[n, 0] = x * radial + p1 * xy2 + p2 * along_x
        seen[n, 1] = y * radial + p1 * along_y + p2 * xy2
        by_place[n, 0, 0] = radial + 2.0 * xx * slope + 2.0 * p1 * y + 6.0 * p2 * x
        by_place[n, 1, 1] = radial + 2.0 * yy * slope + 6.0 * p1 * y + 2.0 * p2 * x
        across = xy2 * slope + 2.0 * p1 * x + 2.0 * p2 * y
        by_place[n, 0, 1] = across
        by_place[n, 1, 0] = across
        for axis in range(2):
            place = xy[n, axis] * over
            by_coefficient[n, axis, 0] = place * r2
            by_coefficient[n, axis, 1] = place * r4
            by_coefficient[n, axis, 2] = along_y if axis else xy2
            by_coefficient[n, axis, 3] = xy2 if axis else along_x
            by_coefficient[n, axis, 4] = place * r6
            by_coefficient[n, axis, 5] = -place * r2 * radial
            by_coefficient[n, axis, 6] = -place * r4 * radial
            by_coefficient[n, axis, 7] = -place * r6 * radial
    return seen, by_place, by_coefficient
