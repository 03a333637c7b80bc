"""A stage that breaks is named, with the line of its own code."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from roemetry.config.resolve import Chosen
from roemetry.errors import DataError, PluginError
from roemetry.records import Peaks
from roemetry.run.stage_errors import blamed, failure, place_in
from roemetry.stages.registry import discover


def caught() -> Exception:
    """What json raises when it is called from here: the error lies deeper than this file."""
    try:
        json.loads("{")
    except ValueError as error:
        return error
    raise AssertionError


def chosen() -> Chosen:
    registered = discover().find("extractor", "dominant-peak")
    stage = discover().load(registered)
    return Chosen(registered, stage, stage.Options())


def test_the_innermost_line_of_the_package_is_named() -> None:
    line = caught.__code__.co_firstlineno + 3
    assert place_in(caught(), __name__) == f"{Path(__file__).name}:{line}"
    assert str(place_in(caught(), "json")).startswith("decoder.py:")


def test_no_place_is_better_than_a_wrong_one() -> None:
    assert place_in(caught(), "roemetry_paper.dominant_peak") is None
    assert place_in(ValueError("never raised"), __name__) is None


def test_the_stage_is_named() -> None:
    said = failure(ValueError("oh"), "extractor", chosen())
    assert said == (
        "the extractor `dominant-peak` failed with ValueError: oh (a plugin's fault; see --debug)"
    )
    assert failure(ValueError("oh"), "draws", None).startswith("the draws failed with ValueError")


def test_outside_a_run_a_fault_is_a_plugin_error_and_a_refusal_stays_one() -> None:
    fault = pytest.raises(PluginError, match="the extractor `dominant-peak` failed")
    with fault as broke, blamed("extractor", chosen()):
        raise ZeroDivisionError("oh")
    assert isinstance(broke.value.__cause__, ZeroDivisionError)
    with pytest.raises(DataError), blamed("extractor", chosen()):
        raise DataError("no light")
    with fault, blamed("extractor", chosen()):
        sys.exit(0)


def test_a_record_that_contradicts_itself_is_its_stages_fault() -> None:
    fault = pytest.raises(PluginError, match="`dominant-peak` failed with RecordError: Peaks: ")
    with fault as broke, blamed("extractor", chosen()):
        Peaks((4, 4), np.array([0.5]), *(np.array([np.nan]),) * 5, flags=np.zeros(1))
    assert "row holds what is no whole number" in broke.value.message
    assert "x_px is outside −0.5…3.5, or not a number" in broke.value.message
