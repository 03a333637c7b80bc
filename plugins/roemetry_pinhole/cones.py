"""Concentric cones of light: what a calibration of circles says of them, and triangulation by them.

All circles come from one point, round one axis: the point (three numbers), the axis (two) and a half
angle for each circle are all there is, in the camera's frame, where the axis points away from the camera.
A peak's undistorted ray meets its half of its cone where a quadratic says (`roemetry.records.cones`).
What is not in the model: circles that are not concentric, and light that does not come from one point;
calibration shows it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.cones import generators, touching_planes
from roemetry.records.view import View
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry_kernels import lens
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_pinhole.pinhole_plane import (
    belt_pose,
    camera_matrix,
    camera_of,
    check_size,
    flat,
    rotation_of,
)

METHOD = "pinhole-circles"
LIGHT, AXIS, ANGLES = "light_mm", "axis_slope", "half_angle_rad"
"""Parameters: (3,) where light comes from, mm, (2,) X and Y of the axis for each unit of Z, both in the
camera's frame; (circle,) half angles, rad, increasing."""
_STEP_PX = 0.01
"""Of the numerical derivative of the height by the place along the row."""
_STEP_END = 1e-8
"""Over the focal length: Newton's next step would be some 1e-15, which the derivative needs."""
_MOTION_STEPS = (1e-2, 1e-5, 1e-5, 1e-5)
"""Of shift (px), roll (rad), zoom and tilt (rad): all some 0.01 px."""
_REST_DEGREE = 4
"""Of the polynomials that readers of the file get; rest lines themselves come from the cones."""


