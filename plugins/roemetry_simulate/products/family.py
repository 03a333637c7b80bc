"""A family of products: options, draws, poses, the truth of one, its outline."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roemetry.records.truth import ProductTruth
from roemetry_simulate.solid import Solid

Floats = NDArray[np.float64]


class ProductOptions(BaseModel):
    """Options that all families share: how a product lies, and what it weighs.

    A family's own options derive from it and set their own defaults.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    density_g_per_cm3: float = Field(default=1.0, gt=0, le=25, description="of the closed body, g/cm³")
    turn_range_deg: float = Field(default=0.0, ge=0, le=180, description="turned by up to this, degrees")
    offset_range_x_mm: float = Field(default=0.0, ge=0, le=5000, description="off centre in X by up to, mm")
    offset_range_y_mm: float = Field(default=0.0, ge=0, le=5000, description="off centre in Y by up to, mm")


def kind_shares(shares: Mapping[str, float]) -> Any:
    """Describe an option `kinds`: these are its default, and all the kinds there are."""
    about = "kinds that are drawn, each with its share; need not sum to 1"
    return Field(default_factory=lambda: dict(shares), description=about)


class PopulationOptions(ProductOptions):
    """Options that populations share: which kinds are drawn, and how they are strewn."""

    kinds: Mapping[str, float] = kind_shares({"healthy": 1.0})
    turn_range_deg: float = Field(default=15.0, ge=0, le=180, description="turned by up to this, degrees")
    offset_range_x_mm: float = Field(default=5.0, ge=0, le=5000, description="off centre in X by up to, mm")
    offset_range_y_mm: float = Field(default=6.0, ge=0, le=5000, description="off centre in Y by up to, mm")

    @model_validator(mode="after")
    def _kinds_are_known(self) -> Self:
        known = type(self).model_fields["kinds"].get_default(call_default_factory=True)
        unknown = [kind for kind in self.kinds if kind not in known]
        if unknown:
            raise ValueError(f"no kind is called {unknown[0]!r}; there are {', '.join(known)}")
        if not all(math.isfinite(share) and share >= 0.0 for share in self.kinds.values()):
            raise ValueError("a share is 0 or more")
        if not any(share > 0.0 for share in self.kinds.values()):
            raise ValueError("at least one kind needs a share above 0")
        return self


@dataclass(frozen=True, eq=False)
class Drawn:
    """One product on the belt, with what is true of it.

    - `solid`: The body, in the belt frame.
    - `truth`: Its class, defect, volumes (mm³), mass (g), and further figures, units in their names.
    - `reference`: The same product, in the same place, without its defect; None where there is no such thing.
      What the stripes show of the defect follows from both, see `roemetry_simulate.ray_caster.stripes_show`.
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

    - `name`: What recipes and command lines call it.
    - `summary`: One line that says what it is.
    - `Options`: Its options: frozen, described, bounded.
    - `make`: Makes the product of a seed and options; `draw` is its checked front.
    """

    name: str
    summary: str
    Options: type[ProductOptions]
    make: Callable[[int, Any], Drawn]

    def draw(self, seed: int, options: ProductOptions | None = None) -> Drawn:
        """Draw the product of a seed, 0 or more; the same seed and options give the same product."""
        if seed < 0:
            raise ValueError(f"a seed is 0 or more, not {seed}")
        options = self.Options() if options is None else options
        if not isinstance(options, self.Options):
            raise TypeError(f"{self.name} takes {self.Options.__name__}, not {type(options).__name__}")
        return self.make(seed, options)


def random_of(seed: int, family: str) -> np.random.Generator:
    """Return a family's own source of random numbers for a seed."""
    # by the name, so that a family's draws do not depend on others'
    return np.random.default_rng([seed, *family.encode()])


def draw_pose(rng: np.random.Generator, options: ProductOptions) -> Pose:
    """Draw where a product lies, uniformly over the ranges of the options."""
    x, y, yaw = rng.uniform(-1.0, 1.0, 3)
    ranges = options.offset_range_x_mm, options.offset_range_y_mm, options.turn_range_deg
    return Pose(*(float(share * most) for share, most in zip((x, y, yaw), ranges, strict=True)))


def pick(rng: np.random.Generator, shares: Mapping[str, float]) -> str:
    """Draw a kind in the given shares, which need not sum to 1."""
    names = [name for name, share in shares.items() if share > 0.0]
    weights = np.array([shares[name] for name in names])
    return str(rng.choice(names, p=weights / weights.sum()))


def describe(
    solid: Solid, options: ProductOptions, defect: str = "none", figures: Mapping[str, float] | None = None
) -> ProductTruth:
    """Write down what is true of a product: volumes in mm³, mass in g by the options' density.

    A defect other than ``none`` makes the label ``henkei``, else ``good``. Further figures stand after the
    footprint and its extent.
    """
    ends = ("x_min_mm", "x_max_mm", "y_min_mm", "y_max_mm")
    at = dict(zip(ends, solid.footprint_extent_mm(), strict=True))
    return ProductTruth(
        label="good" if defect == "none" else "henkei",
        defect=defect,
        visible_mm3=float(solid.visible_volume_mm3),
        true_mm3=float(solid.true_volume_mm3),
        mass_g=float(solid.true_volume_mm3) * 1e-3 * options.density_g_per_cm3,
        figures={"footprint_mm2": float(solid.footprint_mm2), **at, **(figures or {})},
    )


_LEAST_SHARE = 0.12
"""Of a dome that the deepest defect leaves: the body stays closed over its underside."""


def changed(height_mm: Floats, inside: Floats, change_mm: Floats) -> Floats:
    """Add a change (mm, negative in a hollow) to a dome over the rim, within what a body can take.

    `inside` is 1 on the ridge and 0 at the rim and beyond; all of shape (rows, columns).
    """
    # the change dies out at the rim, where the outline is
    change = change_mm * (1.0 - (1.0 - np.clip(inside / 0.35, 0.0, 1.0)) ** 2)
    # least share subtracted first, so that what is smoothed goes to 0 there
    share = 1.0 + change / np.maximum(height_mm, 1e-9) - _LEAST_SHARE
    # no deeper than a small share of the dome, approached smoothly
    share = _LEAST_SHARE + 0.5 * (share + np.hypot(share, 0.15))
    return np.where(change == 0.0, height_mm, share * height_mm)
