"""Ranks and medians are numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry_kernels.ranking import median_of, nth_smallest

FLOATS = st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=60)


@given(FLOATS)
def test_ranks_and_medians_are_those_of_sorted_values(numbers: list[float]) -> None:
    values = np.array(numbers)
    kept = values.copy()
    assert [nth_smallest(values, n) for n in range(values.size)] == sorted(numbers)
    assert median_of(values) == np.median(kept)
    assert (values == kept).all()


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=200))
def test_many_equal_whole_numbers(numbers: list[int]) -> None:
    values = np.array(numbers)
    assert [nth_smallest(values, n) for n in range(values.size)] == sorted(numbers)


@pytest.mark.parametrize("size", [1, 2, 999, 1000])
def test_sorted_and_turned_round(size: int) -> None:
    for values in (np.arange(size), np.arange(size)[::-1].copy(), np.zeros(size, np.int64)):
        assert nth_smallest(values, size // 3) == np.sort(values)[size // 3]
        assert median_of(values) == np.median(values)


def test_medians_of_drawn_numbers(rng: np.random.Generator) -> None:
    for size in range(1, 400):
        values = rng.normal(size=size)
        assert median_of(values) == np.median(values)
