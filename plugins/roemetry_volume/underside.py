"""From visible to true volume: what a recipe says of the underside, which no camera above can see.

Model. The true volume is the visible one, a share of it, or what an even gap below the footprint leaves
(`true_volume`). Assumed: share or gap are the same for all products but for a scatter. It fails for products
that lie otherwise than those which told the share, and nothing in an image shows it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from roemetry.records import Estimate, Reason
from roemetry.stages import StageOptions


class UndersideOptions(StageOptions):
    """What is known of the product's underside."""

    about_product: ClassVar[frozenset[str]] = frozenset(
        ("underside", "true_share", "true_share_std", "gap_mm", "gap_std_mm")
    )

    underside: Literal["unknown", "assumed", "flat", "rounded", "air-gap"] = Field(
        default="unknown",
        description="model of the underside; unknown: none is stated; assumed: between ball and flat",
    )
    true_share: float | None = Field(
        default=None,
        ge=0.1,
        le=1.0,
        description="rounded: true over visible volume, fitted to weighed samples",
    )
    true_share_std: float | None = Field(
        default=None, gt=0.0, le=0.5, description="rounded: scatter of that share from product to product"
    )
    gap_mm: float | None = Field(
        default=None, ge=0.0, le=100.0, description="air-gap: mean height of the air below the product, mm"
    )
    gap_std_mm: float | None = Field(
        default=None, gt=0.0, le=100.0, description="air-gap: scatter of that from product to product, mm"
    )

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        for model, names in _NEEDS.items():
            given = [name for name in names if getattr(self, name) is not None]
            if self.underside == model and len(given) < len(names):
                raise ValueError(f"underside: {model} needs {' and '.join(names)}")
            if self.underside != model and given:
                raise ValueError(f"{given[0]} belongs to underside: {model}, which is {self.underside}")
        return self


_NEEDS: dict[str, tuple[str, ...]] = {
    "rounded": ("true_share", "true_share_std"),
    "air-gap": ("gap_mm", "gap_std_mm"),
}


_BALL_SHARE = 0.8
"""True over visible volume of a ball on the belt, (4/3) / (5/3); a flat underside has 1."""
_ASSUMED = Reason(
    "underside-assumed",
    "the underside was not measured: it is taken to lie anywhere between that of a ball and a flat one, "
    "80 to 100 % of the visible volume; weigh twenty products and fit (`roemetry fit-weight`)",
)


def underside_reasons(options: UndersideOptions) -> tuple[Reason, ...]:
    """Say that the true volume rests on an assumption, if it does."""
    return (_ASSUMED,) if options.underside == "assumed" else ()


def true_volume(
    options: UndersideOptions, visible: Estimate, footprint_mm2: float, rng: np.random.Generator | None = None
) -> Estimate | None:
    """Take the air below the product off the visible volume.

    Flat: true = visible. Rounded: true = share · visible. Air gap: true = visible − gap · footprint. Assumed:
    a share with an even distribution between that of a ball and 1 (JCGM 100, 4.3.7).

    Parameters
    ----------
    options
        The model and its numbers.
    visible
        Visible volume, mm³; drawn already where `rng` is given.
    footprint_mm2
        Area of the vertical footprint.
    rng
        Draws the share or the gap of this product.

    Returns
    -------
    Estimate or None
        mm³, with the visible volume's budget and the cause ``underside``; None where the underside is
        unknown. NaN where more air than product would result.
    """
    factor, off_mm3, std_mm3 = 1.0, 0.0, 0.0
    if options.underside == "unknown":
        return None
    if options.underside == "assumed":
        # even between both shares: their mean, and their difference over √12
        factor = 0.5 * (_BALL_SHARE + 1.0)
        std_mm3 = (1.0 - _BALL_SHARE) / math.sqrt(12.0) * visible.value
    elif options.underside == "rounded":
        assert options.true_share is not None
        assert options.true_share_std is not None
        factor, std_mm3 = options.true_share, options.true_share_std * visible.value
    elif options.underside == "air-gap":
        assert options.gap_mm is not None
        assert options.gap_std_mm is not None
        off_mm3, std_mm3 = options.gap_mm * footprint_mm2, options.gap_std_mm * footprint_mm2
    value = factor * visible.value - off_mm3
    if rng is not None and std_mm3 > 0.0:
        value += std_mm3 * rng.standard_normal()
    # there cannot be less than no air
    value = min(value, visible.value)
    if not value > 0.0:
        return Estimate(math.nan)
    return estimate_of(value, {cause: factor * part for cause, part in visible.budget.items()}, std_mm3)


def estimate_of(value: float, budget: Mapping[str, float], underside: float = 0.0) -> Estimate:
    """Give an estimate whose standard uncertainty is the quadrature of its budget."""
    causes = dict(budget) | ({"underside": underside} if underside > 0.0 else {})
    std = math.sqrt(sum(part * part for part in causes.values()))
    return Estimate(value, std if std > 0.0 else math.nan, causes)


def fitted_share(visible_mm3: ArrayLike, true_mm3: ArrayLike) -> tuple[float, float]:
    """Give `true_share` and `true_share_std` of a product type from weighed samples.

    Parameters
    ----------
    visible_mm3, true_mm3 : array_like
        Visible volumes as measured, and true ones (mass over density), mm³, of at least three samples.

    Returns
    -------
    share, std : float
        The sum of the true over that of the visible volumes; and how far a product's own share may lie from
        it: the ratios' standard deviation, or their 95 % point over 1.96 where that is more (a hidden gap
        under some products makes a long tail), with what so few samples leave open in the share itself.
    """
    visible, true = np.asarray(visible_mm3, np.float64), np.asarray(true_mm3, np.float64)
    if visible.size < 3 or visible.shape != true.shape or not (visible > 0.0).all():
        raise ValueError("at least three samples with positive visible volumes are needed")
    share = float(true.sum() / visible.sum())
    off = np.abs(true / visible - share)
    scatter = max(float(np.sqrt((off**2).sum() / (off.size - 1))), float(np.quantile(off, 0.95)) / 1.96)
    return share, scatter * math.sqrt(1.0 + 1.0 / off.size)
