"""A stage that breaks is named, with the line of its code; what is kept of stages is asked for again."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from roemetry.config.recipe import Recipe
from roemetry.config.resolve import ResolvedStage
from roemetry.errors import DataError, PluginError
from roemetry.records import Decision, Estimate, Peaks, Weight
from roemetry.run.pipeline import Pipeline
from roemetry.run.stage_cache import CachedStages, StageCache
from roemetry.run.stage_errors import describe_failure, plugin_frame, wrap_stage_error
from roemetry.stages.registry import discover
from roemetry.testing.solids import HALF_ELLIPSOID, product_of


def caught() -> Exception:
    """What json raises when it is called from here: the error lies deeper than this file."""
    try:
        json.loads("{")
    except ValueError as error:
        return error
    raise AssertionError


def chosen() -> ResolvedStage:
    registered = discover().find("extractor", "dominant-peak")
    stage = discover().load(registered)
    return ResolvedStage(registered, stage, stage.Options())


def test_the_innermost_line_of_the_package_is_named() -> None:
    line = caught.__code__.co_firstlineno + 3
    assert plugin_frame(caught(), __name__) == f"{Path(__file__).name}:{line}"
    assert str(plugin_frame(caught(), "json")).startswith("decoder.py:")
    assert plugin_frame(caught(), "roemetry_paper.dominant_peak") is None
    assert plugin_frame(ValueError("never raised"), __name__) is None


def test_the_stage_is_named() -> None:
    said = describe_failure(ValueError("oh"), "extractor", chosen())
    assert said == (
        "the extractor `dominant-peak` failed with ValueError: oh (a plugin's fault; see --debug)"
    )
    assert describe_failure(ValueError("oh"), "draws", None).startswith("the draws failed with ValueError")


def test_outside_a_run_a_fault_is_a_plugin_error_and_a_refusal_stays_one() -> None:
    fault = pytest.raises(PluginError, match="the extractor `dominant-peak` failed")
    with fault as broke, wrap_stage_error("extractor", chosen()):
        raise ZeroDivisionError("oh")
    assert isinstance(broke.value.__cause__, ZeroDivisionError)
    with pytest.raises(DataError), wrap_stage_error("extractor", chosen()):
        raise DataError("no light")
    with fault, wrap_stage_error("extractor", chosen()):
        sys.exit(0)


def test_a_record_that_contradicts_itself_is_its_stages_fault() -> None:
    fault = pytest.raises(PluginError, match="`dominant-peak` failed with RecordError: Peaks: ")
    with fault as broke, wrap_stage_error("extractor", chosen()):
        Peaks((4, 4), np.array([0.5]), *(np.array([np.nan]),) * 5, flags=np.zeros(1))
    assert "row holds what is no whole number" in broke.value.message
    assert "x_px is outside −0.5…3.5, or not a number" in broke.value.message


GRADER = (
    "stages.grader={use: grade-table, options: {classes: "
    "[{label: heavy, limits: {weight_g: {at_least: 10}}}, {label: light}]}}"
)


def test_a_grader_decides_anew_where_draws_give_other_uncertainties(line: Callable[..., Path]) -> None:
    recipe = Recipe.load(line(count=1), sets=[GRADER])
    memory = StageCache()
    product = product_of(HALF_ELLIPSOID)

    def decided(draws: int, std_g: float) -> Decision:
        grader = CachedStages(recipe, memory, draws).stages["grader"]
        mass = Estimate(9.9, std_g, interval=(9.9 - 2.0 * std_g, 9.9 + 2.0 * std_g))
        found: Decision = grader.decide(product, None, Weight(mass), None)
        return found

    sure = decided(0, 0.001)
    assert sure.label == "light"
    assert decided(200, 1.0).label == "undecided"
    assert decided(0, 0.001) is sure


def test_what_a_step_raised_is_raised_again_with_its_place() -> None:
    memory, places = StageCache(), []

    def breaks() -> None:
        raise IndexError("oh")

    for _ in range(3):
        with pytest.raises(IndexError) as broke:
            memory.recall("key", breaks)
        places.append([str(entry.path.name) for entry in broke.traceback])
    assert broke.traceback[-1].name == "breaks"
    assert places[0] == places[1] == places[2], "the traceback does not grow"


def test_variants_of_a_scan_do_not_take_one_line_for_another(root: Path) -> None:
    recipe = Recipe.load(root / "recipes/belt_scan", sets=["draws=0"])
    source = recipe.source.make()
    acquisition = source.read(recipe.references()[0])
    remembered = CachedStages(recipe, StageCache())
    alone, shared = (
        Pipeline(recipe, stages=stages).trace(acquisition) for stages in (None, remembered.stages)
    )
    assert alone.products
    for one, other in zip(alone.products, shared.products, strict=True):
        assert one.volume is not None
        assert other.volume is not None
        assert one.volume.visible_mm3 == other.volume.visible_mm3
