"""How far a product is from all that was learned: known for normal samples, the same in the file."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_shape.novelty import excess_norm, pack_symmetric, seen_classes, unpack_symmetric


def samples(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Two classes, in each of which the two features hang together, but not in the same way."""
    labels = np.array(["a", "b"])[rng.integers(0, 2, count)]
    first, second = 0.2 * rng.standard_normal((2, count))
    way = np.where(labels == "a", 1.0, -1.0)
    return np.column_stack([first, 0.95 * way * first + 0.05 * second]), labels


def test_a_sample_lies_about_one_from_its_own_class(rng: np.random.Generator) -> None:
    values, labels = samples(rng, 4000)
    squares = seen_classes(values, labels).distances(values) ** 2
    # Less than 1: of two classes the nearer one counts, and shrinking makes correlations weaker.
    assert 0.5 < squares.mean() < 1.0


def test_each_class_has_its_own_correlation(rng: np.random.Generator) -> None:
    """Off to the side of both lines is novel, though each feature alone is not."""
    values, labels = samples(rng, 4000)
    seen = seen_classes(values, labels)
    on_a_line, beside = seen.distances(np.array([[0.3, 0.285], [0.3, 0.0]]))
    assert beside > 1.3 * on_a_line


def test_the_file_keeps_it(rng: np.random.Generator) -> None:
    values, labels = samples(rng, 200)
    seen = seen_classes(values, labels)
    np.testing.assert_allclose(unpack_symmetric(pack_symmetric(seen.precision), 2), seen.precision, atol=1e-9)
    with pytest.raises(ValueError, match="expected 6 values a class"):
        unpack_symmetric(pack_symmetric(seen.precision), 3)


def test_one_feature_beyond_all_that_was_seen_is_found_among_many(rng: np.random.Generator) -> None:
    """Half its range beyond it, in one of forty that all hang together."""
    common = rng.standard_normal((300, 1))
    values = common + 0.2 * rng.standard_normal((300, 40))
    labels = np.array(["a", "b"])[rng.integers(0, 2, 300)]
    seen = seen_classes(values, labels)
    np.testing.assert_array_equal(seen.excess(values), 0.0)
    low, high = np.sinh(seen.low[7]), np.sinh(seen.high[7])
    one = values[:1].copy()
    one[0, 7] = np.sinh(seen.high[7] + 0.5 * (seen.high[7] - seen.low[7]))
    found = seen.excess(one)
    assert low < values[0, 7] < high < one[0, 7]
    assert found[0].argmax() == 7
    assert found[0, 7] == pytest.approx(0.5, abs=1e-9)
    assert excess_norm(found)[0] == pytest.approx(0.5, abs=1e-9)
