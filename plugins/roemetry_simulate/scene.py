"""A scene file: its options, the rig they describe, and what lies on belt and product beside the product.

The parts of a scene are the core's (`roemetry.config.scene_parts`); here is what this simulator makes of
them. What cannot be (a camera that does not see the belt, a laser that misses the view) is refused in words.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from roemetry.config.scene_parts import (
    AlbedoMapPart,
    BeltPart,
    CameraPart,
    LaserPart,
    LightPart,
    Part,
    ProductPart,
    SurfacePart,
    TargetsPart,
)
from roemetry.errors import MisfitError
from roemetry.records.view import undistort
from roemetry.stages import StageOptions
from roemetry_simulate.optics import (
    Camera,
    Focus,
    LaserFan,
    border_points_mm,
    border_px,
    circles_through,
    fan_through,
    looking_down,
    rows_through,
    view_mm,
    with_across,
)
from roemetry_simulate.products import MODELS, Drawn
from roemetry_simulate.render import Rig, Sensor
from roemetry_simulate.surface import Picture, Surface, textured

Floats = NDArray[np.float64]


class RayCasterProduct(ProductPart):
    """What lies on the belt: a family of products and its options."""

    family: str = Field(default="herring-roe", description="name of a family of products, or `none`")

    @model_validator(mode="after")
    def _is_known(self) -> RayCasterProduct:
        self.check_families(MODELS)
        if self.items and self.in_frame > 1:
            raise MisfitError(
                (("in_frame",), "items that were chosen by seed lie alone: leave one of both out")
            )
        return self


class AcrossPart(Part):
    """Lines across the planes of light."""

    lines: int = Field(default=15, ge=1, le=200, description="how many")
    spacing_mm: float = Field(default=5.0, gt=0, le=1000, description="between them on the belt, mm")
    centre_y_mm: float = Field(
        default=0.0,
        ge=-1e5,
        le=1e5,
        description="place of the middle one along the planes' lines on the belt, from the origin, mm",
    )

    @property
    def lines_y_mm(self) -> Floats:
        """(line,) where they cross the run of the fan's lines through the belt's origin, mm from there.

        Where the fan is not turned about Z, that is their Y on the belt.
        """
        order = np.arange(self.lines) - 0.5 * (self.lines - 1)
        return np.asarray(self.centre_y_mm + self.spacing_mm * order, np.float64)


class CirclesPart(Part):
    """Circles round one axis, which meets the belt's X axis in the middle of the fan."""

    count: int = Field(default=12, ge=1, le=100, description="how many")
    spacing_mm: float = Field(
        default=8.0, gt=0, le=1000,
        description="from circle to circle across the axis at the belt, mm; the smallest has half of it as "
        "radius",
    )  # fmt: skip

    @property
    def radii_mm(self) -> Floats:
        """(circle,) across the axis at the belt, mm."""
        return np.asarray(self.spacing_mm * (np.arange(self.count) + 0.5), np.float64)


class RayCasterLaser(LaserPart):
    """The projector: lines, dots on them, a grid, or circles."""

    dots: AcrossPart | None = Field(
        default=None, description="light only where both kinds of line meet: dots; default: whole lines"
    )
    grid: AcrossPart | None = Field(
        default=None, description="light of both kinds of line: a grid, or of one and one a cross hair"
    )

    circles: CirclesPart | None = Field(default=None, description="circles instead of lines")
    colours: Literal[1, 2] = Field(
        default=1, description="2: planes are red and green in turn, and images are in colour"
    )
    colour_leak: float = Field(
        default=0.03, ge=0, lt=1, description="share of the other colour that a channel of the camera passes"
    )

    @model_validator(mode="after")
    def _is_one_pattern(self) -> RayCasterLaser:
        given = [name for name in ("dots", "grid", "circles") if getattr(self, name) is not None]
        if given and self.colours == 2:
            raise MisfitError((("colours",), "two colours are for lines"))
        if len(given) > 1:
            raise MisfitError(((given[-1],), f"{' or '.join(given)}: leave one of both out"))
        return self


