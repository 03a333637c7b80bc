"""The weigher `scale`: the mass that the line's own scale gave."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry.calibrating.known_products import read_weights
from roemetry.errors import StageError
from roemetry.records import Estimate, Product, Reason, Volume, Weight
from roemetry.records.units import mm3_to_cm3
from roemetry.stages import Capabilities, StageOptions, Weigher


class ScaleOptions(StageOptions):
    """Options of `Scale`."""

    masses: Path = Field(description="table (CSV) with the columns `id` and `mass_g`; relative to the recipe")
    std_g: float | None = Field(
        default=None,
        gt=0.0,
        le=100_000.0,
        description="g, standard uncertainty of the scale; not given: the mass's is not stated",
    )


class Scale(Weigher[ScaleOptions]):
    """Reads the mass from a table; its features are the specific volume and the density.

    The specific volume is volume over mass, ml/g, with the true volume where the estimator knows it, else
    the visible one, and a reason that says so.
    """

    capabilities = Capabilities(fixture="roemetry_files.scale:scale_options")
    expected_failures: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "check_mass_is_proportional_to_volume": "the mass comes from a scale, whatever the volume",
        }
    )

    @property
    def states_model_error(self) -> bool:
        """Whether the scale's standard uncertainty is given."""
        return self.options.std_g is not None

    @cached_property
    def _masses(self) -> dict[str, float]:
        return {name: one.mass_g for name, one in read_weights(self.options.masses).items()}

    def weigh(self, product: Product, volume: Volume, *, rng: np.random.Generator | None = None) -> Weight:
        """Look the mass up by the id of product or acquisition; given `rng`, draw the scale's error."""
        names = (f"{product.acquisition_ids[0]}#{product.number}", product.acquisition_ids[0])
        mass = next((self._masses[name] for name in names if name in self._masses), math.nan)
        if math.isnan(mass):
            raise StageError(
                f"{self.options.masses.name} has no mass of {names[0]}",
                hint=f"write a line `{names[0]},MASS`; `{names[1]}` does where an image shows one product",
            )
        std = self.options.std_g
        if rng is not None and std is not None:
            mass += float(rng.normal(0.0, std))
        chosen = volume.visible_mm3 if volume.true_mm3 is None else volume.true_mm3
        if not chosen.value > 0.0:
            raise StageError(
                "there is no volume beside the mass; which product it is of cannot be told",
                hint="see why the volume is missing",
            )
        specific = mm3_to_cm3(chosen.value) / mass if mass > 0.0 else math.nan
        estimate = Estimate(mass) if std is None or rng is not None else Estimate(mass, std, {"scale": std})
        return Weight(
            estimate,
            (_VISIBLE_FOR_TRUE,) if volume.true_mm3 is None else (),
            {"specific_volume_ml_per_g": specific},
        )


_VISIBLE_FOR_TRUE = Reason(
    "specific-volume-visible",
    "the specific volume is that of the visible volume; air below the product counts as product",
)


def scale_options() -> ScaleOptions:
    """Write the mass of the product that the kit weighs; give the options to find it."""
    path = Path(tempfile.mkdtemp()) / "masses.csv"
    path.write_text("id,mass_g\nscene,10.5\n", encoding="utf-8")
    return ScaleOptions(masses=path, std_g=0.1)
