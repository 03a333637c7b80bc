"""The time that is left is told by what steps cost, not by how many there are."""

from __future__ import annotations

import math

import pytest

from roemetry.run.pace import Pace


class Clock:
    """A clock that is put forward by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_few_dear_steps_after_many_cheap_ones_are_told_by_their_own_cost() -> None:
    clock = Clock()
    pace = Pace({"cheap": 10, "dear": 3}, clock=clock)
    assert math.isnan(pace.left_s())
    for _ in range(10):
        clock.now += 0.1
        pace.done("cheap")
    assert pace.left_s() == pytest.approx(0.3)  # nothing is known of the dear ones yet
    clock.now += 20.0
    pace.done("dear")
    assert pace.left_s() == pytest.approx(40.0)
    for _ in range(2):
        clock.now += 20.0
        pace.done("dear")
    assert pace.left_s() == 0.0


def test_a_kind_that_has_not_come_yet_costs_what_is_said_of_it() -> None:
    clock = Clock()
    pace = Pace({"image": 4, "fit": 1}, cost={"fit": 10.0}, clock=clock)
    clock.now += 2.0
    pace.done("image")
    assert pace.left_s() == pytest.approx(3 * 2.0 + 20.0)
