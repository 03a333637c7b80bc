"""Triangulation by a pinhole camera with lens distortion and a plane of light for each stripe."""

from __future__ import annotations

import math

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.records.view import View
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.lens import lens_from, undistorted_place
from roemetry_pinhole.frames import belt_pose, camera_of, planes_in_belt_frame, view_of


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

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's own parameters, so that a redrawn one moves it."""
        return view_of(calibration.parameters, calibration.image_size)


_STEP_END = 3e-6
"""Over the focal length: Newton's next step would be some 1e-12, far below what a peak is known to."""


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
    lens = lens_from(camera, 4)
    bends, lost = False, 0
    for k in range(4, 12):
        bends = bends or camera[k] != 0.0
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
                x, y, xx, xy, yy, good = undistorted_place(bent_x, bent_y, x, y, lens, _STEP_END)
                determinant = xx * yy - xy * xy
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
