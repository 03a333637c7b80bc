"""Triangulation by a pinhole camera with lens distortion and a plane of light for each stripe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Alignment, Calibration
from roemetry.records.view import View
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry_kernels.compiling import float_kernel
from roemetry_pinhole.frames import (
    belt_pose,
    camera_of,
    displacements,
    planes_in_belt_frame,
    rest_polynomials,
    view_of,
)


class PinholePlane(Triangulator[StageOptions]):
    """Each peak's ray, undistorted, meets its stripe's plane of light; the point goes to the belt frame.

    `height_std_mm` is what the peak's own noise does to Z. What the calibration contributes is common to all
    points: it is in the calibration's covariance, and a redrawn calibration moves all points together.
    """

    capabilities = Capabilities(
        height_tolerance_mm=0.01, fixture="roemetry_pinhole.conformance:calibration_of"
    )

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give a slice for each stripe, with a point for each image row.

        Raises
        ------
        StageError
            The map has another number of stripes or of rows than the calibration.
        """
        if stripes.stripe_count != calibration.stripe_count:
            raise StageError(
                f"{stripes.stripe_count} stripes were coded, the calibration has {calibration.stripe_count}"
            )
        if stripes.rows != calibration.image_size[0]:
            raise StageError(
                f"the stripes have {stripes.rows} rows, the calibration's images {calibration.image_size[0]}"
            )
        parameters = calibration.parameters
        pose = belt_pose(parameters["belt_per_mm"])
        planes = parameters["planes_per_mm"]
        xyz_mm, height_std_mm, lost = lift_stripes(
            stripes.x_px, stripes.x_std_px, camera_of(parameters), planes, pose[:3, :3], pose[:3, 3]
        )
        count, rows = stripes.x_px.shape
        product, seen = stripes.product, stripes.seen
        if lost:
            known = ~np.isnan(xyz_mm[..., 0])
            product, seen = np.where(known, product, -1).astype(np.int16), seen & known
        return Profiles(
            xyz_mm=xyz_mm,
            product=product,
            seen=seen,
            x_px=stripes.x_px,
            row_px=np.broadcast_to(np.arange(rows, dtype=np.float64), (count, rows)),
            height_std_mm=height_std_mm,
            stripe=np.arange(count),
            frame=np.zeros(count, np.int64),
            plane=planes_in_belt_frame(planes, pose),
        )

    def moved(self, calibration: Calibration, alignment: Alignment) -> Calibration:
        """Give the calibration of a camera turned and zoomed; the lens stays what it is.

        In the camera's frame, points turn by R: planes p·X = 1 become R p. To the covariance is added that of
        the motion, by the parameters' numerical derivatives.
        """
        parameters = _turned(calibration.parameters, alignment.motion)
        covariance = calibration.covariance
        if alignment.covariance.any():
            derivatives = np.stack(
                [
                    (
                        _flat(_turned(calibration.parameters, step * np.eye(4)[k]))
                        - _flat(calibration.parameters)
                    )
                    / step
                    for k, step in enumerate(_MOTION_STEPS)
                ]
            )
            covariance = covariance + derivatives.T @ alignment.covariance @ derivatives
        size = calibration.image_size
        return replace(
            calibration,
            parameters=parameters,
            covariance=covariance,
            rest_px=rest_polynomials(parameters, size),
            displacement_px_per_mm=displacements(parameters, size),
            view=view_of(parameters, size),
        )

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's own parameters, so that a redrawn one moves it."""
        return view_of(calibration.parameters, calibration.image_size)


_MOTION_STEPS = (1e-2, 1e-5, 1e-5, 1e-5)
"""Steps of numerical derivatives for shift (px), roll (rad), zoom and tilt (rad): all some 0.01 px."""


def _turned(parameters: Mapping[str, Floats], motion: Floats) -> dict[str, Floats]:
    """Give the parameters of a camera that has moved; `motion` as in `Alignment`."""
    import cv2

    pan_px, roll, zoom, tilt = motion
    focal = parameters["focal_px"]
    rotation = np.asarray(cv2.Rodrigues(np.array([tilt, pan_px / focal[0], roll]))[0], np.float64)
    return {
        **parameters,
        "focal_px": focal * (1.0 + zoom),
        "planes_per_mm": parameters["planes_per_mm"] @ rotation.T,
        "belt_per_mm": rotation @ parameters["belt_per_mm"],
        **({"travel_mm_per_count": rotation @ parameters["travel_mm_per_count"]}
           if "travel_mm_per_count" in parameters else {}),
    }  # fmt: skip


