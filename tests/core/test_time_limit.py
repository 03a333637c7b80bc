"""Limits in the main thread, and in others, such as those of a cluster's workers."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from roemetry.run.time_limit import StageTimeout, not_counted, time_limit, timer_kept


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


def hangs_after_many_that_just_ended() -> str:
    ends_before()
    return hangs()


def does_not_count_what_others_do() -> str:
    with time_limit(0.2):
        with not_counted():
            works_for(0.5)
        works_for(0.01)
    try:
        with time_limit(0.2):
            with not_counted():
                works_for(0.1)
            works_for(60.0)
    except StageTimeout:
        return "it goes on"
    return "lost"


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
    [
        (hangs, "in time"),
        (ends_before, "undisturbed"),
        (hangs_after_many_that_just_ended, "in time"),
        (is_within_another, "the outer one holds"),
        (does_not_count_what_others_do, "it goes on"),
    ],
)
def test_a_limit_holds_in_every_thread_alone(does: Callable[[], str], comes_to: str) -> None:
    with ThreadPoolExecutor(2) as pool:
        beside = pool.submit(works_for, 0.3)
        assert pool.submit(does).result(timeout=60.0) == comes_to
        beside.result(timeout=60.0)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer")
def test_a_timer_that_is_kept_holds_each_limit_and_goes_back() -> None:
    before = signal.getsignal(signal.SIGALRM)
    with timer_kept():
        with time_limit(60.0):
            pass
        for _ in range(2):  # also after one that was up
            with pytest.raises(StageTimeout), time_limit(0.05), time_limit(60.0):
                works_for(60.0)
        works_for(0.1)  # nothing runs between limits
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer")
def test_a_timer_of_somebody_else_is_left_alone() -> None:
    signal.setitimer(signal.ITIMER_REAL, 60.0)
    try:
        with timer_kept(), time_limit(0.01):
            works_for(0.05)
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 50.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
