"""A process of a line has its place to itself, drains even if asked to stop first, and lets drivers be."""

from __future__ import annotations

import ctypes
import signal
import threading
from pathlib import Path

import pytest

from roemetry.run.time_limit import time_limit
from roemetry_line.process import alone, off_main_thread


def test_who_is_told_to_stop_before_it_begins_drains_what_waits(tmp_path: Path) -> None:
    stop = threading.Event()
    stop.set()
    with alone(tmp_path, "outlets", stop) as mine:
        assert mine
        with alone(tmp_path, "outlets", stop) as other:
            assert not other, "one of the line before drains"
    with alone(tmp_path, "outlets", stop) as again:
        assert again


def limited() -> None:
    with time_limit(60.0):
        pass


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer that interrupts")
def test_a_drivers_own_handler_of_the_alarm_stays() -> None:
    """pylon's timers raise SIGALRM for a handler that Python does not know of."""
    of_c = ctypes.CDLL(None).signal
    of_c.restype, of_c.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)
    before = of_c(signal.SIGALRM, signal.SIG_IGN)  # as a driver would, in place of its handler
    try:
        off_main_thread(limited)
    finally:
        after = of_c(signal.SIGALRM, before)
    assert after == signal.SIG_IGN


def test_what_is_raised_off_the_main_thread_ends_the_process() -> None:
    def broken() -> None:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        off_main_thread(broken)
