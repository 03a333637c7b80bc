"""Mass by what weighed samples have taught."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry.records import Estimate, Fitted, Product, Reason, Samples, Volume, Weight
from roemetry.stages import Capabilities, StageOptions, Weigher
from roemetry_volume.weight_features import VISIBLE, weight_features
from roemetry_volume.weight_model import WeightModel


class FittedWeightOptions(StageOptions):
    """Options of `FittedWeight`."""

    model: Path | None = Field(
        default=None, description="file of `roemetry fit-weight`; none: features only, no mass"
    )


class FittedWeight(Weigher[FittedWeightOptions]):
    """Multiplies the visible volume by a ratio that weighed samples of the same product have taught.

    The ratio may depend on how high the product's widest line lies, below which there is air. The mass has
    the prediction interval of one more product: scatter of the samples, uncertainty of the fit, and few
    samples (Student's t). The volume's own random error is part of the samples' scatter.
    """

    Options: ClassVar[type[StageOptions]] = FittedWeightOptions
    capabilities = Capabilities(fixture="roemetry_volume.example_weight:weight_options")

    @property
    def states_model_error(self) -> bool:
        """Whether there is a model, which has a scatter."""
        return self.options.model is not None

    @cached_property
    def _model(self) -> WeightModel | None:
        return None if self.options.model is None else WeightModel.load(self.options.model)

    def weigh(self, product: Product, volume: Volume, *, rng: np.random.Generator | None = None) -> Weight:
        """Reckon the mass; given `rng`, draw the product's own ratio from Student's t.

        Raises
        ------
        StageError
            The model's file is none, or damaged.
        """
        model = self._model
        features = weight_features(product, volume)
        if model is None:
            return Weight(Estimate(math.nan), (_NO_MODEL,), features)
        asked = with_inverse(features)
        ratio, of_fit, scatter = model.ratio(asked)
        if math.isnan(ratio):
            missing = ", ".join(name for name in model.features if name not in asked)
            return Weight(
                Estimate(math.nan),
                (Reason("weight-feature-missing", f"{missing} could not be measured: no mass without it"),),
                features,
            )
        outside = model.outside(asked)
        reasons = (Reason("outside-weighed", f"not valid here: {'; '.join(outside)}"),) if outside else ()
        visible = features[VISIBLE]
        value, std = visible * ratio, visible * math.hypot(of_fit, scatter)
        if rng is not None:
            drawn = rng.standard_t(model.degrees_of_freedom) / model.student_std
            return Weight(Estimate(value + std * drawn), reasons, features)
        if not value > 0.0:
            return Weight(Estimate(math.nan if value < 0.0 else value), reasons, features)
        from scipy.stats import t

        half = std / model.student_std * float(t.ppf(0.975, model.degrees_of_freedom))
        budget = {"samples' scatter": visible * scatter, "fit": visible * of_fit}
        return Weight(Estimate(value, std, budget, (value - half, value + half)), reasons, features)

    @classmethod
    def fit(cls, samples: Samples, *, form: str = "auto") -> Fitted:
        """Learn from weighed products; see `roemetry_volume.fitting_weights.fit_weights`."""
        from roemetry_volume.fitting_weights import fit_weights

        return fit_weights(samples, form=form)


def with_inverse(features: dict[str, float]) -> dict[str, float]:
    """Add one over the volume, by which an offset of the mass is a share of it."""
    visible = features[VISIBLE]
    return features if not visible > 0.0 else {**features, "per_cm3": 1.0 / visible}


_NO_MODEL = Reason("no-weight-model", "there is no model yet: the features are measured, the mass is not")
