"""Triangulation by one coefficient a stripe (section 3.4, equations 3 and 4)."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry.view import View
from roemetry_paper.block_geometry import block_view, light_planes


class BlockLinear(Triangulator[StageOptions]):
    """H = Ω_i · D2: height is proportional to the displacement from the stripe's rest line.

    One scale (mm/px, at belt level) serves for X and Y everywhere: perspective, which makes higher things
    look larger, and lens distortion are left out. The origin is the belt point at the image's centre.
    """

    capabilities = Capabilities(height_tolerance_mm=1e-9)

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
        omega = calibration.parameters["omega_mm_per_px"]
        scale = float(calibration.parameters["mm_per_px"][0])
        rows, columns = calibration.image_size
        count = stripes.stripe_count
        row_px = np.broadcast_to(np.arange(rows, dtype=np.float64), (count, rows))
        xyz_mm = np.empty((count, rows, 3))
        xyz_mm[:, :, 0] = (stripes.x_px - (columns - 1) / 2.0) * scale
        xyz_mm[:, :, 1] = np.where(np.isnan(stripes.x_px), np.nan, ((rows - 1) / 2.0 - row_px) * scale)
        away_px = stripes.x_px - stripes.rest_px
        rest_px = _rest_px(calibration)
        if rest_px is not calibration.rest_px:
            off = rest_px - calibration.rest_px
            away_px = away_px - off[:, :1] - off[:, 1:2] * (row_px - (rows - 1) / 2.0)
        xyz_mm[:, :, 2] = omega[:, None] * away_px
        return Profiles(
            xyz_mm=xyz_mm,
            product=stripes.product,
            seen=stripes.seen,
            x_px=stripes.x_px,
            row_px=row_px,
            height_std_mm=np.abs(omega)[:, None] * stripes.x_std_px,
            stripe=np.arange(count),
            frame=np.zeros(count, np.int64),
            plane=light_planes(rest_px, omega, scale, (columns - 1) / 2.0),
        )

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's parameters; the camera's distance is the calibration's own."""
        known = calibration.view
        if known is None:
            return None
        return block_view(
            calibration.image_size,
            _rest_px(calibration),
            calibration.parameters["omega_mm_per_px"],
            float(calibration.parameters["mm_per_px"][0]),
            None if known.telecentric else float(known.camera_mm[2]),
        )


def _rest_px(calibration: Calibration) -> Floats:
    """Give the rest lines; those of a redrawn calibration are off by what was drawn."""
    error_px = calibration.parameters.get("rest_error_px")
    if error_px is None or not error_px.any():
        return calibration.rest_px
    found = calibration.rest_px.copy()
    found[:, : error_px.shape[1]] += error_px
    return found
