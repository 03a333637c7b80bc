"""Sizes of a study are the same whoever simulates them."""

from __future__ import annotations

import pickle

import pytest

from roemetry.errors import InterruptedRunError
from roemetry.run.executors import Lost
from roemetry_study.gauge import plan

SIZES = ((5, 2, 2), (5, 3, 2))


class Elsewhere:
    """Does what it is given as another process would: from pickles, a worker for each task."""

    def in_order(self, make, given, tasks):
        for task in tasks:
            worker = make(*pickle.loads(pickle.dumps(given)))
            yield pickle.loads(pickle.dumps(worker(pickle.loads(pickle.dumps(task)))))


class Loses:
    """Loses what it is given."""

    def in_order(self, make, given, tasks):
        yield from (Lost(task, "its worker died") for task in tasks)


def test_a_plan_is_the_same_by_any_executor() -> None:
    here = list(plan(1.0, 0.2, 0.1, SIZES, studies=3))
    assert list(plan(1.0, 0.2, 0.1, SIZES, studies=3, executor=Elsewhere())) == here
    assert [size[:3] for size in here] == list(SIZES)
    with pytest.raises(InterruptedRunError, match="a simulated study was lost: its worker died"):
        list(plan(1.0, 0.2, 0.1, SIZES, studies=3, executor=Loses()))
