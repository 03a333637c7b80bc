"""Camera and projector in float64: pinhole with OpenCV's distortion, fan of planes through one point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import MisfitError
from roemetry.records.camera_model import distorted, undistorted
from roemetry_mitsuba.scene import CameraPart, LaserPart

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with distortion.

    Attributes
    ----------
    width_px, height_px
        Image size.
    focal_px
        Focal length, px.
    principal_px
        Principal point, px, shape (2,).
    distortion
        k1, k2, p1, p2, k3, shape (5,).
    rotation
        To belt from camera, shape (3, 3).
    centre_mm
        Pinhole, belt frame, shape (3,), mm.
    """

    width_px: int
    height_px: int
    focal_px: float
    principal_px: Floats
    distortion: Floats
    rotation: Floats
    centre_mm: Floats

    def project(self, points_mm: Floats) -> Floats:
        """Give the pixels, shape (..., 2), of belt points, shape (..., 3)."""
        seen = (points_mm - self.centre_mm) @ self.rotation
        places = distorted((seen[..., :2] / seen[..., 2:]).reshape(-1, 2), self.distortion)
        pixels: Floats = self.focal_px * places.reshape(*seen.shape[:-1], 2) + self.principal_px
        return pixels

    def directions(self, x_px: Floats, y_px: Floats) -> Floats:
        """Give directions in the belt frame, shape (..., 3), camera z component 1, of pixels."""
        x, y = self.undistorted(x_px, y_px)
        turned: Floats = np.stack([x, y, np.ones_like(x)], axis=-1) @ self.rotation.T
        return turned

    def undistorted(self, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Give places on the plane at distance 1, without distortion, of pixels."""
        pixels = np.stack(np.broadcast_arrays(x_px, y_px), axis=-1)
        places = (pixels.reshape(-1, 2) - self.principal_px) / self.focal_px
        found = undistorted(places, self.distortion)
        return found[:, 0].reshape(pixels.shape[:-1]), found[:, 1].reshape(pixels.shape[:-1])

    def border_on(self, height_mm: float) -> Floats:
        """Give where the rays of the image's border meet a level, shape (N, 3), mm."""
        along = np.linspace(0.0, 1.0, 17)
        x, y = along * self.width_px - 0.5, along * self.height_px - 0.5
        ends_x, ends_y = np.repeat(x[[0, -1]], 17), np.repeat(y[[0, -1]], 17)
        rays = self.directions(np.concatenate([ends_x, x, x]), np.concatenate([y, y, ends_y]))
        reach = (height_mm - self.centre_mm[2]) / rays[:, 2]
        points: Floats = self.centre_mm + reach[:, None] * rays
        return points

    def view_on(self, height_mm: float) -> tuple[float, float, float, float]:
        """Give x_min, x_max, y_min, y_max (mm) of the largest upright rectangle's bounds of the view."""
        at = self.border_on(height_mm)
        left, right, top, bottom = at[:17], at[17:34], at[34:51], at[51:]
        y = sorted([float(np.median(top[:, 1])), float(np.median(bottom[:, 1]))])
        return float(left[:, 0].max()), float(right[:, 0].min()), y[0], y[1]


@dataclass(frozen=True, eq=False)
class Fan:
    """The projector's planes n·X = d, ordered along belt X.

    Attributes
    ----------
    origin_mm
        The projector's point, shape (3,).
    normals, offsets_mm
        Unit n with n_x > 0, shape (N, 3), and d, shape (N,).
    axis
        Unit direction that all planes share, shape (3,).
    peak_grey
        Of each plane, on white that faces the projector, grey levels, shape (N,).
    sigma_mm, waist_mm, divergence_rad
        Gaussian width across at the waist, the waist's distance, growth of the width away from it.
    fall_rad
        Gaussian fall of the power over the angle along the line.
    """

    origin_mm: Floats
    normals: Floats
    offsets_mm: Floats
    axis: Floats
    peak_grey: Floats
    sigma_mm: float
    waist_mm: float
    divergence_rad: float
    fall_rad: float

    def x_mm(self, y_mm: float, z_mm: float) -> Floats:
        """Give X of each plane at a Y and Z."""
        rest = self.offsets_mm - y_mm * self.normals[:, 1] - z_mm * self.normals[:, 2]
        x: Floats = rest / self.normals[:, 0]
        return x


def camera_of(part: CameraPart) -> Camera:
    """Make the camera that a scene describes."""
    if part.T_belt_camera is not None:
        pose = np.array(part.T_belt_camera, dtype=np.float64)
        rotation, centre = pose[:3, :3], pose[:3, 3]
    else:
        a, b = math.radians(part.tilt_x_deg), math.radians(part.tilt_y_deg)
        about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
        about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
        rotation = np.diag([1.0, -1.0, -1.0]) @ about_x @ about_y
        centre = -part.distance_mm * rotation[:, 2]
    lens = part.distortion
    middle = part.principal_point_px or (0.5 * (part.width_px - 1), 0.5 * (part.height_px - 1))
    return Camera(
        part.width_px,
        part.height_px,
        1e3 * part.focal_length_mm / part.pixel_size_um,
        np.array(middle, dtype=np.float64),
        np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]),
        rotation,
        centre,
    )


