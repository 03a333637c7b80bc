"""A limit on how long a stage may take: a plugin that hangs is its own fault, and the run goes on."""

from __future__ import annotations

import ctypes
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import FrameType
from typing import Any


class StageTimeout(BaseException):
    """Raised within a stage whose time is up. No `Exception`, so that no ``except Exception`` keeps it."""


def time_limit(limit_s: float | None) -> AbstractContextManager[None]:
    """Raise `StageTimeout` in what runs within once it has taken `limit_s` seconds; None: no limit.

    In a process's main thread the system's timer does it, where there is one (not on Windows): it wakes what
    sleeps or waits, too. In any other thread, such as those of a cluster's workers, a second thread does it:
    what sleeps or waits there is interrupted when it returns. So is compiled code, in every thread.
    """
    if limit_s is None:
        return nullcontext()
    return _ByTimer(limit_s) if _has_timer() else _by_watch(limit_s)


@contextmanager
def timer_kept() -> Iterator[None]:
    """Take the system's timer for all limits within at once: for each by itself it takes as long as a stage.

    Only a main thread has one, and only where nobody else has set it; else nothing is done. Who else sets the
    timer or its signal within is overridden by the next limit.
    """
    if not _has_timer() or not _timer.take():
        yield
        return
    try:
        yield
    finally:
        _timer.give_back()


def _has_timer() -> bool:
    return threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")


@contextmanager
def not_counted() -> Iterator[None]:
    """Stop the clock of this thread's limit, if it has one, for what runs within; afterwards it goes on.

    In a main thread with a timer, that of whoever set it.
    """
    if _has_timer():
        left_s = signal.setitimer(signal.ITIMER_REAL, 0.0)[0]
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, left_s)
        return
    thread = threading.get_ident()
    left = _watch.pause(thread)
    try:
        yield
    finally:
        if left is not None:
            _watch.begin(thread, left)


class _ByTimer:
    """A limit in the main thread; a class, since every stage of every frame has one."""

    __slots__ = ("_begun", "_limit_s", "_took")

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s

    def __enter__(self) -> None:
        self._took = _timer.take()
        self._begun = _timer.begin(self._limit_s)

    def __exit__(self, *_: object) -> None:
        try:
            if self._begun:
                _timer.end()
        finally:
            if self._took:
                _timer.give_back()


@contextmanager
def _by_watch(limit_s: float) -> Iterator[None]:
    thread = threading.get_ident()
    begun = _watch.begin(thread, limit_s)
    try:
        yield
    finally:
        if begun:
            _watch.end(thread)


class _Timer:
    """Raises `StageTimeout` in the main thread, by the system's timer."""

    def __init__(self) -> None:
        self._before: Any = None
        self._taken = self._runs = False

    def take(self) -> bool:
        """Have the timer's signal raise; False where that is so already, or the timer is somebody else's."""
        if self._taken or signal.getitimer(signal.ITIMER_REAL)[0]:
            return False
        self._before = signal.signal(signal.SIGALRM, self._expired)
        self._taken = True
        return True

    def give_back(self) -> None:
        """Leave the signal to whoever had it."""
        self._taken = False
        signal.signal(signal.SIGALRM, self._before)

    def begin(self, limit_s: float) -> bool:
        """Begin a limit; False where one runs already, which stays, or the timer is not ours."""
        if self._runs or not self._taken:
            return False
        self._runs = True
        signal.setitimer(signal.ITIMER_REAL, limit_s)
        return True

    def end(self) -> None:
        """End the limit that runs."""
        self._runs = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _expired(self, number: int, frame: FrameType | None) -> None:
        self._runs = False
        raise StageTimeout


class _Watch:
    """Raises `StageTimeout` in threads whose time is up, from a thread of its own."""

    def __init__(self) -> None:
        self._ends: dict[int, float] = {}
        self._raised: set[int] = set()
        self._looks_at = float("inf")
        self._changed = threading.Condition()
        self._started = False

    def begin(self, thread: int, limit_s: float) -> bool:
        """Give a thread so long from now; False where it has a limit already, which stays."""
        with self._changed:
            if thread in self._ends or thread in self._raised:  # one whose time is up is on its way, too
                return False
            if not self._started:
                self._started = True
                threading.Thread(target=self._run, name="roemetry-time-limit", daemon=True).start()
            self._ends[thread] = end = time.monotonic() + limit_s
            if end < self._looks_at:  # else it looks early enough: most stages end long before
                self._changed.notify()
            return True

    def pause(self, thread: int) -> float | None:
        """Take the limit away for a while and give what is left of it, s; None where there is none.

        Where its time is up already, `StageTimeout` is on its way and arrives.
        """
        with self._changed:
            end = self._ends.pop(thread, None)
        return None if end is None else max(0.0, end - time.monotonic())

    def end(self, thread: int) -> None:
        """Take the limit away; what was raised and did not arrive never will."""
        with self._changed:
            self._ends.pop(thread, None)
            if thread in self._raised:
                self._raised.discard(thread)
                _raise_in(thread, None)

    def _run(self) -> None:
        with self._changed:
            while True:
                now = time.monotonic()
                for thread in [thread for thread, end in self._ends.items() if end <= now]:
                    del self._ends[thread]
                    self._raised.add(thread)
                    _raise_in(thread, StageTimeout)
                self._looks_at = min(self._ends.values(), default=float("inf"))
                self._changed.wait(None if not self._ends else self._looks_at - now)


def _raise_in(thread: int, error: type[BaseException] | None) -> None:
    """Have a thread raise an error at its next step in Python; None: no longer."""
    given = None if error is None else ctypes.py_object(error)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), given)


_timer = _Timer()
_watch = _Watch()
