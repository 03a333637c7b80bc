"""The checks: small functions, a module a kind; each function's docstring is what a stage must keep."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from roemetry.testing.checks import (
    aligner,
    any_stage,
    calibrator,
    classifier,
    coder,
    extractor,
    grader,
    outliner,
    planner,
    simulator,
    sink,
    smoother,
    source,
    triangulator,
    volume,
    weigher,
)

Check = Callable[[Any], None]

ANY: tuple[Check, ...] = any_stage.CHECKS
OF_KIND: Mapping[str, tuple[Check, ...]] = {
    "source": source.CHECKS,
    "extractor": extractor.CHECKS,
    "aligner": aligner.CHECKS,
    "coder": coder.CHECKS,
    "smoother": smoother.CHECKS,
    "calibrator": calibrator.CHECKS,
    "triangulator": triangulator.CHECKS,
    "outliner": outliner.CHECKS,
    "volume": volume.CHECKS,
    "weigher": weigher.CHECKS,
    "classifier": classifier.CHECKS,
    "grader": grader.CHECKS,
    "sink": sink.CHECKS,
    "simulator": simulator.CHECKS,
    "planner": planner.CHECKS,
}


def checks_of(kind: str) -> tuple[Check, ...]:
    """Give the checks that a stage of this kind must pass: every stage's, then its kind's.

    Of a kind that the kit has no scenes for, the options alone are checked.
    """
    return ANY + OF_KIND[kind] if kind in OF_KIND else any_stage.OF_OPTIONS


def name_of(check: Check) -> str:
    """Name of a check, as results and expected failures use it."""
    return str(check.__name__)


def sentence_of(check: Check) -> str:
    """What a stage must keep, in one sentence."""
    return " ".join((check.__doc__ or "").split())
