"""Populations of foods: bread rolls, eggs, fillets, potatoes, with their defects.

Model. A food is a gridded body (`roemetry_simulate.solid`) over q(u, v) of its own frame, above 0 on the
footprint and 0 at its edge: the top is rim + dome · √(q (1 + fullness (1 − q))) and the underside rim − rim ·
√(1 − (1 − q)^power), half an ellipse for a power of 1 and flatter for more. Outlines are superellipses that a
family bends its own way. A relief of filtered noise and a defect, a dent (a bell of finite extent) or a
furrow (a Gaussian across a straight line), are added to the top.

Sizes are uniform over ranges that look like the food; the seed draws all of it. What a family is not:
overhanging sides, wrinkles finer than the grid, pieces that touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from roemetry_simulate.products.family import (
    Drawn,
    PopulationOptions,
    Pose,
    ProductFamily,
    changed,
    describe,
    draw_pose,
    kind_shares,
    pick,
    random_of,
)
from roemetry_simulate.solid import GriddedSolid
from roemetry_simulate.surface import smooth_noise

Floats = NDArray[np.float64]
Function = Callable[[Floats, Floats], Floats]


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 < limits[0] <= limits[1]:
        raise ValueError("a range goes from a positive number to one that is not smaller")
    return limits


Range = Annotated[tuple[float, float], AfterValidator(_ordered)]


class FoodOptions(PopulationOptions):
    """Options that all foods share."""

    length_range_mm: Range = Field(description="smallest and largest length, mm")
    width_range_mm: Range = Field(description="smallest and largest width, mm")
    grid_step_mm: float = Field(default=0.25, ge=0.02, le=5, description="pitch of the body's grid, mm")


@dataclass(frozen=True, eq=False)
class Form:
    """A food's shape in its own frame.

    - `half_length_mm`, `half_width_mm`: The footprint lies within these.
    - `q`: Of (u, v) in mm: above 0 on the footprint, falling through 0 at its edge.
    - `dome`: Of (u, v) in mm: height of the ridge over the rim, mm.
    - `rim_mm`: Height of the widest line over the belt.
    - `power`, `fullness`: Roundness of underside and top.
    - `relief_mm`, `relief_period_mm`: Standard deviation of the relief, and the length over which it changes.
    """

    half_length_mm: float
    half_width_mm: float
    q: Function
    dome: Function
    rim_mm: float
    power: float = 1.0
    fullness: float = 0.0
    relief_mm: float = 0.0
    relief_period_mm: float = 3.0


def drawn(
    form: Form, change: Function | None, defect: str, pose: Pose, options: FoodOptions, seed: int,
    figures: Mapping[str, float] | None = None,
) -> Drawn:  # fmt: skip
    """Shape a food, with its reference and its truth.

    `change`, of (u, v) in mm, is what the defect adds to the top (mm); None for a healthy one, which is its
    own reference. The seed is that of the relief; `figures` stand in the truth after the sizes.
    """
    reference = _shape(form, None, pose, options.grid_step_mm, seed)
    solid = reference if change is None else _shape(form, change, pose, options.grid_step_mm, seed)
    lost = 1.0 - solid.true_volume_mm3 / solid.visible_volume_mm3
    more = {**_sizes(solid, pose), **(figures or {}), "yaw_deg": pose.yaw_deg, "underside_share": lost}
    return Drawn(solid, describe(solid, options, defect, more), reference)


def dent(
    rng: np.random.Generator, half_mm: tuple[float, float], depth_mm: tuple[float, float],
    size_mm: tuple[float, float],
) -> Function:  # fmt: skip
    """Draw a smooth hollow: depth and extents uniform over ranges, place within half of the half sizes."""
    depth, along, across = rng.uniform(*depth_mm), rng.uniform(*size_mm), rng.uniform(*size_mm)
    u0, v0 = rng.uniform(-0.5, 0.5) * half_mm[0], rng.uniform(-0.5, 0.5) * half_mm[1]

    def change(u: Floats, v: Floats) -> Floats:
        r2 = (2.0 * (u - u0) / along) ** 2 + (2.0 * (v - v0) / across) ** 2
        hollow: Floats = -depth * np.clip(1.0 - r2, 0.0, 1.0) ** 2
        return hollow

    return change


def furrow(
    rng: np.random.Generator, half_length_mm: float, depth_mm: tuple[float, float],
    width_mm: tuple[float, float], angle_deg: tuple[float, float],
) -> Function:  # fmt: skip
    """Draw a straight furrow: depth, width and angle to own x uniform over ranges, place within ± 0.4."""
    depth, sigma = rng.uniform(*depth_mm), rng.uniform(*width_mm) / 4.0
    angle, u0 = math.radians(rng.uniform(*angle_deg)), rng.uniform(-0.4, 0.4) * half_length_mm

    def change(u: Floats, v: Floats) -> Floats:
        away = (u - u0) * math.sin(angle) - v * math.cos(angle)
        groove: Floats = -depth * np.exp(-0.5 * (away / sigma) ** 2)
        return groove

    return change


def _shape(form: Form, change: Function | None, pose: Pose, step_mm: float, seed: int) -> GriddedSolid:
    """Sample a form onto a grid in the belt frame."""
    c, s = math.cos(math.radians(pose.yaw_deg)), math.sin(math.radians(pose.yaw_deg))
    # a turned rectangle's bounds, with a margin that the border of the grid needs
    half_x = abs(c) * form.half_length_mm + abs(s) * form.half_width_mm + 2.0 * step_mm
    half_y = abs(s) * form.half_length_mm + abs(c) * form.half_width_mm + 2.0 * step_mm
    columns, rows = math.ceil(half_x / step_mm), math.ceil(half_y / step_mm)
    x, y = np.meshgrid(step_mm * np.arange(-columns, columns + 1), step_mm * np.arange(-rows, rows + 1))
    u, v = c * x + s * y, c * y - s * x
    # far outside nothing depends on it
    q = np.maximum(form.q(u, v), -1.0)
    inside = np.clip(q, 0.0, 1.0)
    dome = form.dome(u, v)
    # an ellipse's height, fuller by `fullness`
    top = dome * np.sqrt(inside * (1.0 + form.fullness * (1.0 - inside)))
    if form.relief_mm > 0.0:
        top = np.maximum(top + _relief_mm(form, seed, u, v) * inside, 0.3 * top)
    if change is not None:
        top = changed(top, inside, change(u, v))
    # beyond the rim the square goes on with the same slope: the outline is smooth
    u_top = np.where(q > 0.0, top**2, dome**2 * q * (1.0 + form.fullness))
    below = form.rim_mm**2
    u_bottom = np.where(q > 0.0, below * (1.0 - (1.0 - inside) ** form.power), form.power * below * q)
    layers = np.stack([np.full_like(q, form.rim_mm), u_top, u_bottom], axis=-1)
    x0, y0 = pose.x_mm - columns * step_mm, pose.y_mm - rows * step_mm
    return GriddedSolid(x0, y0, step_mm, layers)


def _relief_mm(form: Form, seed: int, u: Floats, v: Floats) -> Floats:
    """Relief at places in the food's own frame, so that it moves and turns with the food."""
    from scipy.ndimage import map_coordinates

    pitch = form.relief_period_mm / 5.0
    # a grid of its own in the food's frame, five nodes a period
    rows, columns = (math.ceil(half / pitch) + 3 for half in (form.half_width_mm, form.half_length_mm))
    noise = smooth_noise(np.random.default_rng([seed, 7]), (2 * rows + 1, 2 * columns + 1), 5.0)
    relief: Floats = map_coordinates(noise, [v / pitch + rows, u / pitch + columns], order=3, mode="nearest")
    return form.relief_mm * relief


