"""Reference artefacts: bodies whose every height, hit and volume is a closed form.

Their sizes are options, none is random; only their place is: uniform over the ranges of `ProductOptions`,
which are 0 by default, so that an artefact lies in the middle and straight. Density 7.85 g/cm³ (steel).

=================  ================================================================================
block              a rectangular block
staircase          steps of one tread and one riser along its own x, the lowest at its own left
wedge              a prism whose top rises evenly along its own x
sphere             a ball on the belt, or its cap of a given height, flat side down
cylinder           lies along its own x, whole, or half of it, flat side down
ball-bar           two balls on the belt, joined by a thinner rod between their centres
truncated-pyramid  a rectangular base and a smaller level top, both about one middle
ball-plate         balls in a square grid, halfway in a plate over the belt: seen from above and below
=================  ================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from roemetry_simulate.products.family import (
    Drawn,
    Pose,
    ProductFamily,
    ProductOptions,
    describe,
    draw_pose,
    random_of,
)
from roemetry_simulate.products.parts import PartsSolid, Surface, ball, box, placed, plane, tube
from roemetry_simulate.solid import Block, Solid


class ArtefactOptions(ProductOptions):
    """Options of all artefacts."""

    density_g_per_cm3: float = Field(default=7.85, gt=0, le=25, description="density, g/cm³")


class BlockOptions(ArtefactOptions):
    """Options of `block`."""

    length_mm: float = Field(default=80.0, gt=0, le=5000, description="side along its own x, mm")
    width_mm: float = Field(default=40.0, gt=0, le=5000, description="side along its own y, mm")
    height_mm: float = Field(default=15.0, gt=0, le=2000, description="height, mm")


class StaircaseOptions(ArtefactOptions):
    """Options of `staircase`."""

    steps: int = Field(default=5, ge=1, le=100, description="number of steps")
    tread_mm: float = Field(default=16.0, gt=0, le=5000, description="extent of a step along its own x, mm")
    riser_mm: float = Field(default=4.0, gt=0, le=2000, description="height from one step to the next, mm")
    width_mm: float = Field(default=40.0, gt=0, le=5000, description="side along its own y, mm")


class WedgeOptions(ArtefactOptions):
    """Options of `wedge`."""

    length_mm: float = Field(default=80.0, gt=0, le=5000, description="side along its own x, mm")
    width_mm: float = Field(default=40.0, gt=0, le=5000, description="side along its own y, mm")
    low_height_mm: float = Field(default=0.0, ge=0, le=2000, description="height at its own left end, mm")
    high_height_mm: float = Field(default=20.0, gt=0, le=2000, description="height at its own right end, mm")

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.low_height_mm > self.high_height_mm:
            raise ValueError("low_height_mm must be at most high_height_mm")
        return self


class SphereOptions(ArtefactOptions):
    """Options of `sphere`."""

    radius_mm: float = Field(default=15.0, gt=0, le=2000, description="radius, mm")
    height_mm: float | None = Field(
        default=None,
        gt=0,
        description="height of a cap that stands on its flat side, mm; default: the whole ball",
    )

    @model_validator(mode="after")
    def _is_a_cap(self) -> Self:
        if self.height_mm is not None and self.height_mm > 2.0 * self.radius_mm:
            raise ValueError("height_mm must be at most twice radius_mm")
        return self


class CylinderOptions(ArtefactOptions):
    """Options of `cylinder`."""

    length_mm: float = Field(default=80.0, gt=0, le=5000, description="extent along its own x, mm")
    radius_mm: float = Field(default=12.0, gt=0, le=2000, description="radius, mm")
    half: bool = Field(default=True, description="true: half a cylinder, flat side down; false: a whole one")


class BallBarOptions(ArtefactOptions):
    """Options of `ball-bar`."""

    ball_radius_mm: float = Field(default=12.0, gt=0, le=2000, description="radius of both balls, mm")
    centre_distance_mm: float = Field(default=70.0, gt=0, le=5000, description="from centre to centre, mm")
    rod_radius_mm: float = Field(default=4.0, gt=0, le=2000, description="radius of the rod, mm")

    @model_validator(mode="after")
    def _is_a_bar(self) -> Self:
        if self.rod_radius_mm >= self.ball_radius_mm:
            raise ValueError("rod_radius_mm must be below ball_radius_mm")
        if self.centre_distance_mm < 2.0 * self.ball_radius_mm:
            raise ValueError("centre_distance_mm must be at least twice ball_radius_mm")
        return self


class PyramidOptions(ArtefactOptions):
    """Options of `truncated-pyramid`."""

    length_mm: float = Field(default=70.0, gt=0, le=5000, description="base along its own x, mm")
    width_mm: float = Field(default=50.0, gt=0, le=5000, description="base along its own y, mm")
    top_share: float = Field(default=0.4, gt=0, le=1, description="top's sides as a share of the base's")
    height_mm: float = Field(default=18.0, gt=0, le=2000, description="height, mm")


class BallPlateOptions(ArtefactOptions):
    """Options of `ball-plate`."""

    columns: int = Field(default=3, ge=1, le=20, description="balls along its own x")
    rows: int = Field(default=2, ge=1, le=20, description="balls along its own y")
    pitch_mm: float = Field(default=18.0, gt=0, le=500, description="from ball to ball, mm")
    ball_radius_mm: float = Field(default=6.0, gt=0, le=200, description="radius of a ball, mm")
    margin_mm: float = Field(default=2.0, ge=0, le=500, description="plate beyond the outer balls, mm")
    thickness_mm: float = Field(default=3.0, gt=0, le=100, description="of the plate, mm")
    height_mm: float = Field(default=20.0, gt=0, le=2000, description="of the balls' middles, mm")

    @model_validator(mode="after")
    def _balls_show(self) -> Self:
        if not 0.5 * self.thickness_mm < self.ball_radius_mm <= min(self.height_mm, 0.5 * self.pitch_mm):
            raise ValueError(
                "ball_radius_mm: expected above thickness_mm / 2, at most pitch_mm / 2, height_mm"
            )
        return self


def block(options: BlockOptions, pose: Pose) -> Solid:
    """Return the block."""
    return Block(options.length_mm, options.width_mm, options.height_mm, *pose)


def staircase(options: StaircaseOptions, pose: Pose) -> Solid:
    """Return the staircase: visible = true = width · tread · riser · n (n + 1) / 2."""
    n, tread, riser, half = options.steps, options.tread_mm, options.riser_mm, 0.5 * options.width_mm
    start = -0.5 * n * tread
    parts = [
        box((start + k * tread, start + (k + 1) * tread), (-half, half), (0.0, (k + 1) * riser))
        for k in range(n)
    ]
    volume = options.width_mm * tread * riser * n * (n + 1) / 2
    area = n * tread * options.width_mm
    return _solid(parts, pose, volume, volume, area, _rectangle(n * tread, options.width_mm), n * riser)


def wedge(options: WedgeOptions, pose: Pose) -> Solid:
    """Return the wedge: visible = true = length · width · mean height."""
    a, b, low, high = options.length_mm, options.width_mm, options.low_height_mm, options.high_height_mm
    # the top is a plane through the mean height in the middle
    slope = (high - low) / a
    top = plane((-slope, 0.0, 1.0), 0.5 * (low + high))
    part = [*box((-a / 2, a / 2), (-b / 2, b / 2), (0.0, high))[:5], top]
    volume = a * b * 0.5 * (low + high)
    return _solid([part], pose, volume, volume, a * b, _rectangle(a, b), high)


def sphere(options: SphereOptions, pose: Pose) -> Solid:
    """Return the ball or cap of height h: true = π h² (3 r - h) / 3; visible has its columns filled."""
    r = options.radius_mm
    h = 2.0 * r if options.height_mm is None else options.height_mm
    part = [ball(0.0, 0.0, h - r, r), plane((0.0, 0.0, -1.0), 0.0)]
    true = math.pi * h * h * (3.0 * r - h) / 3.0
    # over the widest circle a ball's columns are filled down to the belt
    visible = true if h <= r else math.pi * r * r * (2.0 / 3.0 * r + h - r)
    rim = r if h >= r else math.sqrt(h * (2.0 * r - h))
    extent = (pose.x_mm - rim, pose.x_mm + rim, pose.y_mm - rim, pose.y_mm + rim)
    # the belt cuts a whole ball in one point, which is no surface
    part = part[:1] if options.height_mm is None else part
    return PartsSolid(placed([part], pose), visible, true, math.pi * rim * rim, extent, h)


def cylinder(options: CylinderOptions, pose: Pose) -> Solid:
    """Return the cylinder: true = π r² l, visible = (2 + π / 2) r² l; half: both π r² l / 2."""
    a, r = options.length_mm, options.radius_mm
    ends = [plane((-1.0, 0.0, 0.0), a / 2), plane((1.0, 0.0, 0.0), a / 2)]
    half = 0.5 * math.pi * r * r * a
    base = _rectangle(a, 2.0 * r)
    if options.half:
        part = [tube(0.0, 0.0, r), *ends, plane((0.0, 0.0, -1.0), 0.0)]
        return _solid([part], pose, half, half, 2.0 * r * a, base, r)
    visible = half + 2.0 * r * r * a
    return _solid([[tube(0.0, r, r), *ends]], pose, visible, 2.0 * half, 2.0 * r * a, base, 2.0 * r)


def ball_bar(options: BallBarOptions, pose: Pose) -> Solid:
    """Return the ball bar.

    The rod leaves each ball in the circle c = √(R² - r²) from its centre, and covers from above all of the
    ball's disc beyond c. So the true volume is that of the balls without their caps beyond c and of the rod
    between; the visible one that of the columns under the same pieces.
    """
    big, small, apart = options.ball_radius_mm, options.rod_radius_mm, options.centre_distance_mm
    c = math.sqrt(big * big - small * small)
    middle = 0.5 * apart
    rod = [tube(0.0, big, small), plane((-1.0, 0.0, 0.0), middle - c), plane((1.0, 0.0, 0.0), middle - c)]
    parts = [[ball(-middle, 0.0, big, big)], rod, [ball(middle, 0.0, big, big)]]
    length = apart - 2.0 * c
    cap = math.pi * (big - c) ** 2 * (2.0 * big + c) / 3.0
    true = 2.0 * (4.0 / 3.0 * math.pi * big**3 - cap) + math.pi * small**2 * length
    disc = big * big * (0.5 * math.pi + math.asin(c / big)) + c * small
    dome = 0.5 * math.pi * (big * big * (c + big) - (c**3 + big**3) / 3.0)
    visible = 2.0 * (big * disc + dome) + length * (2.0 * small * big + 0.5 * math.pi * small**2)
    at = np.deg2rad(pose.yaw_deg)
    reach_x, reach_y = middle * abs(math.cos(at)) + big, middle * abs(math.sin(at)) + big
    extent = (pose.x_mm - reach_x, pose.x_mm + reach_x, pose.y_mm - reach_y, pose.y_mm + reach_y)
    area = 2.0 * disc + 2.0 * small * length
    return PartsSolid(placed(parts, pose), visible, true, area, extent, 2.0 * big)


def truncated_pyramid(options: PyramidOptions, pose: Pose) -> Solid:
    """Return the pyramid: visible = true = a b h (1 + s + s²) / 3 with the top's share s of the sides."""
    a, b, share, h = options.length_mm, options.width_mm, options.top_share, options.height_mm
    lean_x, lean_y = 0.5 * a * (1.0 - share) / h, 0.5 * b * (1.0 - share) / h
    part = [
        plane((-1.0, 0.0, lean_x), a / 2),
        plane((1.0, 0.0, lean_x), a / 2),
        plane((0.0, -1.0, lean_y), b / 2),
        plane((0.0, 1.0, lean_y), b / 2),
        plane((0.0, 0.0, -1.0), 0.0),
        plane((0.0, 0.0, 1.0), h),
    ]
    volume = a * b * h * (1.0 + share + share * share) / 3.0
    return _solid([part], pose, volume, volume, a * b, _rectangle(a, b), h)


