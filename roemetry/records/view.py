"""The geometry of a calibrated rig: how the camera sees the belt, and where the planes of light stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from roemetry.records.arrays import Checker, Floats
from roemetry.records.camera_model import distorted, undistorted


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """Camera and planes of light in the belt frame; what coder and outline need of any calibration.

    Attributes
    ----------
    image_size
        Rows and columns of the (turned) image.
    camera_matrix
        (3, 3) fx, 0, cx; 0, fy, cy; 0, 0, 1 in px; of a telecentric camera fx and fy are px/mm.
    T_belt_camera
        (4, 4) to the belt frame from the camera's (z forward, x right, y down), mm.
    planes
        (stripe, 4) nx, ny, nz, d with n·X = d (mm) in the belt frame, n of length 1.
    distortion
        (k,) lens distortion in OpenCV's model and order: none, 4, 5, 8, 12 or 14 numbers.
    projector_mm
        (3,) where the light comes from, belt frame, mm; NaN where that is not known.
    telecentric
        True where all rays are parallel to the camera's z.
    exact
        False where it is an approximation made for coding and outlines, not for measuring.
    """

    image_size: tuple[int, int]
    camera_matrix: Floats
    T_belt_camera: Floats
    planes: Floats
    distortion: Floats = field(default_factory=lambda: np.empty(0))
    projector_mm: Floats = field(default_factory=lambda: np.full(3, np.nan))
    telecentric: bool = False
    exact: bool = True

    def __post_init__(self) -> None:
        check = Checker(self)
        matrix = check.array("camera_matrix", np.float64, (3, 3))
        pose = check.array("T_belt_camera", np.float64, (4, 4))
        planes = check.array("planes", np.float64, (None, 4))
        count = check.array("distortion", np.float64, (None,)).size
        check.array("projector_mm", np.float64, (3,))
        check.require(count in (0, 4, 5, 8, 12, 14), f"distortion has {count} numbers")
        check.require(not (self.telecentric and count), "a telecentric camera has no distortion model here")
        if matrix.shape == (3, 3):
            check.require(bool(matrix[0, 0] > 0 and matrix[1, 1] > 0), "focal lengths are not positive")
        if pose.shape == (4, 4):
            turn = pose[:3, :3]
            proper = np.abs(turn @ turn.T - np.eye(3)).max() < 1e-6 and np.linalg.det(turn) > 0
            check.require(bool(proper), "T_belt_camera is not a rotation with a shift")
        if planes.ndim == 2 and planes.shape[1] == 4 and planes.size:
            length = np.sqrt((planes[:, :3] ** 2).sum(axis=1))
            check.require(bool(np.abs(length - 1.0).max() < 1e-6), "plane normals are not of length 1")
        check.finish()

    @property
    def camera_mm(self) -> Floats:
        """Centre of projection in the belt frame, mm (of a telecentric camera: a point on its axis)."""
        return np.asarray(self.T_belt_camera[:3, 3])

    def rays(self, xy_px: Floats) -> tuple[Floats, Floats]:
        """Give the lines of sight.

        Parameters
        ----------
        xy_px
            (…, 2) places in the image, px.

        Returns
        -------
        origin_mm, direction
            (…, 3) a point of each ray, mm, and its direction (length 1), belt frame. NaN in, NaN out.
        """
        xy = np.asarray(xy_px, np.float64)
        turn, shift = self.T_belt_camera[:3, :3], self.T_belt_camera[:3, 3]
        flat = self._normalised(xy.reshape(-1, 2))
        if self.telecentric:
            start = np.column_stack([flat, np.zeros(len(flat))]) @ turn.T + shift
            way = np.broadcast_to(turn[:, 2], start.shape)
        else:
            way = np.column_stack([flat, np.ones(len(flat))]) @ turn.T
            way = way / np.sqrt((way**2).sum(axis=1))[:, None]
            start = np.where(np.isnan(way), np.nan, shift)
        shape = (*xy.shape[:-1], 3)
        return start.reshape(shape), way.reshape(shape)

    def project(self, xyz_mm: Floats) -> Floats:
        """Give (…, 2) where points (…, 3) of the belt frame appear, px; NaN behind the camera."""
        xyz = np.asarray(xyz_mm, np.float64)
        turn, shift = self.T_belt_camera[:3, :3], self.T_belt_camera[:3, 3]
        seen = (xyz.reshape(-1, 3) - shift) @ turn
        if self.telecentric:
            plane = seen[:, :2]
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                plane = np.where(seen[:, 2:] > 0, seen[:, :2] / seen[:, 2:], np.nan)
            plane = distorted(plane, self.distortion)
        focal = np.diag(self.camera_matrix)[:2]
        return np.asarray(plane * focal + self.camera_matrix[:2, 2]).reshape((*xyz.shape[:-1], 2))

    def lift(self, xy_px: Floats, stripe: Any) -> Floats:
        """Give (…, 3) where rays of (…, 2) image places meet planes of stripes (…), belt frame, mm."""
        start, way = self.rays(xy_px)
        plane = self.planes[np.asarray(stripe)]
        normal, distance = plane[..., :3], plane[..., 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (distance - (start * normal).sum(axis=-1)) / (way * normal).sum(axis=-1)
        return np.asarray(start + along[..., None] * way)

    def at_height(self, xy_px: Floats, z_mm: Any) -> Floats:
        """Give (…, 3) where the rays of (…, 2) image places are at a height, belt frame, mm."""
        start, way = self.rays(xy_px)
        along = (np.asarray(z_mm, np.float64) - start[..., 2]) / way[..., 2]
        return np.asarray(start + along[..., None] * way)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as they stand in a file."""
        return {
            "camera_matrix": self.camera_matrix.tolist(),
            "distortion": self.distortion.tolist(),
            "T_belt_camera": self.T_belt_camera.tolist(),
            "planes": self.planes.tolist(),
            "projector_mm": self.projector_mm.tolist() if np.isfinite(self.projector_mm).all() else None,
            "telecentric": self.telecentric,
            "exact": self.exact,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], image_size: tuple[int, int]) -> View:
        """Read what `to_dict` wrote; KeyError, TypeError, ValueError or DataError where it is damaged."""
        projector = data["projector_mm"]
        return cls(
            image_size=image_size,
            camera_matrix=np.array(data["camera_matrix"], np.float64),
            T_belt_camera=np.array(data["T_belt_camera"], np.float64),
            planes=np.array(data["planes"], np.float64),
            distortion=np.array(data["distortion"], np.float64),
            projector_mm=np.full(3, np.nan) if projector is None else np.array(projector, np.float64),
            telecentric=bool(data["telecentric"]),
            exact=bool(data["exact"]),
        )

    def _normalised(self, xy_px: Floats) -> Floats:
        """From pixels to the plane at distance 1 (telecentric: to mm), without the lens's distortion."""
        focal = np.diag(self.camera_matrix)[:2]
        seen = (xy_px - self.camera_matrix[:2, 2]) / focal
        return undistorted(seen, self.distortion)
