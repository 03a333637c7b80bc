"""What is remembered is asked for again where anything that decides it has changed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from roemetry.config.recipe import Recipe
from roemetry.records import Decision, Estimate, Weight
from roemetry.run.stage_cache import RememberedStages, StepMemory
from roemetry.testing.solids import HALF_ELLIPSOID, product_of

GRADER = (
    "stages.grader={use: grade-table, options: {classes: "
    "[{label: heavy, limits: {weight_g: {at_least: 10}}}, {label: light}]}}"
)


def test_a_grader_decides_anew_where_draws_give_other_uncertainties(line: Callable[..., Path]) -> None:
    recipe = Recipe.load(line(count=1), sets=[GRADER])
    memory = StepMemory()
    product = product_of(HALF_ELLIPSOID)

    def decided(draws: int, std_g: float) -> Decision:
        grader = RememberedStages(recipe, memory, draws).stages["grader"]
        found: Decision = grader.decide(product, None, Weight(Estimate(9.9, std_g)), None)
        return found

    sure = decided(0, 0.001)
    assert sure.label == "light"
    assert decided(200, 1.0).label == "undecided"
    assert decided(0, 0.001) is sure


def test_what_a_step_raised_is_raised_again_with_its_place() -> None:
    memory, places = StepMemory(), []

    def breaks() -> None:
        raise IndexError("oh")

    for _ in range(3):
        with pytest.raises(IndexError) as broke:
            memory.recall("key", breaks)
        places.append([str(entry.path.name) for entry in broke.traceback])
    assert broke.traceback[-1].name == "breaks"
    assert places[0] == places[1] == places[2], "the traceback does not grow"
