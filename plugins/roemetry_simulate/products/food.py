"""What the foods share: options, and bodies with a rim, a dome above it and a rounded underside.

In a food's own frame, u along and v across, the footprint is where q(u, v) > 0; q is 1 at the ridge. The top
stands over the rim by dome(u, v) · sqrt(q (1 + fullness (1 - q))) with a fine relief, the underside below it
by rim · sqrt(1 - (1 - q)^power): power 1 is half an ellipse, a higher one is flatter. The lowest point lies
on the belt.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from roemetry_simulate.defects import changed
from roemetry_simulate.products.family import Drawn, Pose, ProductOptions, check_shares, describe
from roemetry_simulate.solid import GriddedSolid
from roemetry_simulate.surface import smooth_noise

Floats = NDArray[np.float64]
Function = Callable[[Floats, Floats], Floats]


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 < limits[0] <= limits[1]:
        raise ValueError("a range goes from a positive number to one that is not smaller")
    return limits


Range = Annotated[tuple[float, float], AfterValidator(_ordered)]


class FoodOptions(ProductOptions):
    """Options that all foods share."""

    known_kinds: ClassVar[tuple[str, ...]] = ("healthy",)

    kinds: Mapping[str, float] = Field(
        description="kinds that are drawn, each with its share; need not sum to 1"
    )
    length_range_mm: Range = Field(description="smallest and largest length, mm")
    width_range_mm: Range = Field(description="smallest and largest width, mm")
    turn_range_deg: float = Field(default=15.0, ge=0, le=180, description="turned by up to this, degrees")
    offset_range_x_mm: float = Field(
        default=5.0, ge=0, le=5000, description="off centre along X by up to, mm"
    )
    offset_range_y_mm: float = Field(
        default=6.0, ge=0, le=5000, description="off centre along Y by up to, mm"
    )
    grid_step_mm: float = Field(default=0.25, ge=0.02, le=5, description="pitch of the body's grid, mm")

    @model_validator(mode="after")
    def _kinds_are_known(self) -> Self:
        check_shares(self.kinds, self.known_kinds)
        return self


@dataclass(frozen=True, eq=False)
class Form:
    """A food's shape in its own frame.

    Attributes
    ----------
    half_length_mm, half_width_mm : float
        The footprint lies within these.
    q : callable
        Of (u, v) in mm: above 0 on the footprint, falling through 0 at its edge.
    dome : callable
        Of (u, v) in mm: height of the ridge over the rim, mm.
    rim_mm : float
        Height of the widest line over the belt.
    power, fullness : float
        Roundness of underside and top.
    relief_mm, relief_period_mm : float
        Standard deviation of the relief, and the length over which it changes.
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

    Parameters
    ----------
    form : Form
        Its shape without a defect.
    change : callable or None
        Of (u, v) in mm: what the defect adds to the top, mm; None for a healthy one.
    defect : str
        The defect's name, or ``none``.
    pose : Pose
        Where it lies.
    options : FoodOptions
        Grid pitch and density.
    seed : int
        Of the relief.
    figures : mapping or None
        Further numbers for the truth, after the sizes.

    Returns
    -------
    Drawn
        The reference is the solid itself for a healthy one.
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
    q = np.maximum(form.q(u, v), -1.0)
    inside = np.clip(q, 0.0, 1.0)
    dome = form.dome(u, v)
    top = dome * np.sqrt(inside * (1.0 + form.fullness * (1.0 - inside)))
    if form.relief_mm > 0.0:
        top = np.maximum(top + _relief_mm(form, seed, u, v) * inside, 0.3 * top)
    if change is not None:
        top = changed(top, inside, change(u, v))
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
