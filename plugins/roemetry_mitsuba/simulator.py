"""The simulator stage: from a scene to images and their truth.

An item's product is drawn from (set's seed + number), its texture, speckle and noise from the same; so an
item does not depend on the others. The same scene, seed and number give the same bytes on the same kind of
processor (float32 sums may differ in their last digits between vector widths).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.config.scene_parts import BOARDS, NONE, ON_BELT, BoardPart, family_options
from roemetry.errors import StageError
from roemetry.records import Frame, ProductTruth, Role, Simulated, Truth
from roemetry.records import Sensor as Noise
from roemetry.stages import Simulator, Turn
from roemetry_mitsuba.bodies import Body, mitsuba
from roemetry_mitsuba.light import DOME_SHARE, Lamps, Lens, Material, Sensor, Tracer, expose
from roemetry_mitsuba.materials import Dipole, dipole_of
from roemetry_mitsuba.products import FAMILIES, MODELS, Drawn, block, stairs
from roemetry_mitsuba.scene import Camera, Fan, MitsubaOptions, camera_of, fan_of
from roemetry_mitsuba.truth import Crossings, crossings

Floats = NDArray[np.float64]

_NEXT_IN_FRAME = 1_000_003
"""Between the seeds of a frame's products, so that no other item's product has them."""
_TEXEL_MM = 0.15
"""Pitch of the textures: about a pixel."""
_WHITE, _BLACK = 0.62, 0.08
"""Albedo of a board's paper and ink, and of the matt paint of block and staircase (`_WHITE`)."""
_PX_PER_SQUARE = 64  # of a board's print: finer than any image shows it
_AT_REST = np.zeros((1, 3))
_EDGE_MM = 1.0
"""What is left between a product that was moved into reach and the border of the view."""


class Placed(NamedTuple):
    """A product on the belt: its body, its truth, and its body without the defect, in the same place."""

    body: Body
    truth: ProductTruth
    reference: Body