class RayCasterOptions(StageOptions):
    """A scene: the rig, the belt, the light, the product. The defaults are the herring roe rig."""

    camera: CameraPart = Field(default_factory=CameraPart, description="the camera")
    laser: RayCasterLaser = Field(default_factory=RayCasterLaser, description="the projector")
    belt: BeltPart = Field(default_factory=BeltPart, description="the belt")
    light: LightPart = Field(default_factory=LightPart, description="all other light")
    product: RayCasterProduct = Field(default_factory=RayCasterProduct, description="what lies on the belt")
    surface: SurfacePart = Field(default_factory=SurfacePart, description="what the product looks like")
    targets: TargetsPart = Field(default_factory=TargetsPart, description="what is seen for calibration")
    turn_deg: Literal[0, 90, 180, 270] = Field(
        default=0, description="counter-clockwise turn that rights the images, which are stored turned back"
    )
    samples: int = Field(default=4, ge=4, le=16, description="samples along each side of a pixel")
    draft: bool = Field(
        default=False,
        description="a quick look, in a tenth of the time: a ray for four pixels, four for a pixel at edges",
    )

    @field_validator("camera")
    @classmethod
    def _sees_the_belt(cls, camera: CameraPart) -> CameraPart:
        check_camera(camera)
        return camera

    @field_validator("laser")
    @classmethod
    def _is_in_view(cls, laser: LaserPart, info: ValidationInfo) -> LaserPart:
        if "camera" in info.data:
            check_laser(info.data["camera"], laser)
        return laser


def rig_of(scene: RayCasterOptions) -> Rig:
    """Return the rig that a scene describes, its light in grey levels of the exposure and gain."""
    camera, laser, light = scene.camera, scene.laser, scene.light
    # grey levels of one electron a millisecond
    grey = camera.exposure_ms * camera.gain_dn_per_e
    focus = camera.focus
    return Rig(
        camera_of(camera),
        Sensor(
            grey_per_electron=camera.gain_dn_per_e,
            read_noise_grey=camera.read_noise_e * camera.gain_dn_per_e,
            black_level_grey=camera.black_level_dn,
            psf_sigma_px=camera.blur_sigma_px,
            speckle_contrast=laser.speckle_contrast,
            speckle_sigma_px=_grain_px(camera, laser),
            full_well_e=math.inf if camera.full_well_e is None else camera.full_well_e,
            bit_depth=camera.bit_depth,
        ),
        laser_of(laser, grey),
        ambient_grey=light.ambient_e_per_ms * grey,
        plain_grey=light.plain_e_per_ms * grey,
        lamp_height_mm=light.lamp_height_mm,
        lamp_radius_mm=light.lamp_radius_mm,
        stray_mm=None if light.stray is None else light.stray.position_mm,
        stray_grey=0.0 if light.stray is None else light.stray.e_per_ms * grey,
        focus=None if focus is None else Focus(focus.distance_mm, focus.f_number),
        colour_leak=laser.colour_leak if laser.colours == 2 else None,
    )


def surface_of(scene: RayCasterOptions, seed: int) -> Surface:
    """Return how bright belt and product are; the texture is drawn from the seed."""
    belt, product = scene.belt, scene.surface
    drawn = textured(
        seed,
        view_mm(camera_of(scene.camera)),
        laser_albedo=(belt.albedo_laser, product.albedo_laser),
        plain_albedo=(belt.albedo_plain, product.albedo_plain),
        belt_std=belt.texture,
        product_std=product.texture,
        gloss=(belt.gloss, product.gloss),
    )
    below = product.below
    return replace(
        drawn, gloss_exponent=product.gloss_exponent, below=(below.share, below.depth_mm, below.blur_mm)
    )


