"""Camera and projector of a scene file: their parts, what they make, and whether they see the belt."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from roemetry.errors import MisfitError
from roemetry.records.camera_model import undistorted
from roemetry_simulate.camera import Camera, looking_down
from roemetry_simulate.laser import LaserFan, fan_through

Floats = NDArray[np.float64]

_EDGE_STEPS = 33
"""Points along each border of the image at which the view is looked at."""

Place = Annotated[float, Field(ge=-1e5, le=1e5)]
Point = tuple[Place, Place, Place]
Row = tuple[Place, Place, Place, Place]
Share = Annotated[float, Field(ge=0, le=1)]


class Part(BaseModel):
    """A part of the scene: unknown keys are faults."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class DistortionPart(Part):
    """Lens distortion in OpenCV's model, on (x, y) = (pixel − principal point) / focal length."""

    k1: float = Field(default=0.0, ge=-5, le=5, description="radial, second order")
    k2: float = Field(default=0.0, ge=-50, le=50, description="radial, fourth order")
    p1: float = Field(default=0.0, ge=-1, le=1, description="tangential")
    p2: float = Field(default=0.0, ge=-1, le=1, description="tangential")
    k3: float = Field(default=0.0, ge=-500, le=500, description="radial, sixth order")


class FocusPart(Part):
    """Where the lens is sharp; beside that distance the thin lens's blur grows."""

    distance_mm: float = Field(gt=0, le=1e5, description="distance in focus, along the optical axis, mm")
    f_number: float = Field(gt=0.5, le=64, description="focal length over the aperture's diameter")


class CameraPart(Part):
    """The camera: sensor, lens, pose, exposure."""

    width_px: int = Field(default=640, ge=8, le=8192, description="image width, px")
    height_px: int = Field(default=480, ge=8, le=8192, description="image height, px")
    pixel_size_um: float = Field(default=10.0, gt=0.3, le=100, description="pitch of the square pixels, µm")
    focal_length_mm: float = Field(default=16.0, gt=0.5, le=1000, description="pinhole to sensor, mm")
    principal_point_px: tuple[Place, Place] | None = Field(
        default=None, description="where the optical axis meets the image, px; default: the image's centre"
    )
    distance_mm: float = Field(
        default=320.0, gt=1, le=1e5, description="pinhole to belt along the optical axis, mm"
    )
    tilt_x_deg: float = Field(
        default=1.0, gt=-80, lt=80, description="turn about the camera's x axis, degrees"
    )
    tilt_y_deg: float = Field(
        default=-0.4, gt=-80, lt=80, description="turn about the camera's y axis, degrees"
    )
    T_belt_camera: tuple[Row, Row, Row, Row] | None = Field(
        default=None, description="full pose, to belt from camera, mm; takes the place of distance and tilts"
    )
    distortion: DistortionPart = Field(default_factory=DistortionPart, description="of the lens")
    focus: FocusPart | None = Field(default=None, description="where the lens is sharp; default: everywhere")
    blur_sigma_px: float = Field(
        default=0.5, ge=0, le=20, description="blur of the lens in focus, px (deviation)"
    )
    exposure_ms: float = Field(default=10.0, gt=0, le=1e4, description="exposure time, ms")
    gain_dn_per_e: float = Field(default=0.0255, gt=0, le=100, description="grey levels an electron makes")
    full_well_e: float | None = Field(
        default=None, gt=0, le=1e7, description="electrons a pixel holds; default: no end"
    )
    read_noise_e: float = Field(
        default=39.2156862745098, ge=0, le=1e4, description="noise without light, electrons"
    )
    black_level_dn: float = Field(default=4.0, ge=0, le=10000, description="grey level without light")
    bit_depth: int = Field(default=8, ge=8, le=16, description="bits of a grey level")

    @field_validator("T_belt_camera")
    @classmethod
    def _is_a_pose(cls, pose: Any) -> Any:
        if pose is None:
            return pose
        matrix = np.array(pose)
        turned = matrix[:3, :3] @ matrix[:3, :3].T
        if not np.allclose(turned, np.eye(3), atol=1e-6) or np.linalg.det(matrix[:3, :3]) < 0:
            raise ValueError("its 3 × 3 part is not a rotation")
        if matrix[2, 3] <= 0.0:
            raise ValueError("the camera is not above the belt (its Z is not positive)")
        return pose


