"""Lens distortion taken out of many places at once, by Newton's method."""

from __future__ import annotations

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel

_STEPS_MAX = 20
_STEP_END = 3e-8  # Newton's next step would be some 1e-15


@float_kernel
def straighten(places: Floats, coefficients: Floats, start: Floats) -> Floats:
    """Give places (n, 2) on the plane at distance 1 that the lens bends to the given ones.

    Parameters
    ----------
    places
        (n, 2) as seen.
    coefficients
        (8,) k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's model.
    start
        (n, 2) where the search begins.

    Returns
    -------
    ndarray, shape (n, 2)
        Where no place was found within twenty steps, the last one tried.
    """
    k1, k2, p1, p2 = coefficients[0], coefficients[1], coefficients[2], coefficients[3]
    k3, k4, k5, k6 = coefficients[4], coefficients[5], coefficients[6], coefficients[7]
    found = start.copy()
    for n in range(places.shape[0]):
        x, y = start[n, 0], start[n, 1]
        for _ in range(_STEPS_MAX):
            r2 = x * x + y * y
            below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
            radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
            slope = 2.0 * k1 + r2 * (4.0 * k2 + 6.0 * r2 * k3)
            slope = (slope - radial * (2.0 * k4 + r2 * (4.0 * k5 + 6.0 * r2 * k6))) / below
            xy = slope * x * y + 2.0 * (p1 * x + p2 * y)
            xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
            wrong_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - places[n, 0]
            wrong_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - places[n, 1]
            determinant = xx * yy - xy * xy
            step_x = (yy * wrong_x - xy * wrong_y) / determinant
            step_y = (xx * wrong_y - xy * wrong_x) / determinant
            x -= step_x
            y -= step_y
            if not abs(step_x) + abs(step_y) > _STEP_END:
                break
        found[n, 0], found[n, 1] = x, y
    return found