def _grain_px(camera: CameraPart, laser: LaserPart) -> float:
    """Deviation of the speckle's grain: as given, or of the diffraction pattern of the lens."""
    if laser.speckle_sigma_px is not None:
        return laser.speckle_sigma_px
    f_number = 8.0 if camera.focus is None else camera.focus.f_number
    away_mm = camera.distance_mm if camera.focus is None else camera.focus.distance_mm
    magnified = camera.focal_length_mm / max(away_mm - camera.focal_length_mm, 1.0)
    # grain of speckle: λ N (1 + magnification) wide on the sensor; a Gaussian's full width is 2.355
    # deviations
    grain_um = 1e-3 * laser.wavelength_nm * f_number * (1.0 + magnified)
    return grain_um / camera.pixel_size_um / 2.355


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
        part.lines_x_mm,
        yaw_deg=part.yaw_deg,
        pitch_deg=part.pitch_deg,
        # 4 deviations are a laser line's width; half of an opening angle is to one side
        sigma_mm=0.25 * part.line_width_mm,
        peak_grey=part.peak_e_per_ms * grey_per_e_per_ms * power,
        line_sigma_deg=part.fall_deg,
    )
    fan = replace(fan, waist_distance_mm=part.waist_distance_mm, divergence_mrad=0.5 * part.divergence_mrad)
    if not isinstance(part, RayCasterLaser):
        return fan
    if part.circles is not None:
        drawn = circles_through(
            part.projector_mm,
            (part.centre_x_mm, 0.0, 0.0),
            part.circles.radii_mm,
            (1.0, 0.0, 0.0),
            sigma_mm=fan.sigma_mm,
            peak_grey=part.peak_e_per_ms * grey_per_e_per_ms,
        )
        return replace(drawn, waist_distance_mm=fan.waist_distance_mm, divergence_mrad=fan.divergence_mrad)
    if part.grid is not None:
        return with_across(fan, part.grid.lines_y_mm)
    return fan if part.dots is None else replace(fan, rows=rows_through(fan, part.dots.lines_y_mm))


def check_camera(part: CameraPart) -> None:
    """Raise MisfitError for a camera that does not see the belt, or whose distortion folds the image."""
    camera = camera_of(part)
    if part.focus is not None and part.focus.distance_mm <= part.focal_length_mm:
        why = f"is not beyond the focal length of {part.focal_length_mm:g} mm"
        raise MisfitError((("focus", "distance_mm"), why))
    x, y = border_px(camera)
    if camera.distorts:
        _check_distortion(camera, x, y)
    rays = camera.ray(x, y)
    if (rays[:, 2] >= -1e-3).any():
        named = "T_belt_camera"
        # the tilt that turns it farther is named
        if part.T_belt_camera is None:
            named = "tilt_x_deg" if abs(part.tilt_x_deg) > abs(part.tilt_y_deg) else "tilt_y_deg"
        why = "a part of the image does not see the belt: the camera is tilted too far"
        raise MisfitError(((named,), why))


def check_laser(camera_part: CameraPart, part: LaserPart) -> None:
    """Raise MisfitError for a laser none of whose planes lights a part of the belt that the camera sees."""
    camera = camera_of(camera_part)
    fan = laser_of(part, 1.0)
    lit = np.flatnonzero(fan.peak_grey > 0.0)
    # signed distances along the view's border: a plane crosses the view where both signs are seen
    sides = fan.distance_mm(border_points_mm(camera, 0.0))[:, lit]
    crossed = (sides.min(axis=0) < 0.0) & (sides.max(axis=0) > 0.0)
    if not crossed.any():
        x_min, x_max, _, _ = view_mm(camera)
        crossing_x = fan.x_mm(0.0, 0.0)[lit]
        named = "centre_x_mm" if part.belt_x_mm is None else "belt_x_mm"
        why = (
            f"the laser misses the view: its planes meet the belt at X = {crossing_x.min():.1f} to "
            f"{crossing_x.max():.1f} mm, the camera sees X = {x_min:.1f} to {x_max:.1f} mm"
        )
        raise MisfitError(((named,), why))


def _check_distortion(camera: Camera, x: Floats, y: Floats) -> None:
    """Raise MisfitError where going out from the optical axis does not go out in the image all the way."""
    f, (cx, cy) = camera.focal_length_px, camera.principal_px
    far_x, far_y = undistort(np.stack([x - cx, y - cy], axis=1) / f, np.array(camera.distortion)).T
    out = np.linspace(0.0, 1.0, 65)[:, None]
    # radial distance in the image must rise with that in space, all the way to the border
    k1, k2, _, _, k3 = camera.distortion
    r = np.hypot(far_x, far_y) * out
    image_r = r * (1.0 + r**2 * (k1 + r**2 * (k2 + r**2 * k3)))
    # and the lens, undone and done again, must come back
    back = camera.project(camera.centre_mm + 100.0 * camera.ray(x, y))
    off = np.hypot(back[:, 0] - x, back[:, 1] - y)
    if not np.isfinite(r).all() or (np.diff(image_r, axis=0) <= 0.0).any() or not off.max() < 1e-6:
        why = "it folds the image over within the view; its coefficients are too large"
        raise MisfitError((("distortion",), why))