class LaserPart(Part):
    """The projector: a fan of planes of light from one point."""

    projector_mm: Point = Field(default=(160.0, -4.0, 300.0), description="where the light comes from, mm")
    planes: int = Field(default=11, ge=1, le=200, description="number of planes")
    spacing_mm: float = Field(default=8.75, gt=0, le=1000, description="between the planes on the belt, mm")
    centre_x_mm: Place = Field(default=-3.0, description="X of the middle of the fan on the belt, mm")
    belt_x_mm: list[Place] | None = Field(
        default=None, min_length=1, max_length=200,
        description="X of each plane at Y = 0, Z = 0, mm; takes the place of planes, spacing and centre",
    )  # fmt: skip
    yaw_deg: float = Field(default=0.6, gt=-80, lt=80, description="turn of the lines from belt Y, degrees")
    pitch_deg: float = Field(default=0.3, gt=-45, lt=45, description="rise of the lines' direction, degrees")
    line_width_mm: float = Field(
        default=1.24, gt=0, le=100, description="1/e² width of a line at its waist, mm"
    )
    waist_distance_mm: float = Field(
        default=336.0, ge=0, le=1e5, description="where a line is thinnest, from the projector, mm"
    )
    divergence_mrad: float = Field(
        default=0.0, ge=0, le=500, description="growth of half the 1/e² width away from the waist, mrad"
    )
    peak_e_per_ms: float = Field(
        default=1450.980392156863, gt=0, le=1e9,
        description="light in a line's middle on white that faces the projector, electrons a pixel a ms",
    )  # fmt: skip
    power: list[Annotated[float, Field(ge=0, le=10)]] | None = Field(
        default=None,
        description="of each plane, relative to peak_e_per_ms; 0: a dead one; default: all 1",
    )
    fall_deg: float = Field(
        default=25.0,
        gt=0,
        le=1000,
        description="deviation of the power along the line over the angle, degrees",
    )
    wavelength_nm: float = Field(default=660.0, ge=200, le=2000, description="colour of the light, nm")
    speckle_contrast: float = Field(
        default=0.10, ge=0, le=1, description="deviation over mean of the speckle"
    )
    speckle_sigma_px: float | None = Field(
        default=0.7, ge=0, le=50,
        description="grain of the speckle, px (deviation); null: from wavelength, f-number and distance",
    )  # fmt: skip

    @model_validator(mode="after")
    def _fits(self) -> LaserPart:
        faults: list[tuple[tuple[str, ...], str]] = []
        if self.belt_x_mm is not None and np.any(np.diff(self.belt_x_mm) <= 0):
            faults.append((("belt_x_mm",), "must increase"))
        count = self.count
        if self.power is not None and len(self.power) != count:
            faults.append((("power",), f"has {len(self.power)} entries for {count} planes"))
        elif self.power is not None and not any(self.power):
            faults.append((("power",), "every plane is dead; at least one must be above 0"))
        if self.projector_mm[2] <= 0.0:
            faults.append((("projector_mm",), "the projector is not above the belt (Z is not positive)"))
        if faults:
            raise MisfitError(*faults)
        return self

    @property
    def count(self) -> int:
        """Number of planes."""
        return self.planes if self.belt_x_mm is None else len(self.belt_x_mm)


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
    f, (cx, cy) = camera.focal_length_px, camera.principal_px
    far_x, far_y = undistorted(np.stack([x - cx, y - cy], axis=1) / f, np.array(camera.distortion)).T
    out = np.linspace(0.0, 1.0, 65)[:, None]
    k1, k2, _, _, k3 = camera.distortion
    r = np.hypot(far_x, far_y) * out
    image_r = r * (1.0 + r**2 * (k1 + r**2 * (k2 + r**2 * k3)))
    back = camera.project(camera.centre_mm + 100.0 * camera.ray(x, y))
    off = np.hypot(back[:, 0] - x, back[:, 1] - y)
    if not np.isfinite(r).all() or (np.diff(image_r, axis=0) <= 0.0).any() or not off.max() < 1e-6:
        why = "it folds the image over within the view; its coefficients are too large"
        raise MisfitError((("distortion",), why))
