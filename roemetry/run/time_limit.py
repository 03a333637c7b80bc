"""A limit on how long a stage may take: a plugin that hangs is its own fault, and the run goes on."""

from __future__ import annotations

import ctypes
import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from queue import Empty, SimpleQueue
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
    limit = _watch.pause()
    try:
        yield
    finally:
        if limit is not None:
            _watch.resume(limit)


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
    begun = _watch.begin(limit_s)
    try:
        yield
    finally:
        if begun is not None:
            _watch.end(begun)


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


class _Limit:
    """A limit of a thread that is no main thread."""

    __slots__ = ("end_s", "left_s", "raised", "thread")

    def __init__(self, limit_s: float) -> None:
        self.thread, self.raised = threading.get_ident(), False
        self.left_s, self.end_s = limit_s, math.inf


class _Watch:
    """Raises `StageTimeout` in threads whose time is up, from a thread of its own.

    The error may arrive at any step of such a thread, also here. A lock that it held then would stay locked,
    and every later limit would wait for it; so threads that have limits take no lock. Whoever takes a limit
    out of `_running`, one step for Python, decides what becomes of it.
    """

    def __init__(self) -> None:
        self._running: dict[_Limit, None] = {}
        self._of_thread = threading.local()
        self._looks_at_s = math.inf
        self._earlier = SimpleQueue[None]()
        self._starting, self._started = threading.Lock(), False

    def begin(self, limit_s: float) -> _Limit | None:
        """Give this thread so long from now; None where it has a limit already, which stays."""
        if getattr(self._of_thread, "limit", None) in self._running:
            return None
        if not self._started:
            self._start()
        self._of_thread.limit = limit = _Limit(limit_s)
        self.resume(limit)
        return limit

    def pause(self) -> _Limit | None:
        """Stop the clock of this thread's limit; None where there is none.

        Where its time is up already, `StageTimeout` is on its way and arrives.
        """
        limit: _Limit | None = getattr(self._of_thread, "limit", None)
        if limit is None or self._running.pop(limit, _GONE) is _GONE:
            return None
        limit.left_s = max(0.0, limit.end_s - time.monotonic())
        return limit

    def resume(self, limit: _Limit) -> None:
        """Let a limit's clock go on."""
        limit.end_s = time.monotonic() + limit.left_s
        self._running[limit] = None
        if limit.end_s < self._looks_at_s:  # else it looks early enough: most stages end long before
            self._earlier.put(None)

    def end(self, limit: _Limit) -> None:
        """Take a limit away; what was raised and did not arrive never will."""
        if self._running.pop(limit, _GONE) is not _GONE:
            return
        while not limit.raised:  # its time is up, and the error arrives at any step from here on
            time.sleep(0.0)
        _raise_in(limit.thread, None)

    def _start(self) -> None:
        with self._starting:
            if not self._started:
                threading.Thread(target=self._run, name="roemetry-time-limit", daemon=True).start()
                self._started = True

    def _run(self) -> None:
        while True:
            self._looks_at_s = math.inf  # what begins while this looks says so
            now_s, next_s = time.monotonic(), math.inf
            for limit in list(self._running):
                if limit.end_s > now_s:
                    next_s = min(next_s, limit.end_s)
                elif self._running.pop(limit, _GONE) is not _GONE:
                    _raise_in(limit.thread, StageTimeout)
                    limit.raised = True
            self._looks_at_s = next_s
            with suppress(Empty):
                self._earlier.get(timeout=None if next_s == math.inf else max(0.0, next_s - time.monotonic()))


_GONE = object()


def _raise_in(thread: int, error: type[BaseException] | None) -> None:
    """Have a thread raise an error at its next step in Python; None: no longer."""
    given = None if error is None else ctypes.py_object(error)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), given)


_timer = _Timer()
_watch = _Watch()
