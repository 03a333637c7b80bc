"""Ranks and medians are numpy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from roemetry_kernels.image_levels import median_of, nth_smallest, quantile_of

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


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), st.floats(0.0, 1.0))
def test_quantiles_are_numpys(numbers: list[float], share: float) -> None:
    values = np.array(numbers)
    np.testing.assert_allclose(quantile_of(values, share), np.quantile(values, share), rtol=1e-9, atol=1e-9)