def fan_of(part: LaserPart, grey_per_e_per_ms: float) -> Fan:
    """Make the fan that a scene describes; the second number turns its light into grey levels."""
    if part.belt_x_mm is not None:
        feet_x: Floats = np.array(part.belt_x_mm, dtype=np.float64)
    else:
        order = np.arange(part.planes, dtype=np.float64) - 0.5 * (part.planes - 1)
        feet_x = np.asarray(part.centre_x_mm + part.spacing_mm * order)
    yaw, pitch = math.radians(part.yaw_deg), math.radians(part.pitch_deg)
    axis = np.array([-math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)])
    origin = np.array(part.projector_mm, dtype=np.float64)
    towards = np.stack([feet_x, 0 * feet_x, 0 * feet_x], axis=-1) - origin
    normals = np.cross(towards, axis)
    normals *= np.sign(normals[:, :1]) / np.linalg.norm(normals, axis=1, keepdims=True)
    power = np.ones(part.count) if part.power is None else np.array(part.power, dtype=np.float64)
    return Fan(
        origin, normals, normals @ origin, axis, part.peak_e_per_ms * grey_per_e_per_ms * power,
        0.25 * part.line_width_mm, part.waist_distance_mm, 5e-4 * part.divergence_mrad,
        math.radians(part.fall_deg),
    )  # fmt: skip


def check_rig(camera_part: CameraPart, laser_part: LaserPart) -> None:
    """Raise MisfitError for a camera that does not see the belt, or a laser that misses the view."""
    camera, fan = camera_of(camera_part), fan_of(laser_part, 1.0)
    along = np.linspace(0.0, 1.0, 33)
    x, y = np.meshgrid(along * camera.width_px - 0.5, along * camera.height_px - 0.5)
    rays = camera.directions(x, y)
    back = camera.project(camera.centre_mm + 100.0 * rays)
    if not np.abs(back - np.stack([x, y], axis=-1)).max() < 1e-6:
        raise MisfitError((("camera", "distortion"), "it folds the image over within the view"))
    if (rays[..., 2] >= -1e-3).any():
        raise MisfitError((("camera",), "a part of the image does not see the belt: it is tilted too far"))
    sides = camera.border_on(0.0) @ fan.normals.T - fan.offsets_mm
    lit = fan.peak_grey > 0.0
    if not ((sides.min(axis=0) < 0.0) & (sides.max(axis=0) > 0.0) & lit).any():
        feet, view = fan.x_mm(0.0, 0.0)[lit], camera.view_on(0.0)
        why = (
            f"the laser misses the view: its planes meet the belt at X = {feet.min():.1f} to "
            f"{feet.max():.1f} mm, the camera sees X = {view[0]:.1f} to {view[1]:.1f} mm"
        )
        raise MisfitError((("laser", "centre_x_mm" if laser_part.belt_x_mm is None else "belt_x_mm"), why))
