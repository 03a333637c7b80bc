"""Light that is faint beside its neighbours is cheap to leave out."""

from __future__ import annotations

import numpy as np

from roemetry_coding.planes.pieces import relative_light


def test_light_is_held_against_the_median_of_two_on_either_side(rng: np.random.Generator) -> None:
    rows = [rng.uniform(1.0, 100.0, count) for count in (0, 1, 2, 3, 9)]
    expected = []
    for row in rows:
        for p, own in enumerate(row):
            beside = np.delete(row, p)[max(0, p - 2) : p + 2]
            expected.append(min(1.0, own / np.median(beside)) if beside.size else 1.0)
    row_start = np.cumsum([0, *(row.size for row in rows)])
    found = relative_light(row_start, np.concatenate(rows))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_what_is_not_known_is_as_bright_as_any() -> None:
    np.testing.assert_array_equal(relative_light(np.array([0, 3]), np.full(3, np.nan)), 1.0)
