"""Classes by limits on features, one after another.

Model. Each limit says which class a product is of whose feature lies above `at_most` or below `at_least`.
Going down the list, the first limit that is broken names the class; a product that breaks none is good. A
class that two standard uncertainties of one feature would change is `unknown`; features whose uncertainty is
not stated are taken as exact.

Assumed: each defect shows in one feature alone, and its limit does not depend on the others. It fails where
features must be weighed together, as a bend that is harmless in a long product: then `fuzzy-rules` or
`learned`. A feature that cannot be measured (NaN) breaks no limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from roemetry.records import Grade, Product, Reason, Relief
from roemetry.stages import Classifier, StageOptions
from roemetry_shape.features import SMOOTHING_MM, shape_features, shape_of
from roemetry_shape.product_frame import decisive_feature

UNKNOWN = "unknown"
_FEW = "fewer than three stripes show a cross-section: there is no shape to judge"


class Limit(BaseModel):
    """One limit: a product beyond it is of this class."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    feature: str = Field(description="name of the feature")
    at_most: float | None = Field(default=None, ge=-1e9, le=1e9, description="beyond this, in its unit")
    at_least: float | None = Field(default=None, ge=-1e9, le=1e9, description="or below this")
    label: str = Field(min_length=1, description="class of a product beyond the limit")

    @model_validator(mode="after")
    def _limits(self) -> Limit:
        if self.at_most is None and self.at_least is None:
            raise ValueError(f"the limit on {self.feature} has neither at_most nor at_least")
        return self


class ShapeLimitsOptions(StageOptions):
    """Options of `ShapeLimits`."""

    smoothing_mm: float = Field(
        default=SMOOTHING_MM, ge=0.0, le=50.0, description="window that smooths each curve first, mm; 0: none"
    )
    limits: tuple[Limit, ...] = Field(
        default=(),
        description="the first broken one wins: `feature`, `at_most`, `at_least`, `label`",
    )
    good: str = Field(default="good", min_length=1, description="class of a product within all limits")


class ShapeLimits(Classifier[ShapeLimitsOptions]):
    """Calls a product by the first limit that one of its shape features breaks; good if none is broken.

    Without limits it measures the features and answers ``unknown``: the way to see what they are.
    """

    def classify(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Judge by limits; `rng` is not used: limits do not err."""
        del rng
        return self.judge(shape_features(product, self.options.smoothing_mm))

    def relief(self, product: Product) -> Relief | None:
        """Give the surface that the features were read off."""
        return shape_of(product, self.options.smoothing_mm).relief

    def judge(self, features: Mapping[str, float]) -> Grade:
        """Judge features that were measured already."""
        if not features:
            return Grade(UNKNOWN, reasons=(Reason("too-few-sections", _FEW),))
        if not self.options.limits:
            # a product that was compared with nothing is not good
            return Grade(UNKNOWN, features=features, reasons=(Reason("no-limits", "no limits are given"),))
        used = set()
        # limits after the first broken one cannot change the class, so what they name may be missing
        for limit in self.options.limits:
            if limit.feature not in features:
                known = ", ".join(sorted(features))
                why = f"there is no feature {limit.feature}; there are {known}"
                return Grade(UNKNOWN, features=features, reasons=(Reason("no-such-feature", why),))
            used.add(limit.feature)
            if _broken(limit, features[limit.feature]):
                break
        label, reason = self._called(features)
        # a value within its uncertainty of a limit could as well be of the other class
        doubt = decisive_feature(features, used, label, lambda other: self._called(other)[0])
        if doubt is not None:
            return Grade(UNKNOWN, features=features, reasons=(doubt,))
        return Grade(label, features=features, reasons=(reason,))

    def _called(self, features: Mapping[str, float]) -> tuple[str, Reason]:
        """Give the class of features, up to the first limit that is broken all there, and why."""
        for limit in self.options.limits:
            broken = _broken(limit, features.get(limit.feature, math.nan))
            if broken:
                return limit.label, Reason("limit-broken", broken)
        count = len(self.options.limits)
        return self.options.good, Reason(
            "within-limits", f"within {count} {'limit' if count == 1 else 'limits'}"
        )


def _broken(limit: Limit, value: float) -> str:
    # NaN breaks no limit, as every comparison with it is false
    if math.isnan(value):
        return ""
    if limit.at_most is not None and value > limit.at_most:
        return f"{limit.feature} is {value:.3g}, at most {limit.at_most:g} is allowed"
    if limit.at_least is not None and value < limit.at_least:
        return f"{limit.feature} is {value:.3g}, at least {limit.at_least:g} is asked"
    return ""
