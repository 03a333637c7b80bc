"""What a scene file says of camera and projector; parts of `roemetry_simulate.scene_file`."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from roemetry.errors import MisfitError

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
