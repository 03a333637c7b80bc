"""What is left of bodies of which nearly all was refused."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry.records import AMBIGUOUS
from roemetry_coding.planes import _remnants


@pytest.mark.parametrize(("left", "refused"), [(0, 50), (4, 50), (6, 50), (40, 10), (3, 0)])
def test_a_tenth_or_less_of_the_bodies_goes_with_the_rest(left: int, refused: int) -> None:
    """Belt stays, and so does what was refused on it out of the count."""
    line = np.array([2] * 30 + [-1] * left + [-1] * refused + [2] * 500)
    stripe = np.array([2] * 30 + [1] * left + [AMBIGUOUS] * refused + [AMBIGUOUS] * 500)
    found = _remnants(line, stripe)
    assert not found[:30].any()
    assert not found[30 + left :].any()
    assert found[30 : 30 + left].all() == (left < 0.1 * (left + refused))
