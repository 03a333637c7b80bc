"""Where dots meet their rays, compiled: `roemetry.records.light.meet`, which tests hold against it.

It assumes a pinhole with up to eight numbers of a lens; others go to numpy. It gives NaN where the lens folds
the image, and behind the camera.
"""

from __future__ import annotations

import math

import numpy as np

from roemetry.records.arrays import Floats
from roemetry.records.light import ROUNDS, Met, meet
from roemetry.records.view import View
from roemetry_kernels import lens
from roemetry_kernels.compiling import float_kernel

_STEP_END = 1e-6
"""Over the focal length: where the search along a ray begins need not be known to more."""


def meet_rays(
    view: View, lines: Floats, xy_px: Floats, covariance_px2: Floats, ray_covariance: Floats
) -> Met:
    """Give where dots (n, 2) in the image meet rays (n, 4); see `roemetry.records.light.meet`."""
    camera = lens.camera_of(view)
    if not camera.size:
        return meet(view, lines, xy_px, covariance_px2, ray_covariance)
    found = _met(lines, xy_px, covariance_px2, ray_covariance, camera, view.T_belt_camera)
    return Met(found[0], found[1:3].T, found[3:5].T, found[5], found[6])


@float_kernel
def _met(
    lines: Floats, xy_px: Floats, covariance_px2: Floats, ray_covariance: Floats, camera: Floats, pose: Floats
) -> Floats:
    """Give (7, n) the fields of `Met`, one after the other."""
    found = np.empty((7, lines.shape[0]))
    around = lens.lens_from(camera, 4)
    by_x, by_y = np.empty(3), np.empty(3)
    for n in range(lines.shape[0]):
        line, own = lines[n], ray_covariance[n]
        noise_xx, noise_yy = covariance_px2[n, 0, 0], covariance_px2[n, 1, 1]
        noise_xy = 0.5 * (covariance_px2[n, 0, 1] + covariance_px2[n, 1, 0])
        unknown = math.isnan(noise_xx + noise_yy + noise_xy)
        if unknown:
            # where nothing is stated only the place is of use
            noise_xx, noise_xy, noise_yy = 1.0, 0.0, 1.0
        # the height at which the ray passes nearest to the line of sight
        distorted_x, distorted_y = (
            (xy_px[n, 0] - camera[2]) / camera[0],
            (xy_px[n, 1] - camera[3]) / camera[1],
        )
        x, y, xx, xy, yy, good = lens.undistorted_place(
            distorted_x, distorted_y, distorted_x, distorted_y, around, _STEP_END
        )
        if not (good and xx * yy - xy * xy > 0.0 and xx + yy > 0.0):
            found[:, n] = np.nan
            continue
        along, near, far = 0.0, 0.0, 0.0
        square = x * x + y * y + 1.0
        for k in range(3):
            along += (line[2 + k] if k < 2 else 1.0) * (pose[k, 0] * x + pose[k, 1] * y + pose[k, 2])
        for k in range(3):
            ray = line[2 + k] if k < 2 else 1.0
            across = ray - along / square * (pose[k, 0] * x + pose[k, 1] * y + pose[k, 2])
            near += (pose[k, 3] - (line[k] if k < 2 else 0.0)) * across
            far += across * ray
        z = near / far
        slope_x = slope_y = off_x = off_y = step = strength = pull_x = pull_y = determinant = 0.0
        s_xx = s_xy = s_yy = 0.0
        for _ in range(ROUNDS):
            right, down, ahead = 0.0, 0.0, 0.0
            for k in range(3):
                away = (line[k] + line[2 + k] * z if k < 2 else z) - pose[k, 3]
                right += pose[k, 0] * away
                down += pose[k, 1] * away
                ahead += pose[k, 2] * away
            # behind the camera nothing is seen
            over = 1.0 / ahead if ahead > 0.0 else np.nan
            x, y = right * over, down * over
            at_x, at_y, xx, xy, yy = lens.distorted_place(x, y, around)
            # derivatives of the pixel by the point: pinhole, then lens
            for k in range(3):
                straight_x = (pose[k, 0] - x * pose[k, 2]) * over
                straight_y = (pose[k, 1] - y * pose[k, 2]) * over
                by_x[k] = camera[0] * (xx * straight_x + xy * straight_y)
                by_y[k] = camera[1] * (xy * straight_x + yy * straight_y)
            slope_x = by_x[0] * line[2] + by_x[1] * line[3] + by_x[2]
            slope_y = by_y[0] * line[2] + by_y[1] * line[3] + by_y[2]
            # what the ray's own error does to its dot: X moves with x₀ and Z·sₓ, Y alike
            own_x = own[0, 0] + z * (own[0, 2] + own[2, 0]) + z * z * own[2, 2]
            own_y = own[1, 1] + z * (own[1, 3] + own[3, 1]) + z * z * own[3, 3]
            own_both = own[0, 1] + own[1, 0] + z * (own[0, 3] + own[2, 1] + own[1, 2] + own[3, 0])
            own_both = 0.5 * (own_both + z * z * (own[2, 3] + own[3, 2]))
            a, b, c, d = by_x[0], by_x[1], by_y[0], by_y[1]
            s_xx = noise_xx + a * a * own_x + 2.0 * a * b * own_both + b * b * own_y
            s_xy = noise_xy + a * c * own_x + (a * d + b * c) * own_both + b * d * own_y
            s_yy = noise_yy + c * c * own_x + 2.0 * c * d * own_both + d * d * own_y
            determinant = s_xx * s_yy - s_xy * s_xy
            pull_x = (s_yy * slope_x - s_xy * slope_y) / determinant
            pull_y = (s_xx * slope_y - s_xy * slope_x) / determinant
            strength = pull_x * slope_x + pull_y * slope_y
            off_x = xy_px[n, 0] - (camera[0] * at_x + camera[2])
            off_y = xy_px[n, 1] - (camera[1] * at_y + camera[3])
            # Gauss and Newton's step in height, weighed by both covariances
            step = (pull_x * off_x + pull_y * off_y) / strength
            z += step
        # what the last step leaves
        off_x, off_y = off_x - slope_x * step, off_y - slope_y * step
        squared = (s_yy * off_x**2 - 2.0 * s_xy * off_x * off_y + s_xx * off_y**2) / determinant
        found[0, n], found[1, n], found[2, n] = z, slope_x, slope_y
        found[3, n], found[4, n] = pull_x / strength, pull_y / strength
        found[5, n] = np.nan if unknown else 1.0 / math.sqrt(strength)
        found[6, n] = math.sqrt(squared) if squared > 0.0 else 0.0 * squared  # NaN stays
    return found
