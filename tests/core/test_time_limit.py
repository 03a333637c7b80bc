"""Limits in threads that are not the main one, such as those of a cluster's workers."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from roemetry.run.time_limit import StageTimeout, time_limit


def works_for(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def hangs() -> str:
    begin = time.monotonic()
    try:
        with time_limit(0.1):
            while True:
                try:
                    works_for(60.0)
                except Exception:  # what a careless plugin writes
                    continue
    except StageTimeout:
        works_for(0.15)  # nothing is raised a second time
        return "in time" if time.monotonic() - begin < 5.0 else "late"


def ends_before() -> str:
    with time_limit(60.0):
        pass
    for _ in range(2000):  # some of them end in the very moment in which their time is up
        try:
            with time_limit(1e-5):
                works_for(1e-5)
        except StageTimeout:
            continue
    works_for(0.05)
    return "undisturbed"


def is_within_another() -> str:
    try:
        with time_limit(0.1):
            with time_limit(60.0):
                pass
            works_for(60.0)
    except StageTimeout:
        return "the outer one holds"
    return "lost"


@pytest.mark.parametrize(
    ("does", "comes_to"),
    [(hangs, "in time"), (ends_before, "undisturbed"), (is_within_another, "the outer one holds")],
)
def test_a_limit_holds_in_every_thread_alone(does: Callable[[], str], comes_to: str) -> None:
    with ThreadPoolExecutor(2) as pool:
        beside = pool.submit(works_for, 0.3)
        assert pool.submit(does).result() == comes_to
        beside.result()
