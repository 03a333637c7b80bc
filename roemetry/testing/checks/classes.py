"""What every classifier and grader keeps: every answer has a reason, and `unknown` is one."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from roemetry.records import Decision, Estimate, Grade, Product, Weight
from roemetry.stages import INTERFACES, Classifier, Grader
from roemetry.testing.runs import volume_of
from roemetry.testing.scenes import SEED
from roemetry.testing.solids import DENSE, DENTED, HALF_ELLIPSOID, product_from, product_of, reordered
from roemetry.testing.verdict import difference, require

_UNKNOWN = "unknown"


def check_order_of_slices_does_not_matter(classifier: Classifier[Any]) -> None:
    """Slices in another order get the same class, of a smooth body and of a dented one."""
    for name, product in _both():
        one, other = classifier.classify(product), classifier.classify(reordered(product))
        require(one.label == other.label, f"the {name} body is {one.label}, in another order {other.label}")


def check_mirroring_does_not_matter(classifier: Classifier[Any]) -> None:
    """A mirrored body under a mirrored rig gets the same class."""
    for name, solid in (("smooth", HALF_ELLIPSOID), ("dented", DENTED)):
        one = classifier.classify(product_of(solid))
        other = classifier.classify(product_of(solid.mirrored(), DENSE.mirrored()))
        require(one.label == other.label, f"the {name} body is {one.label}, mirrored {other.label}")


def check_almost_nothing_is_unknown(classifier: Classifier[Any]) -> None:
    """A product of a few points is ``unknown``: no exception, no guess."""
    heights = np.full((DENSE.stripes, DENSE.rows), np.nan)
    heights[30, 100:103] = 5.0
    label = classifier.classify(product_from(heights)).label
    require(label == _UNKNOWN, f"a product of three points is `{label}`, expected `{_UNKNOWN}`")


def check_every_class_has_reasons(classifier: Classifier[Any]) -> None:
    """Every answer has a reason in words, ``unknown`` too."""
    nothing = product_from(np.full((DENSE.stripes, DENSE.rows), np.nan))
    for name, product in (*_both(), ("empty", nothing)):
        grade = classifier.classify(product)
        require(grade.label.strip(), f"the {name} body's class has no name")
        require(
            grade.reasons and all(reason.code and reason.text.strip() for reason in grade.reasons),
            f"the {name} body is {grade.label} without a reason",
        )


def check_probability_is_one_or_not_stated(classifier: Classifier[Any]) -> None:
    """The probability lies between 0 and 1, or is NaN where it is not modelled."""
    for _, product in _both():
        probability = classifier.classify(product).probability
        require(math.isnan(probability) or 0.0 <= probability <= 1.0, f"the probability is {probability:.4g}")


def check_arrows_lie_on_the_product(classifier: Classifier[Any]) -> None:
    """Arrows start on the product, within a pixel of its extent in the image."""
    for name, product in _both():
        arrows = classifier.classify(product).arrows
        if arrows is None or not arrows.stripe.size:
            continue
        extent = np.stack([product.profiles.x_px.ravel(), product.profiles.row_px.ravel()], axis=1)
        low, high = np.nanmin(extent, axis=0) - 1.0, np.nanmax(extent, axis=0) + 1.0
        inside = ((arrows.from_px >= low) & (arrows.from_px <= high)).all(axis=1)
        require(bool(inside.all()), f"{int((~inside).sum())} arrows on the {name} body start beside it")


def check_one_seed_gives_one_draw(classifier: Classifier[Any]) -> None:
    """Given generators of the same seed, two grades are the same."""
    product = product_of(DENTED)
    one, other = (classifier.classify(product, rng=np.random.default_rng(SEED)) for _ in range(2))
    found = difference(one, other)
    require(found is None, f"with the same seed {found}")


def _both() -> tuple[tuple[str, Product], ...]:
    return ("smooth", product_of(HALF_ELLIPSOID)), ("dented", product_of(DENTED))


def check_every_decision_has_reasons(grader: Grader[Any]) -> None:
    """Every decision has a label and a reason in words, also when nothing is known."""
    for name, decision in (("whole", decided(grader)), ("bare", _of_nothing(grader))):
        require(bool(decision.label.strip()), f"the {name} product's decision has no label")
        require(
            bool(decision.reasons) and all(r.code and r.text.strip() for r in decision.reasons),
            f"the {name} product is {decision.label} without a reason",
        )


def check_a_decided_class_is_a_possible_one(grader: Grader[Any]) -> None:
    """A stated label is among the possible ones; if several are possible there may be none."""
    decision = decided(grader)
    require(bool(decision.possible), "no class is possible")
    if len(decision.possible) == 1:
        require(decision.label == decision.possible[0], f"{decision.possible[0]} alone is possible")


def check_uncertainty_does_not_take_a_class_away(grader: Grader[Any]) -> None:
    """A class that is possible with small uncertainties is possible with large ones."""
    sure, unsure = decided(grader, std_g=1e-6), decided(grader, std_g=5.0)
    lost = set(sure.possible) - set(unsure.possible)
    require(not lost, f"with a larger uncertainty {', '.join(sorted(lost))} is not possible any more")


def check_it_needs_kinds_of_stage(grader: Grader[Any]) -> None:
    """`needs` names kinds of stages."""
    unknown = grader.needs() - set(INTERFACES)
    require(not unknown, f"it needs {', '.join(sorted(unknown))}, which is no kind of stage")


def decided(grader: Grader[Any], std_g: float = 0.1, mass_g: float = 9.9) -> Decision:
    """Let a grader decide upon a good half-ellipsoid of a mass."""
    volume = dataclasses.replace(volume_of(9000.0), true_mm3=Estimate(9000.0, 90.0))
    weight, grade = Weight(Estimate(mass_g, std_g)), Grade("good", 0.99)
    return grader.decide(product_of(HALF_ELLIPSOID), volume, weight, grade)


def _of_nothing(grader: Grader[Any]) -> Decision:
    return grader.decide(product_of(HALF_ELLIPSOID), None, None, None)
