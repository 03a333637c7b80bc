"""What a scene file says to this simulator, and the camera and projector that it describes, in float64.

The parts of a scene are the core's (`roemetry.config.scene_parts`), so one file serves both simulators; what
only this one knows (vignetting, pixel gains, lamp size, conductors) has defaults that leave an ordinary
industrial camera. The camera is a pinhole with OpenCV's distortion, the projector a fan of planes n·X = d
through one point. Lengths are in mm of the belt frame, angles in degrees. Of `surface.below`, `share` is
that of the diffuse light that was scattered inside, `depth_mm` the transport mean free path and `blur_mm`
the deviation of a thin line's image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from roemetry.config.scene_parts import (
    BeltPart,
    CameraPart,
    LaserPart,
    LightPart,
    ProductPart,
    Share,
    StrayPart,
    SurfacePart,
    TargetsPart,
)
from roemetry.errors import MisfitError
from roemetry.records.view import distort, undistort
from roemetry.stages import StageOptions
from roemetry_mitsuba.products import MODELS

Floats = NDArray[np.float64]


class MitsubaCamera(CameraPart):
    """The camera: sensor, lens, pose, exposure; rays are spread over the aperture of a lens with a focus."""

    vignetting: float = Field(
        default=1.0, ge=0, le=5, description="v of 1/(1 + v·tan²)², tan of the field angle; 1 is cos⁴"
    )
    prnu: float = Field(
        default=0.005, ge=0, le=0.2, description="relative deviation of the pixels' gains, which stay"
    )


class MitsubaStray(StrayPart):
    """A lamp that is on in all images."""

    radius_mm: float = Field(default=15.0, ge=0, le=1000, description="radius of its disc, mm")


class MitsubaLight(LightPart):
    """All light but the laser's, and which images are taken."""

    stray: MitsubaStray | None = Field(default=None, description="a lamp that is always on; default: none")


class MitsubaSurface(SurfacePart):
    """What the product looks like."""

    gloss: Share = Field(
        default=0.10, description="0.1 and more: the full Fresnel reflection of a wet film; less: scaled"
    )
    gloss_exponent: float = Field(
        default=25.0, ge=1, le=10000, description="sharpness n of the gloss; GGX roughness √(2/(n + 2))"
    )
    metal: Literal["none", "Al", "Cr", "Cu", "Au", "Ag"] = Field(
        default="none", description="a rough conductor of this metal instead of food"
    )


class MitsubaProduct(ProductPart):
    """What lies on the belt: a family of products and its options; several lie in a row along Y."""

    family: str = Field(default="lofted-skein", description="name of a family of products, or `none`")

    @model_validator(mode="after")
    def _is_known(self) -> MitsubaProduct:
        self.check_families(MODELS)
        return self


