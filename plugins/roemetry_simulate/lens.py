"""The lens: distortion in OpenCV's model, its inverse to the last digit, and the rays that pixels see."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel

Floats = NDArray[np.float64]


def undistorted(lens: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Take the distortion out of normalised image points.

    Parameters
    ----------
    lens : ndarray, shape (5,)
        k1, k2, p1, p2, k3 as OpenCV defines them.
    x, y : ndarray
        Distorted points, (pixel − principal point) / focal length; one shape.

    Returns
    -------
    x, y : ndarray
        Undistorted points, of the same shape.
    """
    flat_x, flat_y = np.ravel(x).astype(np.float64), np.ravel(y).astype(np.float64)
    _undistort_all(lens, flat_x, flat_y)
    return flat_x.reshape(np.shape(x)), flat_y.reshape(np.shape(y))


@kernel
def undistort(lens: Floats, first: int, x_bent: float, y_bent: float) -> tuple[float, float]:
    """Undistort one point by Newton's method; the five coefficients stand at `first` of `lens`."""
    k1, k2, p1, p2, k3 = lens[first], lens[first + 1], lens[first + 2], lens[first + 3], lens[first + 4]
    x, y = x_bent, y_bent
    for _ in range(30):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
        off_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - x_bent
        off_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - y_bent
        xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
        xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
        determinant = xx * yy - xy * xy
        step_x = (yy * off_x - xy * off_y) / determinant
        step_y = (xx * off_y - xy * off_x) / determinant
        x -= step_x
        y -= step_y
        if abs(step_x) + abs(step_y) < 1e-15:
            break
    return x, y


@kernel
def camera_ray(pinhole: Floats, rotation: Floats, x_px: float, y_px: float, d: Floats) -> None:
    """Write the unit direction, belt frame, of the ray through an image point."""
    cx = (x_px - pinhole[3]) / pinhole[5]
    cy = (y_px - pinhole[4]) / pinhole[5]
    if pinhole[6] != 0.0:
        cx, cy = undistort(pinhole, 7, cx, cy)
    length = math.sqrt(cx * cx + cy * cy + 1.0)
    for k in range(3):
        d[k] = (rotation[k, 0] * cx + rotation[k, 1] * cy + rotation[k, 2]) / length


@kernel
def _undistort_all(lens: Floats, x: Floats, y: Floats) -> None:
    for k in range(x.size):
        x[k], y[k] = undistort(lens, 0, x[k], y[k])
