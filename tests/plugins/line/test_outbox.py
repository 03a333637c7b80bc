"""The outbox: in order, once, whatever dies; who delivers from it; processes that have their place alone."""

from __future__ import annotations

import ctypes
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from roemetry.errors import OutputError
from roemetry.run.time_limit import time_limit
from roemetry_line.deliver import Deliverer
from roemetry_line.outbox import NewRow, Outbox
from roemetry_line.process import alone, off_main_thread
from tests.plugins.line.loopback import keys, wait_for


def row(number: int, run: str = "r") -> NewRow:
    text = f'{{"n": {number}}}'
    return NewRow(f"l/{run}/{number:06d}#1", "s", run, "product", {"n": number}, text, f"{number}")


def test_rows_come_in_order_and_once(tmp_path) -> None:
    outbox = Outbox(tmp_path)
    outbox.put([row(1), row(2)])
    outbox.put([row(2), row(3), row(1, "other")])
    assert [one.summary["n"] for one in outbox.after(0, 10)] == [1, 2, 3, 1]
    assert outbox.mark("plc") == 0
    outbox.delivered("plc", 2)
    assert [one.summary["n"] for one in outbox.after(outbox.mark("plc"), 10)] == [3, 1]
    assert outbox.waiting(["plc", "other"]) == {"plc": 2, "other": 4}
    assert list(outbox.records_after("r", None)) == ["1", "2", "3"]
    assert list(outbox.records_after("r", "l/r/000002#1")) == ["3"]


def test_what_waits_is_not_pruned(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("roemetry_line.outbox._KEPT", 2)
    monkeypatch.setattr("roemetry_line.outbox._AT_ONCE", 2)
    outbox = Outbox(tmp_path)
    outbox.put([row(n) for n in range(1, 11)])
    outbox.delivered("plc", 3)
    assert not outbox.prune(["plc", "new"])
    assert len(outbox.after(0, 100)) == 10  # `new` has none yet
    outbox.delivered("new", 10)
    assert outbox.prune(["plc", "new"])
    assert not outbox.prune(["plc", "new"])
    assert [one.summary["n"] for one in outbox.after(0, 100)] == list(range(4, 11))


def test_an_alarm_is_open_once_and_ends(tmp_path) -> None:
    outbox = Outbox(tmp_path)
    assert outbox.raise_alarm("s", "camera", "gone")
    assert not outbox.raise_alarm("s", "camera", "still gone")
    (one,) = outbox.alarms()
    assert (one["text"], one["ended"]) == ("still gone", None)
    assert outbox.open_alarms("s") == {"camera"}
    assert outbox.acknowledge(one["n"], "otto")
    assert not outbox.acknowledge(one["n"], "otto")
    assert outbox.end_alarm("s", "camera")
    assert outbox.open_alarms("s") == set()
    assert outbox.raise_alarm("s", "camera", "gone again")


def test_a_file_that_is_no_database_is_named(tmp_path) -> None:
    (tmp_path / "line.sqlite").write_text("not a database" * 100)
    with pytest.raises(OutputError, match=r"line\.sqlite"):
        Outbox(tmp_path)


def test_every_row_that_put_returned_for_survives_kills(tmp_path) -> None:
    program = (
        "import sys; from tests.plugins.line.test_outbox import row; from roemetry_line.outbox import Outbox;"
        "from pathlib import Path; o = Outbox(Path(sys.argv[1]));"
        "[(o.put([row(n)]), print(n, flush=True)) for n in range(int(sys.argv[2]), 10**9)]"
    )
    told = 0
    for _ in range(2):
        process = subprocess.Popen(
            [sys.executable, "-c", program, str(tmp_path), str(told + 1)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.1)
        process.send_signal(signal.SIGKILL)
        rest, _ = process.communicate()
        told = max([told + 1, *map(int, rest.split()[:-1])])
    with sqlite3.connect(tmp_path / "line.sqlite") as db:
        found = [n for (n,) in db.execute("select cast(text ->> '$.n' as integer) from rows order by n")]
    db.close()
    assert found[:told] == list(range(1, told + 1))


class Taken:
    """An outlet that keeps what it is given."""

    def __init__(self) -> None:
        self.opened, self.keys = 0, list[str]()
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
    thread = threading.Thread(target=Deliverer(named, line, outbox, threading.Condition(), stop).run)
    if asked_before:
        stop.set()
    thread.start()
    wait_for(lambda: len(taken.keys) >= 250, "they are not delivered", 10.0)
    stop.set()
    thread.join(10.0)
    assert not thread.is_alive()
    assert taken.keys == keys(*range(1, 251))
    assert taken.opened == 1
    assert outbox.mark("plc") == 250


def test_who_is_told_to_stop_before_it_begins_drains_what_waits(tmp_path: Path) -> None:
    stop = threading.Event()
    stop.set()
    with alone(tmp_path, "outlets", stop) as mine:
        assert mine
        with alone(tmp_path, "outlets", stop) as other:
            assert not other, "one of the line before drains"
    with alone(tmp_path, "outlets", stop) as again:
        assert again


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer that interrupts")
def test_a_drivers_own_handler_of_the_alarm_stays() -> None:
    """pylon's timers raise SIGALRM for a handler that Python does not know of."""

    def limited() -> None:
        with time_limit(60.0):
            pass

    of_c = ctypes.CDLL(None).signal
    of_c.restype, of_c.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)
    before = of_c(signal.SIGALRM, signal.SIG_IGN)  # as a driver would, in place of its handler
    try:
        off_main_thread(limited)
    finally:
        after = of_c(signal.SIGALRM, before)
    assert after == signal.SIG_IGN


def test_what_is_raised_off_the_main_thread_ends_the_process() -> None:
    with pytest.raises(ZeroDivisionError):
        off_main_thread(lambda: 1 / 0)