class MitsubaSimulator(Simulator[MitsubaOptions]):
    """Renders by Mitsuba 3: sheets of light, gloss, scattering inside the product, interreflection, lamps.

    Left out: motion during the exposure, planes that are cones, caustics, polarisation.
    """

    def __init__(self, options: MitsubaOptions | None = None) -> None:
        super().__init__(options)
        mitsuba()  # what is missing is said before anything is drawn
        self.placed(0, 0)  # so is a product that cannot be, or does not fit

    def simulate(self, number: int, seed: int) -> Simulated:
        """Make the item of this number; raise StageError where its product does not fit into the view."""
        placed = self.placed(number, seed)
        bodies = [one.body for one in placed]
        item_seed = seed + number
        found = crossings(self.camera, self.fan, bodies)
        frames = [self._item_frame(role, bodies, item_seed, number) for role in self.options.light.images]
        products = tuple(_with_figures(one, found, k, item_seed) for k, one in enumerate(placed, start=1))
        return Simulated(tuple(frames), Truth(products, found.record()))

    def placed(self, number: int, seed: int) -> tuple[Placed, ...]:
        """Draw the products of an item, from left to right."""
        part = self.options.product
        if part.family == NONE:
            return ()
        chosen = part.items[number] if number < len(part.items) else None
        # listed items use up none of the seeds of drawn ones
        item_seed = seed + number - len(part.items) if chosen is None else chosen.seed
        own = {} if chosen is None else chosen.options
        options = family_options(part.family, part.options | own, MODELS)
        laid = []
        for k in range(part.in_frame):
            # the family counts: another one draws other products
            rng = np.random.default_rng([item_seed + k * _NEXT_IN_FRAME, *part.family.encode()])
            drawn = FAMILIES[part.family].make(rng, options)
            at = rng.uniform(-1.0, 1.0, 3) * [
                options.offset_range_x_mm, options.offset_range_y_mm, options.turn_range_deg
            ]  # fmt: skip
            laid.append(_lay(drawn, (at[0], at[1], at[2]), options.density_g_per_cm3))
        if part.in_frame > 1:
            laid = _in_a_row(laid, part.gap_mm)
        name = f"item {number + 1}, {part.family} of seed {item_seed}"
        found = [self._fitted(one, name) for one in laid]
        return tuple(sorted(found, key=lambda one: sum(one.body.extent_mm[:2])))

    def calibration_frames(self, seed: int) -> Mapping[str, Mapping[str, Frame]]:
        """Give the calibration images, by kind and name; each is made when it is asked for."""
        return self.options.targets.views(partial(self._target, seed))

    def target_bodies(self, kind: str, name: str, seed: int) -> list[Body]:
        """Give what lies on the belt in a calibration image."""
        targets = self.options.targets
        if kind == "belt":
            return []
        if kind in BOARDS:
            return [_plate(targets.board, self.board_poses(seed)[name.rsplit("_", 1)[0]])]
        lies, steps = targets.block, targets.staircase
        if kind == "block":
            body = block(lies.length_mm, lies.width_mm, lies.height_mm)
        else:
            body = stairs(steps.steps, steps.tread_mm, steps.riser_mm, steps.width_mm)
        return [body.moved(lies.centre_x_mm, lies.centre_y_mm, lies.yaw_deg)]

    def board_poses(self, seed: int) -> dict[str, Floats]:
        """Give T_belt_board, shape (4, 4), of every pose; the board's frame is OpenCV's, z into the board."""
        part = self.options.targets.board
        rng = np.random.default_rng([seed, 230])
        size = part.square_mm * np.array([part.columns, part.rows])
        poses = {}
        for number in range(1, part.poses + 1):
            # the first pose is not tilted
            tilt = math.radians(part.tilt_max_deg) * (0.0 if number == 1 else rng.uniform(0.55, 1.0))
            way = 2.0 * math.pi * (number + rng.uniform(-0.3, 0.3)) * 0.381966  # all ways round, none twice
            # a quarter of them lie the other way round
            spin = math.radians(rng.uniform(-20.0, 20.0)) + (math.pi if rng.random() < 0.25 else 0.0)
            tilted = _about(np.array([math.cos(way), math.sin(way), 0.0]), tilt)
            turn = tilted @ _about(np.array([0.0, 0.0, 1.0]), spin) @ np.diag([1.0, -1.0, -1.0])
            # so high that no corner goes below the belt
            lift = float(np.abs(turn[2, :2]) @ (0.5 * size + part.square_mm)) + part.thickness_mm + 0.3
            height = lift + float(rng.uniform(*part.height_mm))
            # a user lays the board where the laser meets it, and not twice at the same place
            middle = np.array([float(self.fan.x_mm(0.0, height).mean()), 0.0, height])
            middle[:2] += rng.uniform(-4.0, 4.0, 2)
            poses[f"pose_{number:02d}"] = _pose(turn, middle - turn[:, :2] @ (0.5 * size))
        # flat on the belt, laid by hand: 1.5° askew
        flat = _about(np.array([0.0, 0.0, 1.0]), math.radians(1.5)) @ np.diag([1.0, -1.0, -1.0])
        middle = np.array([self.fan.x_mm(0.0, 0.0).mean(), 0.0, part.thickness_mm])
        poses[ON_BELT] = _pose(flat, middle - flat[:, :2] @ (0.5 * size))
        return poses

    def turn_deg(self) -> Turn:
        """Give the turn that rights its images."""
        return self.options.turn_deg

    def sensor(self) -> Noise:
        """Give the noise of the scene's camera."""
        return Noise(self._sensor.grey_per_electron, self._sensor.read_noise_grey)

    def calibration_truth(self, seed: int) -> Mapping[str, Any]:
        """Give the true rig, and where each target lay; planes are n·X = d in the belt frame, mm."""
        camera = self.camera
        cx, cy = camera.principal_px.tolist()
        return {
            "rig": {
                "image_size": [camera.height_px, camera.width_px],
                "camera_matrix": [[camera.focal_px, 0.0, cx], [0.0, camera.focal_px, cy], [0.0, 0.0, 1.0]],
                "distortion": camera.distortion.tolist() if camera.distortion.any() else [],
                "T_belt_camera": _pose(camera.rotation, camera.centre_mm).tolist(),
                "planes": np.column_stack([self.fan.normals, self.fan.offsets_mm]).tolist(),
                "projector_mm": self.fan.origin_mm.tolist(),
            },
            **self.options.targets.truth(self.board_poses(seed)),
        }

    @cached_property
    def camera(self) -> Camera:
        """The camera."""
        return camera_of(self.options.camera)

    @cached_property
    def fan(self) -> Fan:
        """The projector."""
        return fan_of(self.options.laser, self._grey)

    @property
    def _grey(self) -> float:
        """Grey levels of one electron a ms over the exposure."""
        return self.options.camera.exposure_ms * self.options.camera.gain_dn_per_e

    @cached_property
    def _sensor(self) -> Sensor:
        camera, laser = self.options.camera, self.options.laser
        grain = laser.speckle_sigma_px
        if grain is None:  # that of diffraction at the aperture: λ N (1 + m) wide at half height
            f_number = 8.0 if camera.focus is None else camera.focus.f_number
            focal_mm = camera.focal_length_mm
            magnification = focal_mm / max(camera.distance_mm - focal_mm, 1.0)
            width_um = 1e-3 * laser.wavelength_nm * f_number * (1.0 + magnification)
            grain = width_um / camera.pixel_size_um / (2.0 * math.sqrt(2.0 * math.log(2.0)))
        return Sensor(
            camera.gain_dn_per_e, camera.read_noise_e * camera.gain_dn_per_e, camera.black_level_dn,
            camera.blur_sigma_px, math.inf if camera.full_well_e is None else camera.full_well_e,
            camera.bit_depth, camera.vignetting, camera.prnu, laser.speckle_contrast, grain,
        )  # fmt: skip

    @cached_property
    def _lens(self) -> Lens:
        focus = self.options.camera.focus
        if focus is None:
            return Lens()
        return Lens(focus.distance_mm, 0.5 * self.options.camera.focal_length_mm / focus.f_number)

    @cached_property
    def _below(self) -> tuple[Dipole, float] | None:
        """Light from inside the products: its dipole and its share; None where there is none."""
        surface = self.options.surface
        below = surface.below
        if below.share <= 0.0 or surface.metal != "none":
            return None
        return dipole_of(below.depth_mm, below.blur_mm), below.share

    def _lamps(self, role: Role) -> Lamps:
        light, grey = self.options.light, self._grey
        sky, ring = light.ambient_e_per_ms, 0.0
        if role == "plain":
            sky, ring = DOME_SHARE * light.plain_e_per_ms, (1.0 - DOME_SHARE) * light.plain_e_per_ms
        lamps = Lamps(sky * grey, ring * grey, light.lamp_height_mm, light.lamp_radius_mm)
        if light.stray is None:
            return lamps
        at, radius = light.stray.position_mm, light.stray.radius_mm
        return replace(lamps, stray_grey=light.stray.e_per_ms * grey, stray_mm=at, stray_radius_mm=radius)

    def _item_frame(self, role: Role, bodies: list[Body], seed: int, number: int) -> Frame:
        ground = self._belt_material(role, seed, clean=False)
        material = self._product_material(role, bodies, seed)
        pixels = self._take_image(role, ground, bodies, material, self._below, seed)
        belt = self.options.belt
        # whole counts; the small number is against rounding
        travel_mm = number * belt.pitch_mm
        return Frame(
            pixels,
            role=role,
            bit_depth=self.options.camera.bit_depth,
            time_s=travel_mm / belt.speed_mm_per_s if belt.speed_mm_per_s > 0.0 else math.nan,
            sensor=self.sensor(),
            encoder_count=float(math.floor(travel_mm / belt.encoder_step_mm + 1e-9)),
        )

    def _target(self, seed: int, kind: str, name: str) -> Frame:
        role: Role = "plain" if name.endswith("_plain") else "laser"
        bodies = self.target_bodies(kind, name, seed)
        # by kind and name: another image changes none of the others
        number = sum(name.encode()) + 1000 * ("block", "belt", "staircase", *BOARDS).index(kind)
        if kind in BOARDS:
            pose = self.board_poses(seed)[name.rsplit("_", 1)[0]]
            material = _printed(self.options.targets.board, kind, pose)
        else:
            material = Material(np.full((2, 2), _WHITE), np.zeros((2, 4)))
        seed += 7919 * number
        ground = self._belt_material(role, seed, clean=True)
        pixels = self._take_image(role, ground, bodies, material, None, seed)
        return Frame(
            pixels, role=role, name=name, bit_depth=self.options.camera.bit_depth, sensor=self.sensor()
        )

    def _take_image(
        self, role: Role, ground: Material, bodies: list[Body], material: Material,
        below: tuple[Dipole, float] | None, seed: int,
    ) -> NDArray[Any]:  # fmt: skip
        """Take one image, turned as it is stored."""
        tracer = Tracer(
            self.camera, self._lens, self.fan, ground, bodies, material, below,
            self.options.samples, seed,
        )  # fmt: skip
        laser, other = tracer.image(
            self._lamps(role), laser=role == "laser", bounce_rays=self.options.bounce_rays
        )
        # images of one item have noise of their own
        noise = seed + 2**32 * ("laser", "plain", "dark").index(role)
        pixels = expose(laser, other, self.camera, self._sensor, noise)
        return np.ascontiguousarray(np.rot90(pixels, -self.options.turn_deg // 90))

    def _belt_material(self, role: Role, seed: int, *, clean: bool, moved_mm: Floats = _AT_REST) -> Material:
        """Give what of the belt comes into view while it moves to places (line, 3)."""
        belt = self.options.belt
        at = self.camera.border_on(0.0)[:, :2]
        # all that the view's border passes, and 5 mm
        low = at.min(axis=0) - moved_mm[:, :2].max(axis=0) - 5.0
        high = at.max(axis=0) - moved_mm[:, :2].min(axis=0) + 5.0
        rng = np.random.default_rng([seed, 11])
        factor, x, y = _texture(rng, low, high, belt.texture)
        for _ in range(0 if clean else belt.dirt.count):
            spot = rng.uniform(
                [*low, 0.5 * belt.dirt.diameter_mm[0]], [*high, 0.5 * belt.dirt.diameter_mm[1]]
            )
            factor = np.where(np.hypot(x - spot[0], y - spot[1]) < spot[2], belt.dirt.albedo, factor)
        for patch in [] if clean else belt.patches:
            inside = (x > patch.x_mm[0]) & (x < patch.x_mm[1]) & (y > patch.y_mm[0]) & (y < patch.y_mm[1])
            factor = np.where(inside, patch.albedo, factor)
        albedo = belt.albedo_plain if role == "plain" else belt.albedo_laser
        return Material(albedo * factor, _over(low, high, 0.0), belt.gloss, 0.35)

    def _product_material(self, role: Role, bodies: list[Body], seed: int) -> Material:
        surface = self.options.surface
        extents = np.array([body.extent_mm for body in bodies] or [(-1.0, 1.0, -1.0, 1.0)])
        low, high = extents[:, [0, 2]].min(axis=0), extents[:, [1, 3]].max(axis=0)
        rng = np.random.default_rng([seed, 12])
        factor, x, y = _texture(rng, low, high, surface.texture)
        shear = 0.7
        # a picture is laid on from above
        if surface.albedo_map is not None:
            factor, shear = factor * self._picture(factor.shape), 0.0
        wet = None
        if surface.wet.count and surface.wet.gloss > 0.0:
            wet = np.zeros_like(factor)
            for _ in range(surface.wet.count):
                spot = rng.uniform(
                    [*low, 0.5 * surface.wet.diameter_mm[0]], [*high, 0.5 * surface.wet.diameter_mm[1]]
                )
                wet = np.maximum(wet, surface.wet.gloss * (np.hypot(x - spot[0], y - spot[1]) < spot[2]))
        albedo = surface.albedo_plain if role == "plain" else surface.albedo_laser
        roughness = math.sqrt(2.0 / (surface.gloss_exponent + 2.0))
        return Material(
            albedo * factor, _over(low, high, shear), surface.gloss, roughness, surface.metal, wet
        )

    def _picture(self, shape: tuple[int, ...]) -> Floats:
        """The albedo map as factors, row 0 at the smallest Y."""
        import cv2

        part = self.options.surface.albedo_map
        assert part is not None
        factors = part.factors()
        grey = factors[..., :3].mean(axis=-1) if factors.ndim == 3 else factors
        return np.asarray(cv2.resize(grey, shape[::-1], interpolation=cv2.INTER_AREA)[::-1])

    def _fitted(self, one: Placed, name: str) -> Placed:
        """Give a product where stripes and view cover it; raise StageError where they cannot."""
        found = self._move_into_reach(one) if self.options.product.keep_in_reach else one
        self._check_in_view(found.body, name)
        return found

    def _move_into_reach(self, one: Placed) -> Placed:
        """Move a product along X by as little as brings its ends near the outer stripes and into the view."""
        x_min, x_max, y_min, y_max = one.body.extent_mm
        # ends of products are some way up, not at the belt
        height = 0.25 * one.body.height_mm
        lines_x = np.sort(self.fan.x_mm(0.5 * (y_min + y_max), height))
        low, high, _, _ = self.camera.view_on(height)
        low, high = low + _EDGE_MM, high - _EDGE_MM
        if lines_x.size > 1:
            over = self.options.product.most_overhang_spacings * float(np.diff(lines_x).mean())
            low, high = max(low, float(lines_x[0]) - over), min(high, float(lines_x[-1]) + over)
        return _moved(one, max(low - x_min, 0.0) + min(high - x_max, 0.0), 0.0)

    def _check_in_view(self, body: Body, name: str) -> None:
        """Raise StageError, with sizes, for a product that reaches out of the view or up to the rig."""
        lowest = min(float(self.camera.centre_mm[2]), float(self.fan.origin_mm[2]))
        if body.height_mm >= lowest:
            raise StageError(
                f"{name}: the product is {body.height_mm:.1f} mm high, the rig hangs at {lowest:.1f} mm",
                hint="make the product smaller, or hang them higher",
                at=("product",),
            )
        x_min, x_max, y_min, y_max = body.extent_mm
        left, right, near, far = self.camera.view_on(0.0)
        if x_min < left or x_max > right or y_min < near or y_max > far:
            raise StageError(
                f"{name}: the product lies on X = {x_min:.1f} to {x_max:.1f} mm, Y = {y_min:.1f} to "
                f"{y_max:.1f} mm; the view is X = {left:.1f} to {right:.1f} mm, Y = {near:.1f} to "
                f"{far:.1f} mm",
                hint="make the product smaller, or let the camera see more",
                at=("product",),
            )


def _lay(drawn: Drawn, at: tuple[float, float, float], density: float) -> Placed:
    """Lay a product at (x mm, y mm, yaw degrees); volumes are taken before it is turned."""
    x_mm, y_mm, yaw_deg = at
    body = drawn.body
    truth = ProductTruth(
        label="good" if drawn.defect == NONE else "henkei",
        defect=drawn.defect,
        visible_mm3=body.visible_mm3,
        true_mm3=body.true_mm3,
        mass_g=body.true_mm3 * 1e-3 * density,
        figures={"footprint_mm2": body.footprint_mm2, "height_mm": body.height_mm, "yaw_deg": float(yaw_deg)},
    )
    reference = (drawn.reference or body).moved(x_mm, y_mm, yaw_deg)
    return Placed(body.moved(x_mm, y_mm, yaw_deg), truth, reference)


def _moved(one: Placed, x_mm: float, y_mm: float) -> Placed:
    if x_mm == 0.0 and y_mm == 0.0:
        return one
    return Placed(one.body.moved(x_mm, y_mm), one.truth, one.reference.moved(x_mm, y_mm))


def _in_a_row(laid: list[Placed], gap_mm: float) -> list[Placed]:
    """Lay products beside each other along Y, centred on the origin."""
    extents = [one.body.extent_mm for one in laid]
    widths = [extent[3] - extent[2] for extent in extents]
    at = -0.5 * (sum(widths) + gap_mm * (len(laid) - 1))
    found = []
    for one, extent, width in zip(laid, extents, widths, strict=True):
        found.append(_moved(one, 0.0, at - extent[2]))
        at += width + gap_mm
    return found


def _with_figures(one: Placed, found: Crossings, label: int, seed: int) -> ProductTruth:
    """Add what the stripes show of a product and of its defect."""
    body = one.body
    x_min, x_max, y_min, y_max = body.extent_mm
    on = (found.label == label) & found.first()
    figures = dict(one.truth.figures) | {
        "seed": float(seed), "x_min_mm": x_min, "x_max_mm": x_max, "y_min_mm": y_min, "y_max_mm": y_max,
        "left_stripe": 0.0, "right_stripe": 0.0, "overhang_left_mm": math.nan, "overhang_right_mm": math.nan,
        "defect_depth_mm": 0.0, "defect_seen_mm": math.nan, "hollow_seen_mm": math.nan,
    }  # fmt: skip
    if one.reference is not body and one.truth.defect != NONE:
        x, y = np.meshgrid(np.arange(x_min, x_max, 0.25), np.arange(y_min, y_max, 0.25))
        figures["defect_depth_mm"] = _most(one.reference.heights.at(x, y) - body.heights.at(x, y))
    if on.any():
        points, stripes = found.xyz_mm[on], found.stripe[on]
        left, right = int(stripes.min()), int(stripes.max())
        seen = one.reference.heights.at(points[:, 0], points[:, 1]) - points[:, 2]
        figures |= {
            "left_stripe": left + 1.0,
            "right_stripe": right + 1.0,
            "overhang_left_mm": float(np.median(points[stripes == left, 0])) - x_min,
            "overhang_right_mm": x_max - float(np.median(points[stripes == right, 0])),
            "defect_seen_mm": _most(seen) if one.truth.defect != NONE else 0.0,
            "hollow_seen_mm": max(_hollow(points[stripes == i, 1:]) for i in np.unique(stripes)),
        }
    return replace(one.truth, figures=figures)


def _most(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return max(float(known.max()), 0.0) if known.size else 0.0


def _hollow(profile_mm: Floats) -> float:
    """Depth of a profile of (y, z), shape (n, 2), below its upper convex hull."""
    if len(profile_mm) < 3:
        return 0.0
    profile = profile_mm[np.argsort(profile_mm[:, 0])]
    hull = [profile[0]]
    for point in profile[1:]:
        # the upper hull by Andrew's monotone chain
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (b[0] - a[0]) * (point[1] - a[1]) < (b[1] - a[1]) * (point[0] - a[0]):
                break
            hull.pop()
        hull.append(point)
    corners = np.array(hull)
    return float((np.interp(profile[:, 0], corners[:, 0], corners[:, 1]) - profile[:, 1]).max())


def _texture(
    rng: np.random.Generator, low: Floats, high: Floats, deviation: float
) -> tuple[Floats, Floats, Floats]:
    """Factors of an albedo over a rectangle, mean 1, and their X and Y: blotches, cells and grain alike."""
    from scipy.ndimage import gaussian_filter

    columns, rows = np.clip(np.ceil((high - low) / _TEXEL_MM), 8, 2048).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * (high[0] - low[0]) / columns
    y = low[1] + (np.arange(rows) + 0.5) * (high[1] - low[1]) / rows
    total = np.zeros((rows, columns))
    # blotches, cells and grain; their variances add up to 1
    for grain_mm, share in ((6.0, 0.5), (1.2, 0.6), (0.25, 0.62)):
        field = gaussian_filter(rng.standard_normal((rows, columns)), grain_mm / _TEXEL_MM, mode="wrap")
        total += share * field / max(float(field.std()), 1e-12)
    factor = np.clip(1.0 + deviation * total, 0.05, None)
    return factor, *np.meshgrid(x, y)


def _over(low: Floats, high: Floats, shear: float) -> Floats:
    """Texture coordinates over a rectangle seen from above; `shear` keeps upright faces from streaks."""
    scale = 1.0 / (high - low)
    return np.array(
        [
            [scale[0], 0.0, shear * scale[0], -low[0] * scale[0]],
            [0.0, scale[1], shear * scale[1], -low[1] * scale[1]],
        ]
    )


def _printed(part: BoardPart, kind: str, pose: Floats) -> Material:
    """A board's print, half a square of white about it."""
    print_ = part.print_picture(kind, _PX_PER_SQUARE)
    to_board = np.linalg.inv(pose)[:2]
    # the print, half a square of white around it
    uv = to_board / (part.square_mm * np.array([[part.columns + 1.0], [part.rows + 1.0]]))
    uv[:, 3] += 0.5 / np.array([part.columns + 1.0, part.rows + 1.0])
    return Material(_BLACK + (_WHITE - _BLACK) * print_, uv)


def _plate(part: BoardPart, pose: Floats) -> Body:
    """The plate that carries a board's print on its upper side."""
    square = part.square_mm
    plate = block((part.columns + 1) * square, (part.rows + 1) * square, part.thickness_mm)
    # block: middle over its origin, from 0 up; board: first corner at the origin, z into the plate
    shift = np.array([0.5 * part.columns * square, 0.5 * part.rows * square, 0.0])
    points = plate.points_mm * [1.0, -1.0, -1.0] + shift + [0.0, 0.0, part.thickness_mm]
    return Body(points @ pose[:3, :3].T + pose[:3, 3], plate.faces, smooth=False)


def _pose(rotation: Floats, place: Floats) -> Floats:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, place
    return pose


def _about(axis: Floats, angle: float) -> Floats:
    """Rotation about a unit axis (Rodrigues)."""
    k = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turned: Floats = np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * k @ k
    return turned
