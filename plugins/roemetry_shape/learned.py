"""Classes learned from labelled products."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from roemetry.records import Fitted, Grade, Product, Reason, Samples
from roemetry.stages import Capabilities, Classifier, StageOptions
from roemetry_shape.features import shape_of
from roemetry_shape.learned_model import LearnedModel, Strangeness

UNKNOWN = "unknown"


class LearnedOptions(StageOptions):
    """Options of `Learned`."""

    model: Path = Field(description="file of `roemetry fit-classifier`")
    probability_min: float = Field(
        default=0.0, ge=0.0, le=1.0, description="a class less likely than this is not stated: unknown"
    )


class Learned(Classifier[LearnedOptions]):
    """A forest of randomised trees (Geurts, Ernst and Wehenkel 2006) over the shape features.

    The forest's class shares are raised to a power that was fitted on held-out products, so that a stated
    probability means what it says. ``unknown`` is the answer where the product shows too few sections, where
    it is unlike anything the model was fitted on, and where no class is likely enough.
    """

    Options: ClassVar[type[StageOptions]] = LearnedOptions
    capabilities = Capabilities(fixture="roemetry_shape.example_model:learned_options")

    @cached_property
    def _model(self) -> LearnedModel:
        return LearnedModel.load(self.options.model)

    def classify(self, product: Product, *, rng: np.random.Generator | None = None) -> Grade:
        """Give the likeliest class with its probability; `rng` is not used: the model itself does not err.

        Raises
        ------
        StageError
            The model's file is none, or damaged.
        """
        shape = shape_of(product, self._model.smoothing_rows)
        return replace(self.judge(shape.features), relief=shape.relief)

    def judge(self, features: Mapping[str, float]) -> Grade:
        """Judge features that were measured already, with the model's `smoothing_rows`."""
        model = self._model
        if not features:
            return Grade(UNKNOWN, reasons=(Reason("too-few-sections", _FEW),))
        values = model.values(features)
        strange = model.strangeness(values)
        probabilities = model.probabilities(values)
        by_class = dict(zip(model.classes, probabilities.tolist(), strict=True))
        told = {**features, **{f"probability_{name}": value for name, value in by_class.items()}}
        told["strangeness"] = strange.value
        if strange.value > 1.0:
            return Grade(UNKNOWN, math.nan, told, (Reason("unlike-anything-learned", _unlike(strange)),))
        label = _decided(by_class, model)
        if by_class[label] < self.options.probability_min:
            why = f"the likeliest class, {label}, has a probability of {by_class[label]:.2f} only"
            return Grade(UNKNOWN, math.nan, told, (Reason("no-class-likely", why),))
        return Grade(label, by_class[label], told, (Reason("learned-class", _said(by_class)),))

    @classmethod
    def fit(cls, samples: Samples, *, good: str = "", smoothing_rows: int = 15) -> Fitted:
        """Learn from labelled products; see `roemetry_shape.fitting.fit_forest`."""
        from roemetry_shape.fitting import fit_forest

        return fit_forest(samples, good=good, smoothing_rows=smoothing_rows)


_FEW = "fewer than three stripes show a cross-section: there is no shape to judge"


def _unlike(strange: Strangeness) -> str:
    if not strange.feature:
        return f"{strange.value:.1f} times as far from all that was learned as is usual"
    return (
        f"{strange.feature} is {strange.found:.3g}, and was {strange.low:.3g} to {strange.high:.3g} in all "
        f"that was learned; over all features {strange.value:.1f} times as far outside as is usual"
    )


def _decided(by_class: dict[str, float], model: LearnedModel) -> str:
    """Good from `good_from` on; else the likeliest of the others."""
    if model.good and by_class[model.good] >= model.good_from:
        return model.good
    others = {name: value for name, value in by_class.items() if name != model.good}
    return max(others, key=lambda name: others[name])


def _said(by_class: dict[str, float]) -> str:
    likely = sorted(by_class.items(), key=lambda item: -item[1])[:3]
    return "probabilities: " + ", ".join(f"{name} {value:.2f}" for name, value in likely)
