"""A pinhole camera with OpenCV's lens distortion: pixels to rays in the belt frame, points to pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roemetry.records.camera_model import distorted, undistorted
from roemetry_kernels.compiling import kernel
from roemetry_kernels.lens import lens_from, undistorted_place

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera whose lens may distort.

    Attributes
    ----------
    width_px, height_px : int
        Image size.
    pixel_size_mm : float
        Pitch of the square pixels on the sensor.
    focal_length_mm : float
        Distance from the pinhole to the sensor.
    T_belt_camera : ndarray, shape (4, 4)
        Pose "to belt from camera", millimetres. Camera axes: x right, y down, z forward.
    principal_point_px : tuple of float or None
        Where the optical axis meets the image; None is the image centre ((w - 1)/2, (h - 1)/2).
    distortion : tuple of float
        k1, k2, p1, p2, k3 of OpenCV's model; all zero is a perfect lens.
    """

    width_px: int
    height_px: int
    pixel_size_mm: float
    focal_length_mm: float
    T_belt_camera: Floats
    principal_point_px: tuple[float, float] | None = None
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if min(self.width_px, self.height_px) < 1 or min(self.pixel_size_mm, self.focal_length_mm) <= 0:
            raise ValueError("a camera needs a positive image size, pixel size and focal length")
        pose = np.array(self.T_belt_camera, dtype=np.float64)
        if pose.shape != (4, 4):
            raise ValueError(f"T_belt_camera must have shape (4, 4), not {pose.shape}")
        if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9):
            raise ValueError("T_belt_camera does not hold a rotation")
        pose.flags.writeable = False
        object.__setattr__(self, "T_belt_camera", pose)
        if self.principal_point_px is None:
            centre = ((self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0)
            object.__setattr__(self, "principal_point_px", centre)

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_length_mm / self.pixel_size_mm

    @property
    def centre_mm(self) -> Floats:
        """Pinhole in the belt frame, shape (3,), millimetres."""
        return self.T_belt_camera[:3, 3]

    @property
    def rotation(self) -> Floats:
        """Rotation "to belt from camera", shape (3, 3)."""
        return self.T_belt_camera[:3, :3]

    @property
    def principal_px(self) -> Floats:
        """Principal point, shape (2,), pixels."""
        return np.asarray(self.principal_point_px, dtype=np.float64)

    @property
    def distorts(self) -> bool:
        """Whether the lens distorts at all."""
        return any(value != 0.0 for value in self.distortion)

    def packed(self) -> Floats:
        """Return what the kernels take: pinhole, principal point, focal length (px), 1 or 0, lens (8,)."""
        flag = 1.0 if self.distorts else 0.0
        return np.array(
            [
                *self.centre_mm,
                *self.principal_px,
                self.focal_length_px,
                flag,
                *self.distortion,
                0.0,
                0.0,
                0.0,
            ],
            dtype=np.float64,
        )

    def ray(self, x_px: ArrayLike, y_px: ArrayLike) -> Floats:
        """Directions of the rays through pixels.

        Parameters
        ----------
        x_px, y_px : array_like
            Image points, pixels; they broadcast to a common shape S.

        Returns
        -------
        ndarray, shape S + (3,)
            Unit directions in the belt frame, away from the pinhole.
        """
        x, y = np.broadcast_arrays(np.asarray(x_px, dtype=np.float64), np.asarray(y_px, dtype=np.float64))
        cx, cy = self.principal_px
        x, y = (x - cx) / self.focal_length_px, (y - cy) / self.focal_length_px
        if self.distorts:
            places = undistorted(np.stack([x.ravel(), y.ravel()], axis=1), np.array(self.distortion))
            x, y = places[:, 0].reshape(x.shape), places[:, 1].reshape(y.shape)
        direction = np.stack([x, y, np.ones_like(x)], axis=-1)
        direction = direction @ self.rotation.T
        unit: Floats = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        return unit

    def project(self, points_mm: ArrayLike) -> Floats:
        """Image points of belt-frame points.

        Parameters
        ----------
        points_mm : array_like, shape (..., 3)
            Belt frame, millimetres.

        Returns
        -------
        ndarray, shape (..., 2)
            (x, y) in pixels; NaN for points behind the camera.
        """
        points = (np.asarray(points_mm, dtype=np.float64) - self.centre_mm) @ self.rotation
        depth = np.where(points[..., 2:] > 0.0, points[..., 2:], np.nan)
        plane = points[..., :2] / depth
        if self.distorts:
            plane = distorted(plane.reshape(-1, 2), np.array(self.distortion)).reshape(plane.shape)
        pixels: Floats = plane * self.focal_length_px + self.principal_px
        return pixels

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for a YAML file."""
        return {
            "width_px": self.width_px,
            "height_px": self.height_px,
            "pixel_size_mm": self.pixel_size_mm,
            "focal_length_mm": self.focal_length_mm,
            "principal_point_px": [float(v) for v in self.principal_px],
            "T_belt_camera": [[float(v) for v in row] for row in self.T_belt_camera],
            **({"distortion_k1_k2_p1_p2_k3": list(self.distortion)} if self.distorts else {}),
        }


def looking_down(
    width_px: int,
    height_px: int,
    *,
    pixel_size_mm: float,
    focal_length_mm: float,
    distance_mm: float,
    tilt_x_deg: float = 0.0,
    tilt_y_deg: float = 0.0,
) -> Camera:
    """Return a camera above the belt whose optical axis meets the belt at the origin.

    Parameters
    ----------
    width_px, height_px : int
        Image size.
    pixel_size_mm, focal_length_mm : float
        Sensor pitch and focal length.
    distance_mm : float
        From the pinhole to the belt along the optical axis.
    tilt_x_deg, tilt_y_deg : float
        Turn about the camera's own x axis, then about its own y axis. Zero looks straight down.

    Returns
    -------
    Camera
        With image x along belt X and image y against belt Y.
    """
    down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    ax, ay = np.deg2rad([tilt_x_deg, tilt_y_deg])
    about_x = np.array([[1, 0, 0], [0, np.cos(ax), -np.sin(ax)], [0, np.sin(ax), np.cos(ax)]])
    about_y = np.array([[np.cos(ay), 0, np.sin(ay)], [0, 1, 0], [-np.sin(ay), 0, np.cos(ay)]])
    rotation = down @ about_x @ about_y
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -distance_mm * rotation[:, 2]
    return Camera(width_px, height_px, pixel_size_mm, focal_length_mm, pose)


@kernel
def camera_ray(pinhole: Floats, rotation: Floats, x_px: float, y_px: float, d: Floats) -> None:
    """Write the unit direction, belt frame, of the ray through an image point."""
    cx = (x_px - pinhole[3]) / pinhole[5]
    cy = (y_px - pinhole[4]) / pinhole[5]
    if pinhole[6] != 0.0:
        cx, cy, _, _, _, _ = undistorted_place(cx, cy, cx, cy, lens_from(pinhole, 7), 1e-15)
    length = math.sqrt(cx * cx + cy * cy + 1.0)
    for k in range(3):
        d[k] = (rotation[k, 0] * cx + rotation[k, 1] * cy + rotation[k, 2]) / length
