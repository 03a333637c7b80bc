"""Mass as volume times one density (section 4).

Model. m = ρ V. The true volume is taken where the estimator knows it; else the visible one stands for it, and
a reason says so: air below the product then weighs as much as roe.

The mass has a standard uncertainty only if the volume's is stated and the density's is given. Then, for
independent causes, u² = (ρ·u_V)² + (V·u_ρ)² (JCGM 100, 5.1.2), with the volume's budget carried over cause by
cause, in grams, and the density's part added to it.

Assumed: all products have one density. It fails where the visible volume holds much air: `fitted` learns that
from weighed products.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from roemetry.records import Estimate, Product, Reason, Volume, Weight
from roemetry.records.units import mm3_to_cm3
from roemetry.stages import StageOptions, Weigher


class DensityOptions(StageOptions):
    """Options of `Density`."""

    density_g_per_cm3: float = Field(
        default=1.1, gt=0.0, le=30.0, description="g/cm³; 1.1 is what the paper takes for herring roe"
    )
    density_std_g_per_cm3: float | None = Field(
        default=None,
        ge=0.0,
        le=30.0,
        description="g/cm³, standard uncertainty of the density; not given: the mass's is not stated",
    )


class Density(Weigher[DensityOptions]):
    """Multiplies volume by density, 1.1 g/cm³ for herring roe (Lee et al. 2000, section 4 and Table 1)."""

    @property
    def states_model_error(self) -> bool:
        """Whether the density's standard uncertainty is given."""
        return self.options.density_std_g_per_cm3 is not None

    def weigh(self, product: Product, volume: Volume, *, rng: np.random.Generator | None = None) -> Weight:
        """Reckon the mass; given `rng`, draw the density from a normal distribution if its std is given."""
        chosen = volume.visible_mm3 if volume.true_mm3 is None else volume.true_mm3
        reasons: tuple[Reason, ...] = (_VISIBLE_FOR_TRUE,) if volume.true_mm3 is None else ()
        if math.isnan(chosen.value):
            reasons = volume.reasons  # they say why there is none
        density, density_std = self.options.density_g_per_cm3, self.options.density_std_g_per_cm3
        volume_cm3 = mm3_to_cm3(chosen.value)
        # a Monte Carlo draw: the spread of the draws is the uncertainty
        if rng is not None and density_std is not None:
            return Weight(Estimate(volume_cm3 * rng.normal(density, density_std)), reasons)
        # a mass with a part of its uncertainty would look better known than it is
        if density_std is None or not math.isfinite(chosen.std):
            return Weight(Estimate(volume_cm3 * density), reasons)
        from_volume = mm3_to_cm3(chosen.std) * density
        from_density = abs(volume_cm3) * density_std
        budget = {cause: mm3_to_cm3(part) * density for cause, part in chosen.budget.items()}
        return Weight(
            Estimate(
                value=volume_cm3 * density,
                std=math.hypot(from_volume, from_density),
                # a volume with an uncertainty but no budget is one cause
                budget={**(budget or {"volume": from_volume}), "density": from_density},
            ),
            reasons,
        )


_VISIBLE_FOR_TRUE = Reason(
    "visible-taken-for-true",
    "the visible volume is weighed as if it were the true one; air below the product counts as product",
)
