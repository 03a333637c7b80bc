"""A body that has a stripe where that stripe's belt was seen is in doubt as a whole."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.vetoes import denies_belt


@pytest.mark.parametrize(("denied", "doubted"), [(0, False), (4, False), (8, True), (40, True)])
def test_a_body_may_not_leave_out_belt_of_its_own_stripes(denied: int, doubted: bool) -> None:
    """Each of 40 lines holds two stripes of a body, and on some the belt of the second one, left out."""
    lines = np.arange(40)
    order = np.tile([0, 1, 2], 40)
    stripe = np.tile([1, 2, -1], 40)
    line = np.where(order == 2, 2, -1)
    line[(order == 2) & (np.repeat(lines, 3) >= denied)] = 5  # of a stripe that the body has not
    none = np.full(order.size, -1)
    entries = Entries(
        np.arange(0, order.size + 1, 3), np.arange(order.size), np.arange(float(order.size)), none, none,
        np.zeros(order.size),
    )  # fmt: skip
    body = np.where(order == 2, 0, 1)
    np.testing.assert_array_equal(denies_belt(entries, line, stripe, body), doubted & (body == 1))


def test_belt_of_another_bodys_stripe_is_no_doubt() -> None:
    """Two bodies; the belt that is left out is of a stripe which only the second one has."""
    stripe, line, body = np.tile([1, 4, -1], 20), np.tile([-1, -1, 4], 20), np.tile([1, 2, 0], 20)
    none = np.full(stripe.size, -1)
    entries = Entries(
        np.arange(0, stripe.size + 1, 3), np.arange(stripe.size), np.arange(float(stripe.size)), none, none,
        np.zeros(stripe.size),
    )  # fmt: skip
    np.testing.assert_array_equal(denies_belt(entries, line, stripe, body), body == 2)