class MitsubaOptions(StageOptions):
    """A scene: the rig, the belt, the light, the product. The defaults are the herring roe rig."""

    camera: MitsubaCamera = Field(default_factory=MitsubaCamera, description="the camera")
    laser: LaserPart = Field(default_factory=LaserPart, description="the projector")
    belt: BeltPart = Field(default_factory=BeltPart, description="the belt")
    light: MitsubaLight = Field(default_factory=MitsubaLight, description="all other light")
    product: MitsubaProduct = Field(default_factory=MitsubaProduct, description="what lies on the belt")
    surface: MitsubaSurface = Field(default_factory=MitsubaSurface, description="what the product looks like")
    targets: TargetsPart = Field(default_factory=TargetsPart, description="what is seen for calibration")
    turn_deg: Literal[0, 90, 180, 270] = Field(
        default=0, description="counter-clockwise turn that rights the images, which are stored turned back"
    )
    samples: int = Field(default=4, ge=2, le=16, description="camera rays along each side of a pixel")
    bounce_rays: int = Field(
        default=64, ge=0, le=4096, description="rays per node of the indirect light; 0 leaves it out"
    )

    @model_validator(mode="after")
    def _can_be_seen(self) -> MitsubaOptions:
        check_rig(self.camera, self.laser)
        return self


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with distortion k1, k2, p1, p2, k3; rotation "to belt from camera", lengths in mm."""

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
        places = distort((seen[..., :2] / seen[..., 2:]).reshape(-1, 2), self.distortion)
        pixels: Floats = self.focal_px * places.reshape(*seen.shape[:-1], 2) + self.principal_px
        return pixels

    def directions(self, x_px: Floats, y_px: Floats) -> Floats:
        """Give directions in the belt frame, shape (..., 3), camera z component 1, of pixels."""
        x, y = self.undistort(x_px, y_px)
        turned: Floats = np.stack([x, y, np.ones_like(x)], axis=-1) @ self.rotation.T
        return turned

    def undistort(self, x_px: Floats, y_px: Floats) -> tuple[Floats, Floats]:
        """Give places on the plane at distance 1, without distortion, of pixels."""
        pixels = np.stack(np.broadcast_arrays(x_px, y_px), axis=-1)
        places = (pixels.reshape(-1, 2) - self.principal_px) / self.focal_px
        found = undistort(places, self.distortion)
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
        # distortion bends the border: its middle counts
        y = sorted([float(np.median(top[:, 1])), float(np.median(bottom[:, 1]))])
        return float(left[:, 0].max()), float(right[:, 0].min()), y[0], y[1]


@dataclass(frozen=True, eq=False)
class Fan:
    """The projector's planes n·X = d (n_x > 0) from one point, ordered along belt X, with one shared axis.

    `peak_grey` is the light of each on white that faces the projector, grey levels; it falls off as a
    Gaussian across (`sigma_mm` at the waist's distance, growing by the divergence) and over the angle along
    the line.
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
    runs: tuple[float, float] = (-1.0, 1.0)
    """Cosines of a beam's angle with the axis between which there is light."""

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
        # looking down: the camera's y and z are turned against the belt's
        rotation = np.diag([1.0, -1.0, -1.0]) @ about_x @ about_y
        centre = -part.distance_mm * rotation[:, 2]
    lens = part.distortion
    # pixels' middles are whole numbers
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
    lines_x_mm = part.lines_x_mm
    yaw, pitch = math.radians(part.yaw_deg), math.radians(part.pitch_deg)
    axis = np.array([-math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)])
    origin = np.array(part.projector_mm, dtype=np.float64)
    towards = np.stack([lines_x_mm, 0 * lines_x_mm, 0 * lines_x_mm], axis=-1) - origin
    # each plane holds the axis and its place on the belt
    normals = np.cross(towards, axis)
    normals *= np.sign(normals[:, :1]) / np.linalg.norm(normals, axis=1, keepdims=True)
    power = np.ones(part.count) if part.power is None else np.array(part.power, dtype=np.float64)
    # the 1/e² width is four deviations, half of it two
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
    # a lens that folds has no inverse: the way there and back differs
    back = camera.project(camera.centre_mm + 100.0 * rays)
    if not np.abs(back - np.stack([x, y], axis=-1)).max() < 1e-6:
        raise MisfitError((("camera", "distortion"), "it folds the image over within the view"))
    if (rays[..., 2] >= -1e-3).any():
        raise MisfitError((("camera",), "a part of the image does not see the belt: it is tilted too far"))
    sides = camera.border_on(0.0) @ fan.normals.T - fan.offsets_mm
    lit = fan.peak_grey > 0.0
    if not ((sides.min(axis=0) < 0.0) & (sides.max(axis=0) > 0.0) & lit).any():
        crossing_x, view = fan.x_mm(0.0, 0.0)[lit], camera.view_on(0.0)
        why = (
            f"the laser misses the view: its planes meet the belt at X = {crossing_x.min():.1f} to "
            f"{crossing_x.max():.1f} mm, the camera sees X = {view[0]:.1f} to {view[1]:.1f} mm"
        )
        raise MisfitError((("laser", "centre_x_mm" if laser_part.belt_x_mm is None else "belt_x_mm"), why))
