"""A family of products: options, draws, poses, the truth of one, its outline."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from roemetry.records.truth import ProductTruth
from roemetry_simulate.solid import Solid


class ProductOptions(BaseModel):
    """Options that all families share: how a product lies, and what it weighs.

    A family's own options derive from it and set their own defaults.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    density_g_per_cm3: float = Field(
        default=1.0, gt=0, le=25, description="density of the closed body, g/cm³"
    )
    turn_range_deg: float = Field(
        default=0.0, ge=0, le=180, description="turned from belt X by up to this, either way, degrees"
    )
    offset_range_x_mm: float = Field(
        default=0.0,
        ge=0,
        le=5000,
        description="middle off the belt's origin by up to this along X, either way, mm",
    )
    offset_range_y_mm: float = Field(
        default=0.0,
        ge=0,
        le=5000,
        description="middle off the belt's origin by up to this along Y, either way, mm",
    )


@dataclass(frozen=True, eq=False)
class Drawn:
    """One product on the belt, with what is true of it.

    Attributes
    ----------
    solid : Solid
        The body, in the belt frame.
    truth : ProductTruth
        Its class, defect, volumes (mm³), mass (g), and further figures, units in their names.
    reference : Solid or None
        The same product, in the same place, without its defect; None where there is no such thing. What the
        stripes show of the defect follows from both, see `roemetry_simulate.truth.stripes_show`.
    """

    solid: Solid
    truth: ProductTruth
    reference: Solid | None = None


class Pose(NamedTuple):
    """Where a product's own origin lies on the belt (mm), and its own x axis from belt X (degrees)."""

    x_mm: float
    y_mm: float
    yaw_deg: float


@dataclass(frozen=True, eq=False)
class ProductFamily:
    """A kind of product that can be drawn.

    Attributes
    ----------
    name : str
        What recipes and command lines call it.
    summary : str
        One line that says what it is.
    Options : type of ProductOptions
        Its options: frozen, described, bounded.
    make : callable
        Makes the product of a seed and options; `draw` is its checked front.
    """

    name: str
    summary: str
    Options: type[ProductOptions]
    make: Callable[[int, Any], Drawn]

    def draw(self, seed: int, options: ProductOptions | None = None) -> Drawn:
        """Draw a product.

        Parameters
        ----------
        seed : int
            0 or more; the same seed and options give the same product.
        options : ProductOptions or None
            Of this family's `Options`; None is the defaults.

        Returns
        -------
        Drawn
            In the belt frame.
        """
        if seed < 0:
            raise ValueError(f"a seed is 0 or more, not {seed}")
        options = self.Options() if options is None else options
        if not isinstance(options, self.Options):
            raise TypeError(f"{self.name} takes {self.Options.__name__}, not {type(options).__name__}")
        return self.make(seed, options)


def random_of(seed: int, family: str) -> np.random.Generator:
    """Return a family's own source of random numbers for a seed."""
    return np.random.default_rng([seed, *family.encode()])


def draw_pose(rng: np.random.Generator, options: ProductOptions) -> Pose:
    """Draw where a product lies, uniformly over the ranges of the options."""
    x, y, yaw = rng.uniform(-1.0, 1.0, 3)
    return Pose(
        float(x * options.offset_range_x_mm),
        float(y * options.offset_range_y_mm),
        float(yaw * options.turn_range_deg),
    )


def pick(rng: np.random.Generator, shares: Mapping[str, float]) -> str:
    """Draw a kind in the given shares, which need not sum to 1."""
    names = [name for name, share in shares.items() if share > 0.0]
    weights = np.array([shares[name] for name in names])
    return str(rng.choice(names, p=weights / weights.sum()))


def check_shares(shares: Mapping[str, float], kinds: tuple[str, ...]) -> None:
    """Refuse shares of unknown kinds, negative shares, and shares without a positive one."""
    unknown = [kind for kind in shares if kind not in kinds]
    if unknown:
        raise ValueError(f"no kind is called {unknown[0]!r}; there are {', '.join(kinds)}")
    if not all(math.isfinite(share) and share >= 0.0 for share in shares.values()):
        raise ValueError("a share is 0 or more")
    if not any(share > 0.0 for share in shares.values()):
        raise ValueError("at least one kind needs a share above 0")


def describe(
    solid: Solid, options: ProductOptions, defect: str = "none", figures: Mapping[str, float] | None = None
) -> ProductTruth:
    """Write down what is true of a product.

    Parameters
    ----------
    solid : Solid
        The product.
    options : ProductOptions
        Its density is taken.
    defect : str
        What is wrong with it, or ``none``; that also makes the label, ``henkei`` or ``good``.
    figures : mapping or None
        Further numbers, after the footprint, the extent of the footprint and the greatest height.

    Returns
    -------
    ProductTruth
        Volumes in mm³, mass in g.
    """
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    return ProductTruth(
        label="good" if defect == "none" else "henkei",
        defect=defect,
        visible_mm3=float(solid.visible_volume_mm3),
        true_mm3=float(solid.true_volume_mm3),
        mass_g=float(solid.true_volume_mm3) * 1e-3 * options.density_g_per_cm3,
        figures={
            "footprint_mm2": float(solid.footprint_mm2),
            "x_min_mm": x_min,
            "x_max_mm": x_max,
            "y_min_mm": y_min,
            "y_max_mm": y_max,
            **(figures or {}),
        },
    )


Floats = NDArray[np.float64]

_HALVINGS = 30


def outline_mm(solid: Solid, step_mm: float = 0.5) -> Floats:
    """Find the border of a solid's footprint; of several pieces, the longest border.

    Parameters
    ----------
    solid : Solid
        Anything on the belt; what is thinner than a step may be missed.
    step_mm : float
        Distance of the places that are looked at; neighbours on the outline lie about as far apart.

    Returns
    -------
    ndarray, shape (n, 2)
        (x, y) in the belt frame, millimetres, counter-clockwise seen from above, not closed by a repeated
        point. Each lies on the border to 1e-6 mm, searched at right angles to it; corners are cut by up to
        a step. Shape (0, 2) for nothing.
    """
    import cv2

    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    if not np.isfinite(x_min):
        return np.empty((0, 2))
    x = np.arange(x_min - 3.0 * step_mm, x_max + 3.0 * step_mm, step_mm)
    y = np.arange(y_min - 3.0 * step_mm, y_max + 3.0 * step_mm, step_mm)
    inside = np.isfinite(solid.heights_mm(*np.meshgrid(x, y))[0])
    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return np.empty((0, 2))
    columns, rows = max(contours, key=len)[:, 0, :].T
    soft = cv2.GaussianBlur(inside.astype(np.float64), (0, 0), 1.5)
    down_y, down_x = (-slope[rows, columns] for slope in np.gradient(soft))
    length = np.maximum(np.hypot(down_x, down_y), 1e-12)
    start = np.stack([x[columns], y[rows]], axis=1)
    away = np.stack([down_x, down_y], axis=1) / length[:, None]
    near, far = np.zeros(len(start)), np.full(len(start), 3.0 * step_mm)
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        place = start + middle[:, None] * away
        is_in = np.isfinite(solid.heights_mm(place[:, 0], place[:, 1])[0])
        near, far = np.where(is_in, middle, near), np.where(is_in, far, middle)
    border: Floats = start + near[:, None] * away
    u, v = border.T
    turning = float(np.sum(u * np.roll(v, -1) - v * np.roll(u, -1)))
    return border if turning >= 0.0 else np.ascontiguousarray(border[::-1])
