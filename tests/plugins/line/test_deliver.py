"""Who takes rows from the outbox to an outlet: drains when asked to stop, and then lets it be."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from roemetry_line.deliver import Deliverer
from roemetry_line.outbox import Outbox
from tests.plugins.line.test_outbox import row


class Taken:
    """An outlet that keeps what it is given."""

    def __init__(self) -> None:
        self.opened = 0
        self.keys: list[str] = []
        self.line: Any = None

    def make(self) -> Taken:
        return self

    @contextmanager
    def open(self) -> Any:
        self.opened += 1
        yield lambda rows: self.keys.extend(one.key for one in rows)


@pytest.mark.parametrize("asked_before", [False, True], ids=["at work", "before it begins"])
def test_who_is_asked_to_stop_drains_and_does_not_open_again(tmp_path, asked_before) -> None:
    outbox, taken, stop = Outbox(tmp_path), Taken(), threading.Event()
    outbox.put([row(n) for n in range(1, 251)])
    line: Any = SimpleNamespace(name="l", path=tmp_path / "line.yaml", folder=tmp_path, stations=())
    named: Any = SimpleNamespace(name="plc", outlet=taken)
    worker = Deliverer(named, line, outbox, threading.Condition(), stop)
    if asked_before:
        stop.set()
    thread = threading.Thread(target=worker.run)
    thread.start()
    until_s = time.monotonic() + 10.0
    while len(taken.keys) < 250 and time.monotonic() < until_s:
        time.sleep(0.01)
    stop.set()
    thread.join(10.0)
    assert not thread.is_alive()
    assert time.monotonic() < until_s
    assert taken.keys == [f"l/r/{n:06d}#1" for n in range(1, 251)]
    assert taken.opened == 1
    assert outbox.mark("plc") == 250