def _sizes(solid: GriddedSolid, pose: Pose) -> dict[str, float]:
    """Extents of the footprint along and across the product's own frame, to a grid step, and the height."""
    rows, columns = np.nonzero(solid.grid[..., 1] > 0.0)
    x = solid.x0_mm + solid.step_mm * columns.astype(np.float64)
    y = solid.y0_mm + solid.step_mm * rows.astype(np.float64)
    at = math.radians(pose.yaw_deg)
    top = solid.grid[rows, columns, 0] + np.sqrt(solid.grid[rows, columns, 1])
    return {
        "length_mm": float(np.ptp(math.cos(at) * x + math.sin(at) * y)),
        "width_mm": float(np.ptp(math.cos(at) * y - math.sin(at) * x)),
        "thickness_mm": float(top.max()),
    }


class BreadRollOptions(FoodOptions):
    """Options of `bread-roll`."""

    density_g_per_cm3: float = Field(default=0.25, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = kind_shares({"healthy": 0.6, "sunken": 0.2, "split": 0.2})
    length_range_mm: Range = Field(default=(60.0, 95.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(default=(50.0, 75.0), description="range of widths, mm; at most the length")
    thickness_range_mm: Range = Field(default=(30.0, 50.0), description="range of heights, mm; ≤ 0.75 width")


def _make_bread_roll(seed: int, options: BreadRollOptions) -> Drawn:
    rng = random_of(seed, "bread-roll")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), length)
    thickness = min(rng.uniform(*options.thickness_range_mm), 0.75 * width)
    blunt = rng.uniform(2.0, 2.8)
    rim = rng.uniform(0.20, 0.35) * thickness
    a, b = 0.5 * length, 0.5 * width

    def q(u: Floats, v: Floats) -> Floats:
        inner: Floats = 1.0 - np.abs(u / a) ** blunt - np.abs(v / b) ** blunt
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        return np.full_like(u, thickness - rim)

    form = Form(
        a, b, q, dome, rim, power=rng.uniform(3.0, 5.0), fullness=rng.uniform(0.2, 0.6),
        relief_mm=rng.uniform(0.1, 0.3), relief_period_mm=4.0,
    )  # fmt: skip
    change = None
    if kind == "sunken":
        change = dent(rng, (a, b), (4.0, 12.0), (20.0, 40.0))
    if kind == "split":
        change = furrow(rng, a, (3.0, 8.0), (5.0, 12.0), (-25.0, 25.0))
    return drawn(form, change, "none" if change is None else kind, pose, options, seed)


class EggOptions(FoodOptions):
    """Options of `egg`."""

    density_g_per_cm3: float = Field(default=1.03, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = kind_shares({"healthy": 0.8, "dented": 0.2})
    length_range_mm: Range = Field(default=(50.0, 64.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(default=(38.0, 47.0), description="range of widths, mm; ≤ 0.85 length")


def _make_egg(seed: int, options: EggOptions) -> Drawn:
    rng = random_of(seed, "egg")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), 0.85 * length)
    k = float(rng.uniform(0.1, 0.35) * rng.choice([-1.0, 1.0]))
    # the widest place, where the derivative of (1 - s²) (1 + k s) is 0
    s = (math.sqrt(1.0 + 3.0 * k * k) - 1.0) / (3.0 * k)
    most = (1.0 - s * s) * (1.0 + k * s)
    a, b = 0.5 * length, 0.5 * width

    def q(u: Floats, v: Floats) -> Floats:
        at = u / a
        inner: Floats = (1.0 - at**2) * np.maximum(1.0 + k * at, 0.1) / most - (v / b) ** 2
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        return np.full_like(u, b)

    change = dent(rng, (a, b), (1.0, 3.0), (6.0, 15.0)) if kind == "dented" else None
    figures = {"shape_radius_mm": b / math.sqrt(most), "nominal_length_mm": length}
    defect = "none" if change is None else kind
    return drawn(Form(a, b, q, dome, b), change, defect, pose, options, seed, figures)


class FilletOptions(FoodOptions):
    """Options of `fillet`."""

    density_g_per_cm3: float = Field(default=1.05, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = kind_shares({"healthy": 0.7, "gaping": 0.3})
    length_range_mm: Range = Field(default=(75.0, 110.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(default=(30.0, 60.0), description="range of widths, mm; ≤ 0.7 length")
    thickness_range_mm: Range = Field(default=(8.0, 22.0), description="range of heights, mm; ≤ 0.5 width")


def _make_fillet(seed: int, options: FilletOptions) -> Drawn:
    rng = random_of(seed, "fillet")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), 0.7 * length)
    thickness = min(rng.uniform(*options.thickness_range_mm), 0.5 * width)
    head = float(rng.choice([-1.0, 1.0]))
    thin, narrow, blunt = rng.uniform(0.5, 0.75), rng.uniform(0.25, 0.45), rng.uniform(2.2, 3.5)
    rim = rng.uniform(0.06, 0.15) * thickness
    a, b = 0.5 * length, 0.5 * width

    def place(u: Floats) -> Floats:
        return np.clip(head * u / a, -1.0, 1.0)

    def q(u: Floats, v: Floats) -> Floats:
        half = b * (1.0 + narrow * place(u)) / (1.0 + narrow)
        inner: Floats = 1.0 - np.abs(u / a) ** blunt - (v / half) ** 2
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        height: Floats = (thickness - rim) * (1.0 + thin * place(u)) / (1.0 + thin)
        return height

    form = Form(
        a, b, q, dome, rim, power=rng.uniform(2.0, 3.0), fullness=rng.uniform(0.3, 0.9),
        relief_mm=rng.uniform(0.05, 0.15),
    )  # fmt: skip
    change = furrow(rng, a, (2.0, 6.0), (3.0, 8.0), (60.0, 120.0)) if kind == "gaping" else None
    return drawn(form, change, "none" if change is None else kind, pose, options, seed)


class PotatoOptions(FoodOptions):
    """Options of `potato`."""

    density_g_per_cm3: float = Field(default=1.08, gt=0, le=25, description="density, g/cm³")
    kinds: Mapping[str, float] = kind_shares({"healthy": 0.7, "dented": 0.3})
    length_range_mm: Range = Field(default=(55.0, 105.0), description="smallest and largest length, mm")
    width_range_mm: Range = Field(default=(40.0, 70.0), description="range of widths, mm; ≤ 0.9 length")
    thickness_range_mm: Range = Field(
        default=(30.0, 55.0), description="range of heights, mm; 0.6–0.95 width"
    )


def _make_potato(seed: int, options: PotatoOptions) -> Drawn:
    rng = random_of(seed, "potato")
    kind = pick(rng, options.kinds)
    pose = draw_pose(rng, options)
    length = rng.uniform(*options.length_range_mm)
    width = min(rng.uniform(*options.width_range_mm), 0.9 * length)
    thickness = np.clip(rng.uniform(*options.thickness_range_mm), 0.6 * width, 0.95 * width)
    rim = rng.uniform(0.40, 0.50) * thickness
    blunt, thick_end = rng.uniform(2.0, 2.6), rng.uniform(-0.15, 0.15)
    waves, phases = rng.uniform(0.0, 0.02, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    a, b = 0.5 * length, 0.5 * width

    def radius(u: Floats, v: Floats) -> Floats:
        angle = np.arctan2(v / b, u / a)
        lumps = [size * np.cos((k + 2) * angle + phases[k]) for k, size in enumerate(waves)]
        return np.asarray(1.0 + np.sum(lumps, axis=0), dtype=np.float64)

    def q(u: Floats, v: Floats) -> Floats:
        # thicker towards one end, at most as wide as the width
        across = v / (b * (1.0 + thick_end * np.clip(u / a, -1.0, 1.0)) / (1.0 + abs(thick_end)))
        inner: Floats = 1.0 - (np.abs(u / a) ** blunt + np.abs(across) ** blunt) / radius(u, v) ** blunt
        return inner

    def dome(u: Floats, v: Floats) -> Floats:
        slim: Floats = (thickness - rim) * (1.0 + thick_end * np.clip(u / a, -1.0, 1.0))
        return slim

    form = Form(
        1.08 * a, 1.08 * b, q, dome, rim, power=rng.uniform(1.0, 1.4),
        relief_mm=rng.uniform(0.1, 0.3), relief_period_mm=4.0,
    )  # fmt: skip
    change = dent(rng, (a, b), (2.0, 6.0), (8.0, 25.0)) if kind == "dented" else None
    return drawn(form, change, "none" if change is None else kind, pose, options, seed)


FOODS = (
    ProductFamily("potato", "potatoes, healthy and dented", PotatoOptions, _make_potato),
    ProductFamily("fillet", "fish fillets, healthy and gaping", FilletOptions, _make_fillet),
    ProductFamily("bread-roll", "bread rolls, healthy, sunken and split", BreadRollOptions, _make_bread_roll),
    ProductFamily("egg", "eggs on their side, healthy and dented", EggOptions, _make_egg),
)
"""All of them, as families."""
