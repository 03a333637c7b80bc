"""What every grader keeps."""

from __future__ import annotations

import dataclasses
from typing import Any

from roemetry.records import Decision, Estimate, Grade, Weight
from roemetry.stages import INTERFACES, Grader
from roemetry.testing.runs import volume_of
from roemetry.testing.solids import HALF_ELLIPSOID, product_of
from roemetry.testing.verdict import require


def check_every_decision_has_reasons(grader: Grader[Any]) -> None:
    """Every decision has a label and a reason in words, with much known and with nothing."""
    for name, decision in (("whole", decided(grader)), ("bare", _of_nothing(grader))):
        require(bool(decision.label.strip()), f"the {name} product's decision has no label")
        require(
            bool(decision.reasons) and all(r.code and r.text.strip() for r in decision.reasons),
            f"the {name} product is {decision.label} without a reason",
        )


def check_a_decided_class_is_a_possible_one(grader: Grader[Any]) -> None:
    """A label that is given is among the possible ones; with several possible it need not be given."""
    decision = decided(grader)
    require(bool(decision.possible), "no class is possible")
    if len(decision.possible) == 1:
        require(decision.label == decision.possible[0], f"{decision.possible[0]} alone is possible")


def check_uncertainty_does_not_take_a_class_away(grader: Grader[Any]) -> None:
    """What is possible with small uncertainties is possible with large ones."""
    sure, unsure = decided(grader, std_g=1e-6), decided(grader, std_g=5.0)
    lost = set(sure.possible) - set(unsure.possible)
    require(not lost, f"with a larger uncertainty {', '.join(sorted(lost))} is not possible any more")


def check_it_needs_kinds_of_stage(grader: Grader[Any]) -> None:
    """What it needs are kinds of stage."""
    unknown = grader.needs() - set(INTERFACES)
    require(not unknown, f"it needs {', '.join(sorted(unknown))}, which is no kind of stage")


CHECKS = (
    check_every_decision_has_reasons,
    check_a_decided_class_is_a_possible_one,
    check_uncertainty_does_not_take_a_class_away,
    check_it_needs_kinds_of_stage,
)


def decided(grader: Grader[Any], std_g: float = 0.1, mass_g: float = 9.9) -> Decision:
    """Let a grader decide upon a good half-ellipsoid of a mass."""
    volume = dataclasses.replace(volume_of(9000.0), true_mm3=Estimate(9000.0, 90.0))
    weight, grade = Weight(Estimate(mass_g, std_g)), Grade("good", 0.99)
    return grader.decide(product_of(HALF_ELLIPSOID), volume, weight, grade)


def _of_nothing(grader: Grader[Any]) -> Decision:
    return grader.decide(product_of(HALF_ELLIPSOID), None, None, None)
