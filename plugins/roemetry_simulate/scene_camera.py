"""From a scene file's words to camera and projector; a camera or a laser that cannot be is refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.errors import MisfitError
from roemetry_simulate.camera import Camera, looking_down
from roemetry_simulate.laser import LaserFan, fan_through
from roemetry_simulate.scene_optics import CameraPart, LaserPart

Floats = NDArray[np.float64]

_EDGE_STEPS = 33


def camera_of(part: CameraPart) -> Camera:
    """Return the camera that a scene describes."""
    lens = part.distortion
    distortion = (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3)
    size = (part.width_px, part.height_px)
    pixel_size_mm = 1e-3 * part.pixel_size_um
    if part.T_belt_camera is not None:
        pose = np.array(part.T_belt_camera, dtype=np.float64)
    else:
        pose = looking_down(
            *size,
            pixel_size_mm=pixel_size_mm,
            focal_length_mm=part.focal_length_mm,
            distance_mm=part.distance_mm,
            tilt_x_deg=part.tilt_x_deg,
            tilt_y_deg=part.tilt_y_deg,
        ).T_belt_camera
    return Camera(*size, pixel_size_mm, part.focal_length_mm, pose, part.principal_point_px, distortion)


def laser_of(part: LaserPart, grey_per_e_per_ms: float) -> LaserFan:
    """Return the projector that a scene describes; the second number makes grey levels of its light."""
    power = np.ones(part.count) if part.power is None else np.array(part.power, dtype=np.float64)
    fan = fan_through(
        part.projector_mm,
        belt_x_mm(part),
        yaw_deg=part.yaw_deg,
        pitch_deg=part.pitch_deg,
        sigma_mm=0.25 * part.line_width_mm,
        peak_grey=part.peak_e_per_ms * grey_per_e_per_ms * power,
        line_sigma_deg=part.fall_deg,
    )
    return LaserFan(
        fan.projector_mm, fan.normals, fan.offsets_mm, fan.line_axis, fan.sigma_mm, fan.peak_grey,
        fan.line_sigma_deg, part.waist_distance_mm, 0.5 * part.divergence_mrad,
    )  # fmt: skip


def belt_x_mm(part: LaserPart) -> Floats:
    """Return where the planes meet the belt's X axis."""
    if part.belt_x_mm is not None:
        return np.array(part.belt_x_mm, dtype=np.float64)
    order = np.arange(part.planes) - 0.5 * (part.planes - 1)
    return np.array(part.centre_x_mm + part.spacing_mm * order, dtype=np.float64)


def view_mm(camera: Camera, height_mm: float = 0.0) -> tuple[float, float, float, float]:
    """Return smallest and largest X, smallest and largest Y of the view at a height, along its border."""
    points = _border_points(camera, height_mm)
    x, y = points[:, 0], points[:, 1]
    return float(x.min()), float(x.max()), float(y.min()), float(y.max())


def check_camera(part: CameraPart) -> None:
    """Raise MisfitError for a camera that does not see the belt, or whose distortion folds the image."""
    camera = camera_of(part)
    if part.focus is not None and part.focus.distance_mm <= part.focal_length_mm:
        why = f"is not beyond the focal length of {part.focal_length_mm:g} mm"
        raise MisfitError((("focus", "distance_mm"), why))
    x, y = _border_px(camera)
    if camera.distorts:
        _check_distortion(camera, x, y)
    rays = camera.ray(x, y)
    if (rays[:, 2] >= -1e-3).any():
        named = "T_belt_camera"
        if part.T_belt_camera is None:
            named = "tilt_x_deg" if abs(part.tilt_x_deg) > abs(part.tilt_y_deg) else "tilt_y_deg"
        why = "a part of the image does not see the belt: the camera is tilted too far"
        raise MisfitError(((named,), why))


def check_laser(camera_part: CameraPart, part: LaserPart) -> None:
    """Raise MisfitError for a laser none of whose planes lights a part of the belt that the camera sees."""
    camera = camera_of(camera_part)
    fan = laser_of(part, 1.0)
    lit = np.flatnonzero(fan.peak_grey > 0.0)
    sides = fan.distance_mm(_border_points(camera, 0.0))[:, lit]
    crossed = (sides.min(axis=0) < 0.0) & (sides.max(axis=0) > 0.0)
    if not crossed.any():
        x_min, x_max, _, _ = view_mm(camera)
        feet = fan.x_mm(0.0, 0.0)[lit]
        named = "centre_x_mm" if part.belt_x_mm is None else "belt_x_mm"
        why = (
            f"the laser misses the view: its planes meet the belt at X = {feet.min():.1f} to "
            f"{feet.max():.1f} mm, the camera sees X = {x_min:.1f} to {x_max:.1f} mm"
        )
        raise MisfitError(((named,), why))


def _border_px(camera: Camera) -> tuple[Floats, Floats]:
    along = np.linspace(0.0, 1.0, _EDGE_STEPS)
    x, y = along * camera.width_px - 0.5, along * camera.height_px - 0.5
    left, right = np.full_like(y, x[0]), np.full_like(y, x[-1])
    top, bottom = np.full_like(x, y[0]), np.full_like(x, y[-1])
    return np.concatenate([left, right, x, x]), np.concatenate([y, y, top, bottom])


def _border_points(camera: Camera, height_mm: float) -> Floats:
    """Where the rays of the image's border meet a level, shape (4 · steps, 3)."""
    rays = camera.ray(*_border_px(camera))
    reach = (height_mm - camera.centre_mm[2]) / rays[:, 2]
    points: Floats = camera.centre_mm + reach[:, None] * rays
    return points


def _check_distortion(camera: Camera, x: Floats, y: Floats) -> None:
    """Raise MisfitError where going out from the optical axis does not go out in the image all the way."""
    from roemetry_simulate.camera import undistorted

    f, (cx, cy) = camera.focal_length_px, camera.principal_px
    lens = np.array(camera.distortion)
    far_x, far_y = undistorted(lens, (x - cx) / f, (y - cy) / f)
    out = np.linspace(0.0, 1.0, 65)[:, None]
    k1, k2, _, _, k3 = camera.distortion
    r = np.hypot(far_x, far_y) * out
    image_r = r * (1.0 + r**2 * (k1 + r**2 * (k2 + r**2 * k3)))
    back = camera.project(camera.centre_mm + 100.0 * camera.ray(x, y))
    off = np.hypot(back[:, 0] - x, back[:, 1] - y)
    if not np.isfinite(r).all() or (np.diff(image_r, axis=0) <= 0.0).any() or not off.max() < 1e-6:
        why = "it folds the image over within the view; its coefficients are too large"
        raise MisfitError((("distortion",), why))