def ball_plate(options: BallPlateOptions, pose: Pose) -> Solid:
    """Return the plate: true = a b t + 2 n c, visible = a b (z + t / 2) + n c, with the cap c of a ball."""
    r, z, t = options.ball_radius_mm, options.height_mm, options.thickness_mm
    many = np.array([options.columns, options.rows])
    first = -0.5 * options.pitch_mm * (many - 1)
    a, b = (2.0 * (r + options.margin_mm - first)).tolist()
    parts = [box((-a / 2, a / 2), (-b / 2, b / 2), (z - t / 2, z + t / 2))] + [
        [ball(first[0] + i * options.pitch_mm, first[1] + j * options.pitch_mm, z, r)]
        for i in range(options.columns)
        for j in range(options.rows)
    ]
    caps = options.columns * options.rows * math.pi * (r - t / 2) ** 2 * (2.0 * r + t / 2) / 3.0
    visible = a * b * (z + t / 2) + caps
    return _solid(parts, pose, visible, a * b * t + 2.0 * caps, a * b, _rectangle(a, b), z + r)


def _rectangle(length_mm: float, width_mm: float) -> tuple[float, float]:
    return 0.5 * length_mm, 0.5 * width_mm


def _solid(
    parts: Sequence[Sequence[Surface]], pose: Pose, visible_mm3: float, true_mm3: float, area_mm2: float,
    half_mm: tuple[float, float], top_mm: float,
) -> PartsSolid:  # fmt: skip
    """Place parts whose footprint is a rectangle about their own origin, of the given half sides."""
    at = math.radians(pose.yaw_deg)
    c, s = abs(math.cos(at)), abs(math.sin(at))
    x, y = c * half_mm[0] + s * half_mm[1], s * half_mm[0] + c * half_mm[1]
    extent = (pose.x_mm - x, pose.x_mm + x, pose.y_mm - y, pose.y_mm + y)
    return PartsSolid(placed(parts, pose), visible_mm3, true_mm3, area_mm2, extent, top_mm)


