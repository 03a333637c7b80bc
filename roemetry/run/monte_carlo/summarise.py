"""From drawn results to standard uncertainties, budgets, intervals and probabilities."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roemetry.records import Estimate, ProductTrace, Reason
from roemetry.records.arrays import Floats

COVERAGE = 0.95
"""Share of cases in which an interval is to hold the true value."""
COVERAGE_FACTOR = 1.959964
"""Half width of a 95 % interval in standard deviations of a normal distribution."""
FEW_DRAWS = 20
"""With fewer, a standard deviation is itself uncertain by a sixth and more."""
ENOUGH_FOR_QUANTILES = 1000
"""From so many draws on the interval's ends are quantiles: 25 draws lie beyond each."""
_UNKNOWN = "unknown"
_NO_INTERVAL = (math.nan, math.nan)
_PART_ONLY = Reason(
    "model-error-only",
    "the uncertainty is that of the model alone: the noise of peaks and the calibration come with `draws`",
)
CALIBRATION_NOT_STATED = Reason(
    "calibration-model-not-stated",
    "one block tells nothing of the lens and little of the camera's tilt, and how far they move a volume "
    "is not known: no uncertainty and no interval is given",
)
FAILED_SHARE_MAX = 0.05
"""With more draws than this refused, what is left is no fair sample."""


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


class Unstated(NamedTuple):
    """What keeps the uncertainty of volume and of weight from being stated; and that of points."""

    volume: tuple[Reason, ...]
    weight: tuple[Reason, ...]
    points: bool = False


def with_uncertainty(
    trace: ProductTrace,
    together: list[Result],
    alone: Mapping[str, list[Result]],
    models: Mapping[str, list[Result]],
    unstated: Unstated,
) -> ProductTrace:
    """Put what was drawn on a product's results.

    Parameters
    ----------
    trace
        As it was found, without draws.
    together
        Results with all causes drawn at once.
    alone
        By cause, results with that one drawn; of what goes before the volume.
    models
        The same of the volume's and the weigher's own models.
    unstated
        What keeps an uncertainty from being stated.
    """
    volume, weight, grade = trace.volume, trace.weight, trace.grade
    height = _largest(trace.product.height_max_mm, together, alone, stated=not unstated.points)
    if volume is not None:
        causes = {**alone, **{cause: found for cause, found in models.items() if cause == VOLUME_MODEL}}
        visible, true = volume.visible_mm3, volume.true_mm3
        visible, lost = _estimate(visible, "visible_mm3", together, causes, stated=not unstated.volume)
        if true is not None:
            true, _ = _estimate(true, "true_mm3", together, causes, stated=not unstated.volume)
        said = volume.reasons + unstated.volume + lost
        volume = replace(volume, visible_mm3=visible, true_mm3=true, reasons=said)
    if weight is not None:
        stated = not (unstated.volume or unstated.weight)
        mass, lost = _estimate(weight.mass_g, "mass_g", together, {**alone, **models}, stated=stated)
        weight = replace(weight, mass_g=mass, reasons=weight.reasons + unstated.weight + lost)
    if grade is not None and together:
        held = [_probability(result, grade.label) for result in together]
        sure = math.nan if grade.label == _UNKNOWN else float(np.mean(held))
        spread = {} if unstated.points else _features_std(grade.features, together)
        grade = replace(grade, probability=sure, features_std=spread)
    return replace(trace, volume=volume, weight=weight, grade=grade, height_max_mm=height)


def without_draws(trace: ProductTrace, *, approximate: bool) -> ProductTrace:
    """Say of each uncertainty that a stage stated by itself that it is a part of the whole.

    On an approximate calibration it is not stated: who reads a part as the whole would be misled most there.
    """
    volume, weight = trace.volume, trace.weight
    said = CALIBRATION_NOT_STATED if approximate else _PART_ONLY
    if volume is not None and _a_part(volume.visible_mm3):
        visible, true = volume.visible_mm3, volume.true_mm3
        if approximate:
            visible, true = _unstated(visible), None if true is None else _unstated(true)
        volume = replace(volume, visible_mm3=visible, true_mm3=true, reasons=(*volume.reasons, said))
    if weight is not None and _a_part(weight.mass_g):
        mass = _unstated(weight.mass_g) if approximate else weight.mass_g
        weight = replace(weight, mass_g=mass, reasons=(*weight.reasons, said))
    return replace(trace, volume=volume, weight=weight)


def _unstated(estimate: Estimate) -> Estimate:
    return replace(estimate, std=math.nan, interval=_NO_INTERVAL)


def _a_part(estimate: Estimate) -> bool:
    """Tell an uncertainty without an interval: a stage that knows the whole of it states that as well."""
    return math.isfinite(estimate.std) and not all(map(math.isfinite, estimate.interval))


