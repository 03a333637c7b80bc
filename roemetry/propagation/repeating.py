"""The stages again, on what was drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import RoemetryError
from roemetry.propagation.scene import Chain
from roemetry.records import Product, ProductTrace, Volume, Weight

VOLUME_MODEL, WEIGHT_MODEL = "volume model", "weight model"


class Result(NamedTuple):
    """One draw's outcome; NaN and "" where a stage refused."""

    visible_mm3: float = math.nan
    true_mm3: float = math.nan
    mass_g: float = math.nan
    label: str = ""
    probability: float = math.nan
    features: Mapping[str, float] = {}
    height_max_mm: float = math.nan


def again(
    chain: Chain,
    trace: ProductTrace,
    product: Product | None,
    rng: np.random.Generator,
    *,
    model: bool,
    graded: bool = True,
) -> Result:
    """Estimate, weigh and classify one drawn product; with `model`, drawing the stages' own errors too."""
    if product is None:
        return Result()
    own = rng if model else None
    volume = done(lambda: _estimated(chain, trace, product, own)) if chain.volume else None
    weight = None
    if chain.weigher and volume is not None:
        weight = done(lambda: chain.weigher.weigh(product, volume, rng=own))
    grade = done(lambda: chain.classifier.classify(product, rng=own)) if chain.classifier and graded else None
    return Result(
        visible_mm3=math.nan if volume is None else volume.visible_mm3.value,
        true_mm3=math.nan if volume is None or volume.true_mm3 is None else volume.true_mm3.value,
        mass_g=math.nan if weight is None else weight.mass_g.value,
        label="" if grade is None else grade.label,
        probability=math.nan if grade is None else grade.probability,
        features={} if grade is None else grade.features,
        height_max_mm=product.height_max_mm,
    )


def _estimated(
    chain: Chain, trace: ProductTrace, product: Product, rng: np.random.Generator | None
) -> Volume:
    if trace.volume is None:
        found: Volume = chain.volume.estimate(product, rng=rng)
        return found
    drawn: Volume = chain.volume.redraw(product, trace.volume, rng=rng)
    return drawn


def models_alone(
    trace: ProductTrace, chain: Chain, rng: np.random.Generator, count: int
) -> Mapping[str, list[Result]]:
    """Draw the volume's model alone, and the weigher's model alone, on the product as it was found."""
    product, volume = trace.product, trace.volume
    found: dict[str, list[Result]] = {}
    if volume is None:
        return found
    if chain.volume.states_model_error:
        drawn = (done(lambda: chain.volume.redraw(product, volume, rng=rng)) for _ in range(count))
        found[VOLUME_MODEL] = [_weighed(chain, product, volume, None) for volume in drawn]
    if chain.weigher and chain.weigher.states_model_error:
        found[WEIGHT_MODEL] = [_weighed(chain, product, volume, rng) for _ in range(count)]
    return found


def _weighed(
    chain: Chain, product: Product, volume: Volume | None, rng: np.random.Generator | None
) -> Result:
    if volume is None:
        return Result()
    weight: Weight | None = None
    if chain.weigher:
        weight = done(lambda: chain.weigher.weigh(product, volume, rng=rng))
    return Result(
        visible_mm3=volume.visible_mm3.value,
        true_mm3=math.nan if volume.true_mm3 is None else volume.true_mm3.value,
        mass_g=math.nan if weight is None else weight.mass_g.value,
    )


def done(step: Callable[[], Any]) -> Any:
    """Give a step's result, or None where a stage refuses."""
    try:
        return step()
    except RoemetryError:
        return None
