"""The lens's distortion, compiled: OpenCV's rational model in one place for all kernels.

Model (Brown 1966; OpenCV's rational form). On the plane at distance 1, with r² = x² + y²,

    x′ = x R + 2 p1 x y + p2 (r² + 2 x²)        R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    y′ = y R + p1 (r² + 2 y²) + 2 p2 x y

with coefficients in OpenCV's order k1, k2, p1, p2, k3, k4, k5, k6. The inverse is by Newton's method. It has
none where a strong distortion folds the image over: there the Jacobian's determinant or trace is not
positive, which callers check. `roemetry.records.view` is the same in numpy, with the thin prism and
tilt of all fourteen coefficients; tests hold one against the other.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Outline
from roemetry.records.view import View
from roemetry_kernels.compiling import float_kernel, inlined

Floats = NDArray[np.float64]

_STEPS_MAX = 30
"""Newton converges in two to six steps within a usable image; more is beyond the fold."""
_STEP_END = 3e-8
"""Relative to the focal length: Newton squares its error, so that the next step would be some 1e-15."""


Lens = tuple[float, float, float, float, float, float, float, float]
"""Eight numbers stay in registers, where each element of an array is read again after every write."""


@inlined
def lens_from(numbers: Floats, first: int) -> Lens:
    """Give the eight coefficients that stand at `first` of an array."""
    return (
        numbers[first],
        numbers[first + 1],
        numbers[first + 2],
        numbers[first + 3],
        numbers[first + 4],
        numbers[first + 5],
        numbers[first + 6],
        numbers[first + 7],
    )


@inlined
def distorted_place(x: float, y: float, lens: Lens) -> tuple[float, float, float, float, float]:
    """Give x′, y′ and ∂x′/∂x, ∂x′/∂y = ∂y′/∂x, ∂y′/∂y of one place."""
    k1, k2, p1, p2, k3, k4, k5, k6 = lens
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    # dR/dx = slope · x, and for y alike
    slope = 2.0 * k1 + r2 * (4.0 * k2 + 6.0 * r2 * k3)
    # most lenses have no denominator
    if k4 != 0.0 or k5 != 0.0 or k6 != 0.0:
        below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial /= below
        slope = (slope - radial * (2.0 * k4 + r2 * (4.0 * k5 + 6.0 * r2 * k6))) / below
    bent_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    bent_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    xy = slope * x * y + 2.0 * (p1 * x + p2 * y)
    yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return bent_x, bent_y, xx, xy, yy


@inlined
def undistorted_place(
    bent_x: float, bent_y: float, x: float, y: float, lens: Lens, end: float
) -> tuple[float, float, float, float, float, bool]:
    """Give the place that the lens moves to (bent_x, bent_y), sought from (x, y), by Newton's method.

    With it ∂x′/∂x, ∂x′/∂y, ∂y′/∂y one step before, and whether a step came below `end`.
    """
    xx, xy, yy, good = 1.0, 0.0, 1.0, False
    for _ in range(_STEPS_MAX):
        at_x, at_y, xx, xy, yy = distorted_place(x, y, lens)
        # the Jacobian is symmetric; its inverse times what is left
        determinant = xx * yy - xy * xy
        step_x = (yy * (at_x - bent_x) - xy * (at_y - bent_y)) / determinant
        step_y = (xx * (at_y - bent_y) - xy * (at_x - bent_x)) / determinant
        x -= step_x
        y -= step_y
        if abs(step_x) + abs(step_y) < end:
            good = True
            break
    return x, y, xx, xy, yy, good


@lru_cache(maxsize=8)
def sight_lines(view: View, outline: Outline) -> tuple[Floats, Floats]:
    """Give the lines of sight through an outline's points, as `View.rays` does: several stages ask."""
    camera = camera_of(view)
    if not camera.size:
        return view.rays(outline.xy_px)
    start: Floats
    start, way = rays_through(outline.xy_px.copy(), camera, view.T_belt_camera)
    return start, way