def _probability(result: Result, label: str) -> float:
    """Give the probability of a label in one draw: as stated of each class, else of the draw's own."""
    of_class = result.features.get(f"probability_{label}", math.nan)
    if not math.isnan(of_class) and result.label != _UNKNOWN:
        return of_class
    if result.label != label:
        return 0.0
    return 1.0 if math.isnan(result.probability) else result.probability


def _largest(
    found_mm: float, together: list[Result], alone: Mapping[str, list[Result]], *, stated: bool
) -> Estimate:
    """Give the largest height with its uncertainty: what draws scatter by, and what noise has lifted it by.

    The largest of many noisy heights is too high on average. Noise drawn on top of it lifts it once more: on
    a flat top, where the highest of n points grows with the noise's size, by √2 − 1 of what the first noise
    did; on a peaked one both lifts are small. So the first lift is reckoned from the second by that share.
    """
    parts = {cause: _distance(found_mm, results) for cause, results in alone.items()}
    budget = {cause: part for cause, part in parts.items() if part > 0}
    std = _distance(found_mm, together)
    if not stated or not math.isfinite(std):
        return Estimate(found_mm, budget=budget)
    reach = COVERAGE_FACTOR * std
    return Estimate(found_mm, std, budget, (found_mm - reach, found_mm + reach))


def _distance(found_mm: float, results: list[Result]) -> float:
    """Give the scatter of drawn largest heights with the lift of what was found, mm; NaN where too few."""
    drawn = np.array([result.height_max_mm for result in results])
    good = drawn[np.isfinite(drawn)]
    if good.size < max(2.0, (1.0 - FAILED_SHARE_MAX) * drawn.size):
        return math.nan
    mean, std = _mean_and_std(good)
    return math.hypot(std, max(0.0, mean - found_mm) / (math.sqrt(2.0) - 1.0))


def _features_std(features: Mapping[str, float], together: list[Result]) -> dict[str, float]:
    """Give the standard deviation of each feature over the draws; of one that draws lack, none."""
    found = {}
    for name in features:
        values = np.array([result.features.get(name, math.nan) for result in together])
        good = values[np.isfinite(values)]
        if good.size >= max(2.0, (1.0 - FAILED_SHARE_MAX) * values.size):
            found[name] = _mean_and_std(good)[1]
    return found


def _estimate(
    found: Estimate,
    field: str,
    together: list[Result],
    causes: Mapping[str, list[Result]],
    *,
    stated: bool,
) -> tuple[Estimate, tuple[Reason, ...]]:
    """Give the estimate with std, budget and interval, and what is to be said of the draws."""
    parts = {cause: _spread(results, field) for cause, results in causes.items()}
    budget = {cause: part for cause, part in parts.items() if math.isfinite(part)}
    if VOLUME_MODEL in budget and field != "mass_g" and found.budget:
        # The estimator knows its model's parts better than one number for all of them.
        del budget[VOLUME_MODEL]
        budget |= found.budget
    values = np.array([getattr(result, field) for result in together])
    good = values[np.isfinite(values)]
    if good.size < (1.0 - FAILED_SHARE_MAX) * values.size or good.size < 2:
        lost_count = values.size - good.size
        why = (
            f"{lost_count} of {values.size} draws could not be measured"
            if lost_count
            else "one draw has no scatter"
        )
        lost = (Reason("draws-refused", f"{why}: the uncertainty is not stated"),)
        return replace(_unstated(found), budget=budget), lost
    if not stated:
        return replace(_unstated(found), budget=budget), ()
    std = _mean_and_std(good)[1]
    if good.size >= ENOUGH_FOR_QUANTILES:
        tail = (1.0 - COVERAGE) / 2.0
        low, high = (float(q) for q in np.quantile(good, [tail, 1.0 - tail]))
        interval = (min(low, found.value), max(high, found.value))
    else:
        interval = (found.value - COVERAGE_FACTOR * std, found.value + COVERAGE_FACTOR * std)
    return replace(found, std=std, budget=budget, interval=interval), _few(good.size)


def _few(draws: int) -> tuple[Reason, ...]:
    """Say of a standard deviation of few draws how uncertain it is itself: by 1/√(2(n − 1))."""
    if draws >= FEW_DRAWS:
        return ()
    share = 1.0 / math.sqrt(2.0 * (draws - 1))
    return (Reason("few-draws", f"{draws} draws tell a standard uncertainty to {share:.0%} only: take more"),)


def _spread(results: list[Result], field: str) -> float:
    values = np.array([getattr(result, field) for result in results])
    good = values[np.isfinite(values)]
    return _mean_and_std(good)[1] if good.size >= 2 else math.nan


def _mean_and_std(values: Floats) -> tuple[float, float]:
    """Give both; of equal values exactly these and 0: what a mean rounds off is no scatter."""
    if np.ptp(values) == 0.0:
        return float(values[0]), 0.0
    return float(values.mean()), float(values.std(ddof=1))