def contaminate(
    surface: Surface, scene: RayCasterOptions, rig: Rig, products: Sequence[Drawn], seed: int
) -> Surface:
    """Put the scene's dirt and patches on the belt, and wet places and picture on the products.

    Dirt lies anywhere in the view, wet places and picture over the footprints' extents; places and sizes
    are drawn from the seed. The surface comes back as it is where the scene names none.
    """
    dirt, wet, patches = scene.belt.dirt, scene.surface.wet, scene.belt.patches
    texture = surface.texture
    x, y = _nodes(surface)
    if dirt.count or patches:
        belt = texture[..., 0].copy()
        spots = _spots(np.random.default_rng([seed, 61]), dirt.count, dirt.diameter_mm, view_mm(rig.camera))
        belt *= 1.0 - (1.0 - dirt.albedo) * _covered(spots, x, y, surface.step_mm)
        for patch in patches:
            # distance outside the rectangle, negative inside
            away = np.maximum(
                np.maximum(patch.x_mm[0] - x, x - patch.x_mm[1])[None, :],
                np.maximum(patch.y_mm[0] - y, y - patch.y_mm[1])[:, None],
            )
            # share of a node's square that is covered
            share = np.clip(0.5 - away / surface.step_mm, 0.0, 1.0)
            belt = belt * (1.0 - share) + share * patch.albedo * texture[..., 0]
        texture = np.stack([belt, texture[..., 1]], axis=-1)
    if wet.count and products:
        rng = np.random.default_rng([seed, 67])
        spots = np.concatenate(
            [_spots(rng, wet.count, wet.diameter_mm, one.solid.footprint_extent_mm()) for one in products]
        )
        gloss = wet.gloss * _covered(spots, x, y, surface.step_mm)
        # layers 2 and 3: gloss of belt (none) and product
        texture = np.concatenate([texture, np.zeros_like(gloss)[..., None], gloss[..., None]], axis=-1)
    if texture is not surface.texture:
        surface = replace(surface, texture=np.ascontiguousarray(texture))
    if scene.surface.albedo_map is not None and products:
        # two nodes of the picture for each pixel of the image
        pitch_mm = 0.5 * rig.camera.centre_mm[2] / rig.camera.focal_length_px
        picture = project_albedo_map(scene.surface.albedo_map, products, pitch_mm, scene.laser.wavelength_nm)
        surface = replace(surface, picture=picture)
    return surface


def _nodes(surface: Surface) -> tuple[Floats, Floats]:
    rows, columns = surface.texture.shape[:2]
    x = surface.x0_mm + surface.step_mm * np.arange(columns, dtype=np.float64)
    y = surface.y0_mm + surface.step_mm * np.arange(rows, dtype=np.float64)
    return x, y


def _spots(
    rng: np.random.Generator, count: int, diameter_mm: tuple[float, float], ends: tuple[float, ...]
) -> Floats:
    """Draw x, y and radius of spots, shape (count, 3), uniformly within (x_min, x_max, y_min, y_max)."""
    x, y = rng.uniform(ends[0], ends[1], count), rng.uniform(ends[2], ends[3], count)
    return np.column_stack([x, y, 0.5 * rng.uniform(*diameter_mm, count)])


def _covered(spots: Floats, x: Floats, y: Floats, step_mm: float) -> Floats:
    """Share of each node's surroundings that spots cover, shape (len(y), len(x))."""
    covered = np.zeros((y.size, x.size))
    for at_x, at_y, radius in spots:
        columns = np.flatnonzero(np.abs(x - at_x) <= radius + step_mm)
        rows = np.flatnonzero(np.abs(y - at_y) <= radius + step_mm)
        if not (columns.size and rows.size):
            continue
        # rows and columns near the spot alone
        here = np.ix_(rows, columns)
        away = np.hypot(x[columns] - at_x, (y[rows] - at_y)[:, None]) - radius
        covered[here] = np.maximum(covered[here], np.clip(0.5 - away / step_mm, 0.0, 1.0))
    return covered