def view_of(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> View:
    """Give camera and half circles in the belt frame."""
    camera, pose = camera_of(parameters), belt_pose(parameters["belt_per_mm"])
    axis = np.append(parameters[AXIS], 1.0)
    axis = pose[:3, :3] @ (axis / np.linalg.norm(axis))
    apex = pose[:3, :3] @ parameters[LIGHT] + pose[:3, 3]
    # left halves are negative, the largest circle first
    angle = np.concatenate([-parameters[ANGLES][::-1], parameters[ANGLES]])
    cones = np.column_stack([np.tile(np.concatenate([apex, axis]), (angle.size, 1)), angle])
    planes = touching_planes(cones, pose[:3, 0])
    return View(image_size, camera_matrix(camera), pose, planes, camera[4:], apex, cones=cones)


def derived(parameters: Mapping[str, Floats], image_size: tuple[int, int]) -> dict[str, Any]:
    """Give a calibration's parameters, and what it holds beside them and follows from them."""
    view = view_of(parameters, image_size)
    rows = np.arange(image_size[0], dtype=np.float64)
    half = 0.5 * (image_size[0] - 1)
    scale = half ** np.arange(_REST_DEGREE + 1)
    fitted = np.polynomial.polynomial.polyfit(
        (rows - half) / half, view.rest_of_cones_px(rows).T, _REST_DEGREE
    )
    middle = np.zeros(1)
    low, high = (
        np.array(
            [view.project(generators(cone, view.T_belt_camera[:3, 0], middle, z))[0] for cone in view.cones]
        )
        for z in (0.0, 1.0)
    )
    return {
        "parameters": dict(parameters),
        "rest_px": np.ascontiguousarray(fitted.T / scale),
        "displacement_px_per_mm": high[:, 0] - low[:, 0],
        "view": view,
    }


class PinholeCircles(Triangulator[StageOptions]):
    """Each peak's undistorted ray meets its half circle's cone of light."""

    capabilities = Capabilities(pattern="circles", fixture="roemetry_pinhole.conformance:circles_of")

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give a slice for each half circle, with a point for each row.

        Raises
        ------
        StageError
            The calibration has no cones, or is of another number of half circles or rows.
        """
        if LIGHT not in calibration.parameters:
            raise StageError(
                "the calibration has no cones: pinhole-circles triangulates circles",
                hint="calibrate with pinhole-circles",
            )
        check_size(stripes, calibration, "half circles")
        view = view_of(calibration.parameters, calibration.image_size)
        stripe, row = np.nonzero(np.isfinite(stripes.x_px))
        xy = np.column_stack([stripes.x_px[stripe, row], row])
        points, rise = lift_circles(xy, stripe, lens.camera_of(view), view.T_belt_camera, view.cones)
        shape = stripes.x_px.shape
        xyz_mm, height_std_mm = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
        xyz_mm[stripe, row] = points
        height_std_mm[stripe, row] = rise * stripes.x_std_px[stripe, row]
        known = np.isfinite(xyz_mm[..., 2])
        return Profiles(
            xyz_mm=xyz_mm,
            product=np.where(known, stripes.product, -1).astype(np.int16),
            seen=stripes.seen & known,
            x_px=np.where(known, stripes.x_px, np.nan),
            row_px=np.where(known, np.arange(shape[1], dtype=np.float64), np.nan),
            height_std_mm=height_std_mm,
            stripe=np.arange(shape[0]),
            frame=np.zeros(shape[0], np.int64),
            plane=view.planes,
        )

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Give the calibration of a camera turned and zoomed; the lens stays what it is.

        In the camera's frame belt, light and axis turn. The covariance of the motion is added, by the
        parameters' numerical derivatives.
        """
        before = calibration.parameters
        covariance = calibration.covariance
        if alignment.covariance.any():
            steps = np.diag(_MOTION_STEPS)
            moves = np.array([(flat(_turned(before, one)) - flat(before)) / one.sum() for one in steps])
            covariance = covariance + moves.T @ alignment.covariance @ moves
        made = derived(_turned(before, alignment.motion), calibration.image_size)
        return replace(calibration, covariance=covariance, **made)

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's own parameters, so that a redrawn one moves it."""
        return view_of(calibration.parameters, calibration.image_size)


def _turned(parameters: Mapping[str, Floats], motion: Floats) -> dict[str, Floats]:
    """Give the parameters of a camera that has moved; `motion` as in `Alignment`."""
    rotation = rotation_of(motion, parameters["focal_px"][0])
    axis = rotation @ np.append(parameters[AXIS], 1.0)
    return {
        **parameters,
        "focal_px": parameters["focal_px"] * (1.0 + motion[2]),
        "belt_per_mm": rotation @ parameters["belt_per_mm"],
        LIGHT: rotation @ parameters[LIGHT],
        # its Z is 1 again
        AXIS: axis[:2] / axis[2],
    }


@float_kernel
def lift_circles(
    xy_px: Floats, stripe: Integers, camera: Floats, pose: Floats, cones: Floats
) -> tuple[Floats, Floats]:
    """Give (n, 3) where rays of image places (n, 2) meet halves (n,) of cones, and how Z rises there, mm/px.

    That is what `View.lift` gives, and its derivative along the row; `camera` is as of `lens.camera_of`.
    """
    points, rise = np.empty((xy_px.shape[0], 3)), np.empty(xy_px.shape[0])
    around = lens.lens_from(camera, 4)
    for n in range(xy_px.shape[0]):
        cone, y = cones[stripe[n]], (xy_px[n, 1] - camera[3]) / camera[1]
        # a hundredth of a pixel beside, for the slope
        beside = _met((xy_px[n, 0] + _STEP_PX - camera[2]) / camera[0], y, around, pose, cone)
        points[n] = _met((xy_px[n, 0] - camera[2]) / camera[0], y, around, pose, cone)
        rise[n] = abs(beside[2] - points[n, 2]) / _STEP_PX
    return points, rise


@inlined
def _met(
    bent_x: float, bent_y: float, around: lens.Lens, pose: Floats, cone: Floats
) -> tuple[float, float, float]:
    """Give where a ray meets a half of a cone, as `roemetry.records.cones.meet_cones` does; NaN: nowhere."""
    x, y, xx, xy, yy, good = lens.undistorted_place(bent_x, bent_y, bent_x, bent_y, around, _STEP_END)
    if not (good and xx * yy - xy * xy > 0.0 and xx + yy > 0.0):
        return np.nan, np.nan, np.nan
    length = math.sqrt(x * x + y * y + 1.0)
    # along the axis: of the ray's way and of its start from the apex
    along_way, along, over, far, lean = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        way, away = (pose[k, 0] * x + pose[k, 1] * y + pose[k, 2]) / length, pose[k, 3] - cone[k]
        along_way += cone[3 + k] * way
        along += cone[3 + k] * away
        over += away * way
        far += away * away
        lean += cone[3 + k] * pose[k, 0]
    across_way, across = -lean * along_way, -lean * along
    for k in range(3):
        way, away = (pose[k, 0] * x + pose[k, 1] * y + pose[k, 2]) / length, pose[k, 3] - cone[k]
        across_way += pose[k, 0] * way
        across += pose[k, 0] * away
    # on the cone (a·X)² = cos² X·X: a t² + 2 b t + c = 0
    square = math.cos(cone[6]) ** 2
    a, b, c = along_way**2 - square, along_way * along - square * over, along**2 - square * far
    fall = (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]) / length
    best, height, root = np.nan, np.inf, math.sqrt(max(b * b - a * c, 0.0))
    # of both meetings: on the lit side, on this half, the nearer to the belt
    for t in ((-b + root) / a, (-b - root) / a):
        lit, mine = along + t * along_way > 0.0, cone[6] * (across + t * across_way) > 0.0
        if lit and mine and b * b >= a * c and abs(pose[2, 3] + t * fall) < height:
            best, height = t, abs(pose[2, 3] + t * fall)
    best /= length
    return (
        pose[0, 3] + best * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]),
        pose[1, 3] + best * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]),
        pose[2, 3] + best * (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]),
    )
