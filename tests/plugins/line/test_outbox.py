"""The outbox: in order, once, whatever dies."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
import time

import pytest

from roemetry.errors import OutputError
from roemetry_line.outbox import NewRow, Outbox


def row(number: int, run: str = "r") -> NewRow:
    text = f'{{"n": {number}}}'
    return NewRow(f"l/{run}/{number:06d}#1", "s", run, "product", {"n": number}, text, f"{number}")


def test_rows_come_in_order_and_once(tmp_path) -> None:
    outbox = Outbox(tmp_path)
    outbox.put([row(1), row(2)])
    outbox.put([row(2), row(3)])
    assert [one.summary["n"] for one in outbox.after(0, 10)] == [1, 2, 3]
    assert outbox.mark("plc") == 0
    outbox.delivered("plc", 2)
    assert [one.summary["n"] for one in outbox.after(outbox.mark("plc"), 10)] == [3]
    assert outbox.waiting(["plc", "other"]) == {"plc": 1, "other": 3}


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


def test_records_of_a_run_follow_its_last_line(tmp_path) -> None:
    outbox = Outbox(tmp_path)
    outbox.put([row(1), row(1, "other"), row(2), row(3)])
    assert list(outbox.records_after("r", None)) == ["1", "2", "3"]
    assert list(outbox.records_after("r", "l/r/000002#1")) == ["3"]


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
    for _ in range(3):
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
