"""What a grade table may ask about: weight, volume, features of shape, features of the outline."""

from __future__ import annotations

import math
from collections.abc import Mapping

from roemetry.records import Estimate, Grade, Product, Volume, Weight
from roemetry.units import mm3_to_cm3

WEIGHT, VISIBLE, TRUE = "weight_g", "visible_volume_cm3", "true_volume_cm3"


def needed_for(name: str) -> str:
    """Name the kind of stage that gives a quantity; "" where several may."""
    return {WEIGHT: "weigher", VISIBLE: "volume", TRUE: "volume"}.get(name, "")


class Quantities:
    """A product's quantities by name, with their standard uncertainties.

    Attributes
    ----------
    grade
        The shape; None where there is none.
    without_std
        Quantities that were asked for and have no uncertainty, in the order in which they were.
    """

    def __init__(
        self,
        product: Product,
        volume: Volume | None,
        weight: Weight | None,
        grade: Grade | None,
        stated: Mapping[str, float],
    ) -> None:
        self.grade = grade
        self.without_std: list[str] = []
        self._stated = stated
        self._estimates = _estimates(volume, weight)
        self._features = {} if product.outline is None else dict(product.outline.features)
        self._features |= {} if weight is None else weight.features
        self._features |= {} if grade is None else grade.features
        self._features_std = {} if grade is None else grade.features_std

    def value(self, name: str) -> float:
        """Give a quantity, in the unit its name says; NaN where there is none."""
        if name in self._estimates:
            return self._estimates[name].value
        return self._features.get(name, math.nan)

    def std(self, name: str) -> float:
        """Give its standard uncertainty: what the run states, else what the table does, else NaN."""
        estimate = self._estimates.get(name)
        found = self._features_std.get(name, math.nan) if estimate is None else estimate.std
        if math.isnan(found):
            found = self._stated.get(name, math.nan)
        if math.isnan(found) and name not in self.without_std and not math.isnan(self.value(name)):
            self.without_std.append(name)
        return found

    def why_missing(self, name: str) -> str:
        """Say that a quantity is not there, and what is."""
        if needed_for(name) or name in self._features:
            return f"{name} could not be measured"
        known = ", ".join(sorted([*self._estimates, *self._features]))
        return f"there is no {name}; there are {known}"


def _estimates(volume: Volume | None, weight: Weight | None) -> dict[str, Estimate]:
    found = {}
    if weight is not None:
        found[WEIGHT] = weight.mass_g
    if volume is not None:
        found[VISIBLE] = _in_cm3(volume.visible_mm3)
        if volume.true_mm3 is not None:
            found[TRUE] = _in_cm3(volume.true_mm3)
    return found


def _in_cm3(estimate: Estimate) -> Estimate:
    return Estimate(mm3_to_cm3(estimate.value), mm3_to_cm3(estimate.std))
