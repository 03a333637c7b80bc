"""A limit on how long a stage may take: a plugin that hangs is its own fault, and the run goes on."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class StageTimeout(BaseException):
    """Raised within a stage whose time is up. No `Exception`, so that no ``except Exception`` keeps it."""


@contextmanager
def time_limit(limit_s: float | None) -> Iterator[None]:
    """Raise `StageTimeout` in what runs within once it has taken `limit_s` seconds; None: no limit.

    The system's timer does it, which Python has on Unix and in a process's main thread only: elsewhere there
    is no limit. Compiled code is interrupted when it returns to Python.
    """
    if (
        limit_s is None
        or not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
        or signal.getitimer(signal.ITIMER_REAL)[0]
    ):
        yield
        return

    def expired(number: int, frame: FrameType | None) -> None:
        raise StageTimeout

    before = signal.signal(signal.SIGALRM, expired)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
