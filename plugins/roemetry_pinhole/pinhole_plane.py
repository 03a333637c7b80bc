"""Triangulation by a pinhole camera with lens distortion and a plane of light for each stripe."""

from __future__ import annotations

import numpy as np

from roemetry.calibration import Calibration
from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry.view import View
from roemetry_pinhole.frames import belt_pose, camera_of, planes_in_belt_frame, view_of


class PinholePlane(Triangulator[StageOptions]):
    """Each peak's ray, straightened, meets its stripe's plane of light; the point goes to the belt frame.

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
        from roemetry_kernels.calibration.sight import lift_stripes

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