_LUMA = np.array([0.114, 0.587, 0.299])  # ITU-R BT.601, in the order blue, green, red
_BLUE_TO_NM, _GREEN_TO_NM = 500.0, 590.0  # where the filters of a colour camera take turns
_EXTENT_STEP_MM = 0.25  # at which a footprint's extent along its own axes is looked for


def project_albedo_map(
    part: AlbedoMapPart, products: Sequence[Drawn], pitch_mm: float, wavelength_nm: float
) -> Picture:
    """Lay the picture on every product: its factors under the laser and in plain light, 1 beside.

    The picture's left edge lies at the smallest, its right edge at the largest place of the footprint along
    the product's own x axis (belt X turned by the product's yaw), its bottom and top edges likewise along
    its own y axis. The laser sees the picture's blue, green or red, whichever is its own.
    """
    grey = part.factors()
    ends = np.array([one.solid.footprint_extent_mm() for one in products])
    x = np.arange(ends[:, 0].min() - 1.0, ends[:, 1].max() + 1.0, pitch_mm)
    y = np.arange(ends[:, 2].min() - 1.0, ends[:, 3].max() + 1.0, pitch_mm)
    xx, yy = np.meshgrid(x, y)
    laser, plain = np.ones(xx.shape), np.ones(xx.shape)
    # beside the footprints first, so that no product's surroundings lie on its neighbour
    tops = [one.solid.heights_mm(xx, yy)[0] for one in products]
    # beside first, then on: a product's own picture is never overwritten by a neighbour's
    for on_it in (False, True):
        for one, top in zip(products, tops, strict=True):
            at_x, at_y = _in_picture(one, xx, yy)
            inside = np.isfinite(top) if on_it else (np.abs(at_x - 0.5) < 0.6) & (np.abs(at_y - 0.5) < 0.6)
            for layer, channel in ((laser, _laser_channel(grey, wavelength_nm)), (plain, _plain(grey))):
                layer[inside] = _interpolated(channel, at_x[inside], at_y[inside])
    matrix = np.zeros((2, 4))
    # (x, y, z, 1) to column and row
    matrix[0, 0], matrix[1, 1] = 1.0 / pitch_mm, 1.0 / pitch_mm
    matrix[:, 3] = -x[0] / pitch_mm, -y[0] / pitch_mm
    return laser, plain, matrix


def _laser_channel(grey: Floats, wavelength_nm: float) -> Floats:
    if grey.ndim == 2:
        return grey
    channel = 0 if wavelength_nm < _BLUE_TO_NM else 1 if wavelength_nm < _GREEN_TO_NM else 2
    return np.ascontiguousarray(grey[..., channel])


def _plain(grey: Floats) -> Floats:
    return grey if grey.ndim == 2 else np.asarray(grey @ _LUMA, np.float64)


def _in_picture(one: Drawn, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Places along and across a product's own footprint, 0 to 1, of belt positions."""
    turn = np.deg2rad(one.truth.figures.get("yaw_deg", 0.0))
    c, s = np.cos(turn), np.sin(turn)
    x_min, x_max, y_min, y_max = one.solid.footprint_extent_mm()
    there = np.meshgrid(np.arange(x_min, x_max, _EXTENT_STEP_MM), np.arange(y_min, y_max, _EXTENT_STEP_MM))
    # extent along the product's own axes: of the footprint, not of its turned box
    on_it = np.isfinite(one.solid.heights_mm(*there)[0])
    along = (c * there[0] + s * there[1])[on_it]
    across = (c * there[1] - s * there[0])[on_it]
    at_x = (c * x + s * y - along.min()) / np.ptp(along)
    at_y = (c * y - s * x - across.min()) / np.ptp(across)
    return at_x, at_y


def _interpolated(channel: Floats, at_x: Floats, at_y: Floats) -> Floats:
    from scipy.ndimage import map_coordinates

    rows, columns = channel.shape
    # the outer edge of the outermost pixels lies at 0 and 1; rows count from the top
    places = [(1.0 - at_y) * rows - 0.5, at_x * columns - 0.5]
    found: Floats = map_coordinates(channel, places, order=1, mode="nearest")
    return found
