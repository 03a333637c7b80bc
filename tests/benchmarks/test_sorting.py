"""Sorting near a limit: no more wrong than the guard band promises, and nothing decided by a part."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.sorting import Case, sorted_at_limits, told
from roemetry.records import Estimate, Grade, Weight
from roemetry.testing.solids import HALF_ELLIPSOID, product_of

COUNT = 1000


def cases(rng: np.random.Generator, *, whole: bool, draws: int = 0) -> list[Case]:
    """Products of 30 g measured with 1 g of noise; with `draws`, the noise is known from so many only."""
    product, found = product_of(HALF_ELLIPSOID), []
    for value in 30.0 + rng.standard_normal(COUNT):
        std = 1.0 if draws == 0 else float(rng.standard_normal(draws).std(ddof=1))
        std *= 1.0 if draws == 0 else math.sqrt((draws - 1.0) / (draws - 3.0))
        interval = (value - 2.0 * std, value + 2.0 * std) if whole else (math.nan, math.nan)
        weight = Weight(Estimate(float(value), std, {"model": std}, interval))
        trace = SimpleNamespace(product=product, volume=None, weight=weight, grade=None)
        found.append(Case("line", trace, "weight_g", 30.0))  # type: ignore[arg-type]
    return found


@pytest.mark.parametrize("draws", [0, 4, 10])
def test_wrong_are_no_more_than_promised(draws: int, rng: np.random.Generator) -> None:
    decided, wrong, count = sorted_at_limits(cases(rng, whole=True, draws=draws), COUNT, 1)
    assert count == COUNT
    assert decided > 0.2 * COUNT
    assert wrong <= 0.05 * COUNT


def test_a_part_of_the_uncertainty_decides_nothing(rng: np.random.Generator) -> None:
    assert sorted_at_limits(cases(rng, whole=False), COUNT, 1)[:2] == (0, 0)


def test_a_length_is_sorted_by_what_the_table_says_and_by_no_less(rng: np.random.Generator) -> None:
    """What a run knows of a length, a tenth of its error here, decides nothing."""
    product, found = product_of(HALF_ELLIPSOID), []
    for value in 80.0 + rng.standard_normal(COUNT):
        grade = Grade("good", features={"length_mm": float(value)}, features_std={"length_mm": 0.1})
        trace = SimpleNamespace(product=product, volume=None, weight=None, grade=grade)
        found.append(Case("line", trace, "length_mm", 80.0))  # type: ignore[arg-type]
    assert sorted_at_limits(found, COUNT, 1)[0] == 0
    measured = told(found)
    assert measured[0].std == pytest.approx(1.0, rel=0.1)
    decided, wrong, count = sorted_at_limits(measured, COUNT, 1)
    assert decided > 0.2 * count
    assert wrong <= 0.05 * count
