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

Floats = NDArray[np.float64]


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


_LEAST_SHARE = 0.12


def changed(height_mm: Floats, inside: Floats, change_mm: Floats) -> Floats:
    """Add a change to a dome, within what a body with a rim can take.

    Parameters
    ----------
    height_mm, inside : ndarray, shape (rows, columns)
        See `deform`.
    change_mm : ndarray, shape (rows, columns)
        What to add, negative in a hollow.

    Returns
    -------
    ndarray, shape (rows, columns)
        Dome over the rim, millimetres.
    """
    # the change dies out at the rim, where the outline is
    change = change_mm * (1.0 - (1.0 - np.clip(inside / 0.35, 0.0, 1.0)) ** 2)
    share = 1.0 + change / np.maximum(height_mm, 1e-9) - _LEAST_SHARE
    # no deeper than a small share of the dome, approached smoothly
    share = _LEAST_SHARE + 0.5 * (share + np.hypot(share, 0.15))
    return np.where(change == 0.0, height_mm, share * height_mm)