_SHAPES: dict[str, tuple[str, type[ArtefactOptions], Callable[[Any, Pose], Solid]]] = {
    "block": ("a rectangular block", BlockOptions, block),
    "staircase": ("level steps", StaircaseOptions, staircase),
    "wedge": ("a plane that rises evenly", WedgeOptions, wedge),
    "sphere": ("a ball on the belt, or a cap of one", SphereOptions, sphere),
    "cylinder": ("a lying cylinder, half or whole", CylinderOptions, cylinder),
    "ball-bar": ("two balls joined by a rod above the belt", BallBarOptions, ball_bar),
    "truncated-pyramid": ("a truncated pyramid", PyramidOptions, truncated_pyramid),
    "ball-plate": ("balls halfway in a plate", BallPlateOptions, ball_plate),
}


def _family(name: str) -> ProductFamily:
    summary, options_type, shape = _SHAPES[name]

    def make(seed: int, options: ArtefactOptions) -> Drawn:
        pose = draw_pose(random_of(seed, name), options)
        solid = shape(options, pose)
        return Drawn(solid, describe(solid, options, figures={"yaw_deg": pose.yaw_deg}))

    return ProductFamily(name, summary, options_type, make)


ARTEFACTS = tuple(_family(name) for name in _SHAPES)
"""All of them, as families."""
