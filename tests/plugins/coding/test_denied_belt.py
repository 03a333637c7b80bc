"""A body that has a stripe where that stripe's belt was seen is in doubt as a whole."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_coding.planes.lines import Entries
from roemetry_coding.planes.vetoes import denies_belt


@pytest.mark.parametrize(("denied", "doubted"), [(0, False), (4, False), (8, True), (40, True)])
def test_a_body_may_not_leave_out_belt_of_its_own_stripes(denied: int, doubted: bool) -> None:
    """Each of 60 lines holds two stripes of a body, and some amid it the belt of the second, left out."""
    lines = np.arange(60)
    order = np.tile([0, 1, 2], 60)
    stripe = np.tile([1, 2, -1], 60)
    line = np.where(order == 2, 2, -1)
    amid = (lines >= 10) & (lines < 10 + denied)
    line[(order == 2) & ~np.repeat(amid, 3)] = 5  # of a stripe that the body has not
    none = np.full(order.size, -1)
    entries = Entries(
        np.arange(0, order.size + 1, 3), np.arange(order.size), np.arange(float(order.size)), none, none,
        np.zeros(order.size),
    )  # fmt: skip
    body = np.where(order == 2, 0, 1)
    found = denies_belt(entries, line, stripe, body, np.ones(body.size))
    np.testing.assert_array_equal(found, doubted & (body == 1))


def test_belt_of_another_bodys_stripe_is_no_doubt() -> None:
    """Two bodies; the belt that is left out is of a stripe which only the second one has."""
    stripe, line, body = np.tile([1, 4, -1], 20), np.tile([-1, -1, 4], 20), np.tile([1, 2, 0], 20)
    none = np.full(stripe.size, -1)
    entries = Entries(
        np.arange(0, stripe.size + 1, 3), np.arange(stripe.size), np.arange(float(stripe.size)), none, none,
        np.zeros(stripe.size),
    )  # fmt: skip
    np.testing.assert_array_equal(denies_belt(entries, line, stripe, body, np.ones(body.size)), body == 2)


def test_light_over_a_bodys_edge_is_no_doubt() -> None:
    """An edge askew to the lines: the belt of each of 14 stripes reaches over it, 4 lines at either end."""
    stripes, lines, spread = 14, 30, 4
    start, stripe, line = [0], [], []
    for e in range(spread * stripes + lines):
        for s in range(stripes):
            since = e - spread * s  # the body's edge meets each stripe that much later
            if not 0 <= since < lines:
                continue
            stripe.append(s)
            line.append(-1)
            if since < spread or since >= lines - spread:
                stripe.append(-1)
                line.append(s)
        start.append(len(stripe))
    said, on = np.array(stripe), np.array(line)
    none = np.full(said.size, -1)
    entries = Entries(
        np.array(start), np.arange(said.size), np.arange(float(said.size)), none, none, np.zeros(said.size)
    )
    assert not denies_belt(entries, on, said, np.where(said >= 0, 1, 0), np.ones(said.size)).any()


@pytest.mark.parametrize(("share", "glows"), [(0.2, True), (0.5, False)])
def test_light_that_came_through_the_body_is_refused_and_the_body_is_not(share: float, glows: bool) -> None:
    """A stripe on 40 lines, the last 14 of them so faint; on ten of these its belt was seen and left out."""
    lines = np.arange(40)
    stripe, body = np.tile([1, -1], 40), np.tile([1, 0], 40)
    line = np.where((body == 0) & np.repeat((lines >= 26) & (lines < 36), 2), 1, -1)
    amplitude = np.where((body == 1) & np.repeat(lines >= 26, 2), share, 1.0)
    none = np.full(body.size, -1)
    entries = Entries(
        np.arange(0, body.size + 1, 2), np.arange(body.size), np.arange(float(body.size)), none, none,
        np.zeros(body.size),
    )  # fmt: skip
    refused = (amplitude < 1.0) if glows else (body == 1)
    np.testing.assert_array_equal(denies_belt(entries, line, stripe, body, amplitude), refused)
