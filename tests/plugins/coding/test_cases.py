"""Every coder on every case that is known to be hard: each peak right, or refused."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from roemetry.errors import StageError
from roemetry.stages.registry import discover

cases = pytest.importorskip("benchmarks.coded.cases", reason="only in a checkout")
from benchmarks.coded import Sample, score  # noqa: E402

FAILURES = {
    **{
        ("ordered", case): "order in each row alone does not see what is hidden"
        for case in (
            "smooth_tail",
            "leaving_the_image",
            "past_the_neighbour",
            "on_the_neighbour",
            "crossing_twice",
            "dense_and_displaced",
            "a_step_of_one_spacing",
        )
    },
    ("window-tracking", "on_the_neighbour"): "it takes a body on the next rest line for that stripe's belt",
    ("window-tracking", "dense_and_displaced"): "order in rows has no height: 2 spacings are too much for it",
    ("window-tracking", "a_step_of_one_spacing"): "where a body lies on the next rest line it cuts too late",
}
"""Known: a coder and a case in which it gives a peak to another stripe, with the reason."""


def coders() -> dict[str, Any]:
    """Make every registered coder with its default options."""
    registry = discover()
    return {stage.entry.name: registry.load(stage)() for stage in registry.of_kind("coder")}


@cache
def sample_of(case: str) -> Sample:
    return cases.CASES[case]()


@pytest.mark.parametrize("case", cases.CASES)
@pytest.mark.parametrize("coder", coders())
def test_right_or_refused(coder: str, case: str) -> None:
    sample = sample_of(case)
    try:
        stripes = coders()[coder].code(sample.peaks, sample.calibration)
    except StageError as refusal:
        assert str(refusal)
        return
    found = score(stripes, sample)
    wrong = found.wrong - found.shared
    known = FAILURES.get((coder, case))
    if known is None:
        assert wrong == 0
        if found.refused > 0.05 * found.visible:
            assert stripes.reasons, "product points are refused and no reason says so"
    else:
        assert wrong > 0, f"declared to fail ({known}), and does not any more"


def test_every_declared_failure_is_of_a_coder_and_a_case_that_exist() -> None:
    assert {coder for coder, _ in FAILURES} <= set(coders())
    assert {case for _, case in FAILURES} <= set(cases.CASES)