def camera_of(view: View) -> Floats:
    """Give (12,) fx, fy, cx, cy and the lens's coefficients; empty where it is telecentric or has more."""
    matrix, lens = view.camera_matrix, view.distortion
    if view.telecentric or lens.size > 8:
        return np.empty(0)
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens, *[0.0] * (8 - lens.size)])


@float_kernel
def rays_through(xy_px: Floats, camera: Floats, pose: Floats) -> tuple[Floats, Floats]:
    """Give what `View.rays` does, of (n, 2) places, a camera as of `camera_of` and its pose on the belt."""
    start, way = np.empty((xy_px.shape[0], 3)), np.empty((xy_px.shape[0], 3))
    lens = lens_from(camera, 4)
    for k in range(xy_px.shape[0]):
        bent_x, bent_y = (xy_px[k, 0] - camera[2]) / camera[0], (xy_px[k, 1] - camera[3]) / camera[1]
        x, y, xx, xy, yy, good = undistorted_place(bent_x, bent_y, bent_x, bent_y, lens, _STEP_END)
        # where the lens folds the image there is no line of sight
        if not (good and xx * yy - xy * xy > 0.0 and xx + yy > 0.0):
            x, y = np.nan, np.nan
        length = math.sqrt(x * x + y * y + 1.0)
        for n in range(3):
            way[k, n] = (pose[n, 0] * x + pose[n, 1] * y + pose[n, 2]) / length
            start[k, n] = pose[n, 3] + 0.0 * way[k, n]  # NaN where there is none
    return start, way


@float_kernel
def distort_places(xy: Floats, coefficients: Floats) -> tuple[Floats, Floats, Floats]:
    """Distort places (n, 2) on the plane at distance 1 by (8,) coefficients.

    Returns
    -------
    tuple of ndarray
        (n, 2) as seen; (n, 2, 2) its derivatives by the place; (n, 2, 8) by the coefficients.
    """
    lens = lens_from(coefficients, 0)
    k1, k2, _, _, k3, k4, k5, k6 = lens
    seen = np.empty(xy.shape)
    by_place = np.empty((xy.shape[0], 2, 2))
    by_lens = np.empty((xy.shape[0], 2, 8))
    for n in range(xy.shape[0]):
        x, y = xy[n, 0], xy[n, 1]
        seen[n, 0], seen[n, 1], by_place[n, 0, 0], across, by_place[n, 1, 1] = distorted_place(x, y, lens)
        by_place[n, 0, 1] = across
        by_place[n, 1, 0] = across
        r2 = x * x + y * y
        r4, r6 = r2 * r2, r2 * r2 * r2
        over = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) * over
        for axis in range(2):
            place = xy[n, axis] * over
            by_lens[n, axis, 0] = place * r2
            by_lens[n, axis, 1] = place * r4
            by_lens[n, axis, 2] = r2 + 2.0 * y * y if axis else 2.0 * x * y
            by_lens[n, axis, 3] = 2.0 * x * y if axis else r2 + 2.0 * x * x
            by_lens[n, axis, 4] = place * r6
            by_lens[n, axis, 5] = -place * r2 * radial
            by_lens[n, axis, 6] = -place * r4 * radial
            by_lens[n, axis, 7] = -place * r6 * radial
    return seen, by_place, by_lens


@float_kernel
def undistort_places(distorted: Floats, coefficients: Floats, start: Floats) -> Floats:
    """Give (n, 2) places that the lens moves to the given ones, sought from `start`.

    Where no place was found, the last one tried.
    """
    found = np.empty(distorted.shape)
    lens = lens_from(coefficients, 0)
    for n in range(distorted.shape[0]):
        x, y, _, _, _, _ = undistorted_place(
            distorted[n, 0], distorted[n, 1], start[n, 0], start[n, 1], lens, _STEP_END
        )
        found[n, 0], found[n, 1] = x, y
    return found
