"""Belt that may be a level body's, and what speaks against it."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_kernels.coding.level_bodies import goes_through

ROWS = 240
INSIDE = slice(100, 160)


def marked(off_px: np.ndarray, first: int = 0) -> np.ndarray:
    found = np.zeros(ROWS, bool)
    found[INSIDE] = True
    piece = np.zeros(ROWS, np.int64)
    return goes_through(piece[first:], off_px[first:], found[first:])


@pytest.mark.parametrize("step_px", [0.0, 0.3, -1.0])
def test_a_line_without_a_step_is_belt_and_one_with_a_step_may_be_a_body(
    step_px: float, rng: np.random.Generator
) -> None:
    """0.3 px are some 0.2 mm: so near to a label's height would a body's top have to be."""
    off_px = rng.normal(0.0, 0.1, ROWS)
    off_px[INSIDE] += step_px
    found = marked(off_px)
    assert found[INSIDE].all() == (step_px == 0.0)
    assert not found[: INSIDE.start].any() and not found[INSIDE.stop :].any()


def test_a_piece_that_begins_with_it_has_nothing_to_compare_with(rng: np.random.Generator) -> None:
    assert not marked(rng.normal(0.0, 0.1, ROWS), first=INSIDE.start - 3).any()