def _flat(parameters: Mapping[str, Floats]) -> Floats:
    return np.concatenate([array.ravel() for array in parameters.values()])


_STEPS_MAX = 20
_STEP_END = 3e-6  # Newton's next step would be some 1e-12


@float_kernel
def lift_stripes(
    x_px: Floats, x_std_px: Floats, camera: Floats, planes: Floats, rotation: Floats, shift: Floats
) -> tuple[Floats, Floats, int]:
    """Give points in the belt frame and what the peaks' noise does to their heights.

    Parameters
    ----------
    x_px, x_std_px
        (stripe, row) peaks and their standard uncertainty, px; NaN where there is none.
    camera
        (12,) fx, fy, cx, cy, px; k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's model.
    planes
        (stripe, 3) p with p·X = 1 in the camera's frame, 1/mm.
    rotation, shift
        (3, 3) and (3,) to the belt frame from the camera's, mm.

    Returns
    -------
    tuple
        (stripe, row, 3) points, mm, and (stripe, row) standard uncertainty of Z, mm; NaN where there is none
        or the ray has no place in the straight image; and how many have none.
    """
    stripes, rows = x_px.shape
    points = np.full((stripes, rows, 3), np.nan)
    height_std = np.full((stripes, rows), np.nan)
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    k1, k2, p1, p2, k3 = camera[4], camera[5], camera[6], camera[7], camera[8]
    k4, k5, k6 = camera[9], camera[10], camera[11]
    bends, lost = False, 0
    for k in range(4, 12):
        bends = bends or camera[k] != 0.0
    rational = k4 != 0.0 or k5 != 0.0 or k6 != 0.0
    for s in range(stripes):
        off_x = off_y = gain_x = gain_y = 0.0  # straight − bent, and its change from row to row
        followed = 0
        for r in range(rows):
            seen = x_px[s, r]
            if math.isnan(seen):
                followed = 0
                continue
            bent_x, bent_y = (seen - cx) / fx, (r - cy) / fy
            x, y = bent_x, bent_y
            xx, xy, yy, determinant = 1.0, 0.0, 1.0, 1.0
            if bends:
                if followed > 0:
                    x, y = x + off_x, y + off_y
                    if followed > 1:
                        x, y = x + gain_x, y + gain_y
                good = False
                for _ in range(_STEPS_MAX):
                    r2 = x * x + y * y
                    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
                    slope = 2.0 * k1 + r2 * (4.0 * k2 + 6.0 * r2 * k3)
                    if rational:
                        below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
                        radial /= below
                        slope = (slope - radial * (2.0 * k4 + r2 * (4.0 * k5 + 6.0 * r2 * k6))) / below
                    xy = slope * x * y + 2.0 * (p1 * x + p2 * y)
                    xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
                    yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
                    wrong_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - bent_x
                    wrong_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - bent_y
                    determinant = xx * yy - xy * xy
                    step_x = (yy * wrong_x - xy * wrong_y) / determinant
                    step_y = (xx * wrong_y - xy * wrong_x) / determinant
                    x -= step_x
                    y -= step_y
                    if abs(step_x) + abs(step_y) < _STEP_END:
                        good = True
                        break
                if not (good and determinant > 0.0 and xx + yy > 0.0):
                    followed = 0
                    lost += 1
                    continue
                new_x, new_y = x - bent_x, y - bent_y
                gain_x, gain_y = new_x - off_x, new_y - off_y
                off_x, off_y = new_x, new_y
                followed += 1
            p, q, n = planes[s, 0], planes[s, 1], planes[s, 2]
            depth = 1.0 / (p * x + q * y + n)
            for k in range(3):
                points[s, r, k] = shift[k] + depth * (
                    rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]
                )
            # the peak moves along the row: (x, y) by the inverse slope of the lens, then along the plane
            move_x, move_y = yy / (determinant * fx), -xy / (determinant * fx)
            move_z = -(p * move_x + q * move_y) * depth
            rise = rotation[2, 0] * (move_x + x * move_z) + rotation[2, 1] * (move_y + y * move_z)
            height_std[s, r] = abs(depth * (rise + rotation[2, 2] * move_z)) * x_std_px[s, r]
    return points, height_std, lost
