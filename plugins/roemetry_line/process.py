"""How the processes of a line end: when asked, and a child also when the process that started it is gone."""

from __future__ import annotations

import gc
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from roemetry.errors import OutputError
from roemetry.io.files import exclusive, make_folder

_WAIT_S = 0.2  # between two tries


def runs_now(folder: Path) -> bool:
    """Say whether a line runs that keeps its data in this folder."""
    try:
        with exclusive(folder):
            return False
    except (OutputError, PermissionError):  # its lock is there, or another user's
        return True


@contextmanager
def alone(folder: Path, name: str, stop: threading.Event) -> Iterator[bool]:
    """Be the one process of this name; wait for one of the line before, which drains. False: told to stop.

    Who is told to stop before that is asked for the place once all the same: what waits can still be drained.
    """
    own = folder / "locks" / name
    make_folder(own)
    first = True
    while first or not stop.is_set():
        first = False
        kept = exclusive(own)
        try:
            kept.__enter__()
        except OutputError:
            stop.wait(_WAIT_S)
            continue
        try:
            yield True
        finally:
            kept.__exit__(None, None, None)
        return
    yield False


def settle() -> None:
    """Keep the interpreter from stopping the line: call it once everything is loaded.

    What is loaded stays, so that the collector need not look through it again (some 100 ms), and a thread
    that has a row to hand on waits 0.5 ms for the interpreter, not 5.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(5e-4)


def off_main_thread(work: Callable[[], None]) -> None:
    """Do what measures in a thread, and raise what it raises.

    In the main thread the limit on a stage's time (`time_limit`) takes SIGALRM, and gives it back as Python
    knows it. But pylon has timers and a handler of its own for that signal, which Python does not know of:
    the system's default is given back, and the next of pylon's timers ends the process.
    """
    with ThreadPoolExecutor(1) as thread:
        thread.submit(work).result()


def set_by(signals: Sequence[signal.Signals]) -> threading.Event:
    """Give an event that is set by these signals.

    A thread sets it: done by the handler itself, `Event.set` could wait for a lock that the interrupted
    code holds.
    """
    stop = threading.Event()
    reading, writing = os.pipe()
    for number in signals:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores SIGHUP: so shall we
            signal.signal(number, lambda number, frame: os.write(writing, b"\0") and None)

    def watch() -> None:
        os.read(reading, 1)
        stop.set()

    threading.Thread(target=watch, daemon=True).start()
    return stop


def stop_event() -> threading.Event:
    """Give an event that is set on SIGTERM, and when the process that started this one is gone.

    The parent holds the other end of the standard input: when it dies, however that is, the pipe ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ^C is the parent's to handle
    stop = set_by([signal.SIGTERM])

    def watch() -> None:
        while select.select([sys.stdin], [], [])[0] and os.read(sys.stdin.fileno(), 4096):
            pass
        stop.set()

    threading.Thread(target=watch, daemon=True).start()
    return stop
