"""Both families of planes of a grid, and triangulation by them.

The lines across are seen in the image turned by 90° counter-clockwise, x' = y and y' = W − 1 − x for an image
W pixels wide: the camera's axes turn to X' = Y, Y' = −X, its focal lengths change places, the principal
point becomes (c_y, W − 1 − c_x), tangential distortion (p₁, p₂) becomes (−p₂, p₁), and a plane p·X = 1 of the
camera's frame (p_y, −p_x, p_z). So a calibration of the turned image says the same in other words, and each
peak's undistorted ray meets its own plane of light (Hartley and Zisserman 2004, chapter 6) in the one belt
frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Profiles, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.records.view import View
from roemetry.stages import Capabilities, StageOptions, Triangulator
from roemetry_pinhole.pinhole_plane import belt_pose, camera_of, lift_stripes, planes_in_belt_frame, view_of

METHOD = "pinhole-grid"
ACROSS = "across_planes_per_mm"
TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Takes the camera's frame to that of the turned image."""


def turned_parameters(parameters: Mapping[str, Floats], columns: int) -> dict[str, Floats]:
    """Give `pinhole-plane`'s parameters of the lines across, for the turned image, once `columns` px wide.

    In `parameters`, of the image as it is, `across_planes_per_mm` are the planes.
    """
    lens = parameters["distortion"].copy()
    lens[2:4] = -lens[3], lens[2]
    middle = parameters["principal_px"]
    return {
        "focal_px": parameters["focal_px"][::-1],
        "principal_px": np.array([middle[1], columns - 1.0 - middle[0]]),
        "distortion": lens,
        "planes_per_mm": parameters[ACROSS] @ TURN.T,
        "belt_per_mm": TURN @ parameters["belt_per_mm"],
    }


class PinholeGrid(Triangulator[StageOptions]):
    """Each peak's ray meets its line's plane of light, of either family."""

    capabilities = Capabilities(
        height_tolerance_mm=0.01, pattern="grid", fixture="roemetry_pinhole.conformance:grid_of"
    )

    def triangulate(self, stripes: StripeMap, calibration: Calibration) -> Profiles:
        """Give a slice for each stripe, then one for each line across, with a point for each row or column.

        Raises
        ------
        StageError
            There are no lines across, or the map has other numbers of lines or rows than the calibration.
        """
        across = stripes.across
        if across is None or ACROSS not in calibration.parameters:
            what = "the stripes have" if across is None else "the calibration has"
            raise StageError(f"{what} no lines across: pinhole-grid triangulates grids")
        parameters = calibration.parameters
        rows, columns = calibration.image_size
        found = stripes.x_px.shape, across.x_px.shape
        made = (len(parameters["planes_per_mm"]), rows), (len(parameters[ACROSS]), columns)
        if found != made:
            raise StageError(
                f"lines and rows are {found[0]}, across {found[1]}; of the calibration {made[0]}, {made[1]}"
            )
        pose = belt_pose(parameters["belt_per_mm"])
        other = turned_parameters(parameters, columns)
        lifted = [
            lift_stripes(
                stripes.x_px, stripes.x_std_px, camera_of(parameters), parameters["planes_per_mm"],
                pose[:3, :3], pose[:3, 3],
            ),
            lift_stripes(
                across.x_px, across.x_std_px, camera_of(other), other["planes_per_mm"],
                np.ascontiguousarray(pose[:3, :3] @ TURN.T), pose[:3, 3],
            ),
        ]  # fmt: skip
        longest = max(rows, columns)

        def joined(one: Any, two: Any, nothing: float) -> Any:
            padded = [
                np.pad(part, [(0, 0), (0, longest - part.shape[1])] + [(0, 0)] * (part.ndim - 2),
                       constant_values=nothing)
                for part in (one, two)
            ]  # fmt: skip
            return np.concatenate(padded)

        xyz_mm = joined(lifted[0][0], lifted[1][0], np.nan)
        known = np.isfinite(xyz_mm[..., 0])
        row = np.broadcast_to(np.arange(rows, dtype=np.float64), stripes.x_px.shape)
        x_px = np.broadcast_to(columns - 1.0 - np.arange(columns), across.x_px.shape)
        planes = np.concatenate([parameters["planes_per_mm"], parameters[ACROSS]])
        return Profiles(
            xyz_mm=xyz_mm,
            product=np.where(known, joined(stripes.product, across.product, -1), -1).astype(np.int16),
            seen=joined(stripes.seen, across.seen, False) & known,
            x_px=np.where(known, joined(stripes.x_px, x_px, np.nan), np.nan),
            row_px=np.where(known, joined(row, across.x_px, np.nan), np.nan),
            height_std_mm=joined(lifted[0][1], lifted[1][1], np.nan),
            stripe=np.arange(len(planes)),
            frame=np.zeros(len(planes), np.int64),
            plane=planes_in_belt_frame(planes, pose),
        )

    def view(self, calibration: Calibration) -> View | None:
        """Give the view of the calibration's own parameters, so that a redrawn one moves it."""
        return view_of(calibration.parameters, calibration.image_size)
