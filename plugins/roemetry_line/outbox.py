"""The outbox: what a line has measured and said, in one SQLite file that every process of the line opens.

A row is in the outbox, whole, before anything else is done with it: that is the moment from which it cannot
get lost. Outlets read it in order, each with a mark of its own of how far it has got; the record of a run
is written from it. WAL with ``synchronous=NORMAL`` keeps every committed row through the death of any
process; a loss of power may take the last fraction of a second, which the spooled frames make up for.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from roemetry.errors import OutputError
from roemetry.records.live import LineRow

FILE = "line.sqlite"
_WAKE = "wake"

_TABLES = """
create table if not exists rows(
    n integer primary key autoincrement, key text not null unique, station text not null, run text not null,
    kind text not null, at real not null, summary text not null, text text not null, record text);
create index if not exists rows_of_run on rows(run, n);
create table if not exists marks(outlet text primary key, n integer not null);
create table if not exists alarms(
    n integer primary key autoincrement, at real not null, station text not null, code text not null,
    text text not null, level text not null, ended real, acknowledged real, acknowledged_by text);
create index if not exists open_alarms on alarms(station, code) where ended is null;
create table if not exists wishes(station text primary key, recipe text not null, who text not null);
create table if not exists checks(
    n integer primary key autoincrement, station text not null, asked real not null, who text not null,
    ended real, verdict text, text text);
create table if not exists health(
    component text primary key, pid integer not null, at real not null, state text not null, figures text
    not null);
"""
_BUSY_S = 10.0
"""How long a writer waits for another, s: each holds the file for well under a tenth of that."""
_KEPT = 10_000
"""Delivered rows that stay, for whoever asks for the last ones: an hour at three a second."""
_AT_ONCE = 100
"""Rows that are taken out at once: a thousand would keep a station that writes waiting."""

Level = Literal["note", "warning", "alarm"]


@dataclass(frozen=True, slots=True)
class NewRow:
    """A row to be put into the outbox."""

    key: str
    station: str
    run: str
    kind: Literal["product", "notice"]
    summary: Mapping[str, str | float | int | None]
    text: str
    record: str | None = None
    """Its line of the run's record; None for a notice."""


class Outbox:
    """A line's outbox, opened by one process; its methods may be called from several threads."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = threading.RLock()
        self._path = folder / FILE
        with _named(self._path):
            self._db = sqlite3.connect(
                self._path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False
            )
            self._db.execute("pragma journal_mode=wal")
            self._db.execute("pragma synchronous=normal")
            # Else whoever commits the thousandth page waits for the disk: `checkpoint` does it beside.
            self._db.execute("pragma wal_autocheckpoint=0")
            self._db.executescript(_TABLES)
        self._wake = _fifo(folder / _WAKE)

    def put(self, rows: Sequence[NewRow]) -> None:
        """Add rows in order, all or none; one whose key is there stays as it is. OutputError if it cannot."""
        now = time.time()
        values = [
            (r.key, r.station, r.run, r.kind, now, json.dumps(r.summary, allow_nan=False), r.text, r.record)
            for r in rows
        ]
        with self._lock, _named(self._path), self._transaction():
            self._db.executemany(
                "insert or ignore into rows(key, station, run, kind, at, summary, text, record) "
                "values(?,?,?,?,?,?,?,?)",
                values,
            )
        self.wake()

    def checkpoint(self) -> None:
        """Write what was committed into the file itself; nobody who reads or writes waits for it."""
        with _named(self._path), closing(sqlite3.connect(self._path, timeout=0.0)) as beside:
            beside.execute("pragma wal_checkpoint(passive)")

    def wake(self) -> None:
        """Tell who waits that there is something new."""
        with suppress(OSError):
            os.write(self._wake, b"\0")

    def listen(self, wait_s: float) -> None:
        """Wait until there is something new, at most so long; for one process."""
        import select

        if select.select([self._wake], [], [], wait_s)[0]:
            with suppress(OSError):
                os.read(self._wake, 4096)

    def after(self, number: int, many: int) -> list[LineRow]:
        """Give up to so many rows after the one of this number."""
        with self._lock, _named(self._path):
            found = self._db.execute(
                "select n, key, kind, summary, text from rows where n > ? order by n limit ?", (number, many)
            ).fetchall()
        return [LineRow(n, key, kind, json.loads(summary), text) for n, key, kind, summary, text in found]

    def records_after(self, run: str, key: str | None) -> Iterator[str]:
        """Give the record lines of a run that come after the row of this key (None: all)."""
        with self._lock, _named(self._path):
            found = self._db.execute("select n from rows where key = ?", (key or "",)).fetchone()
            lines = self._db.execute(
                "select record from rows where run = ? and n > ? and record is not null order by n",
                (run, found[0] if found else 0),
            ).fetchall()
        return (line for (line,) in lines)

    def mark(self, outlet: str) -> int:
        """Give the number of the last row that an outlet has delivered; 0 for none yet."""
        with self._lock, _named(self._path):
            found = self._db.execute("select n from marks where outlet = ?", (outlet,)).fetchone()
        return int(found[0]) if found else 0

    def delivered(self, outlet: str, number: int) -> None:
        """Note that an outlet has delivered everything up to this row."""
        with self._lock, _named(self._path):
            self._db.execute(
                "insert into marks(outlet, n) values(?, ?) on conflict(outlet) do update set n = excluded.n",
                (outlet, number),
            )

    def waiting(self, outlets: Sequence[str]) -> dict[str, int]:
        """Count, by outlet, the rows that it has still to deliver."""
        return {name: self._count_after(self.mark(name)) for name in outlets}

    def prune(self, outlets: Sequence[str]) -> bool:
        """Take out some of what every outlet has, but for the last rows; False where that was all."""
        done = min((self.mark(name) for name in outlets), default=None)
        with self._lock, _named(self._path):
            last = self._db.execute("select max(n) from rows").fetchone()[0] or 0
            until = last - _KEPT if done is None else min(done, last - _KEPT)
            self._db.execute(
                "delete from alarms where ended is not null and ended < ?", (time.time() - 30 * 86400,)
            )
            some = "select n from rows where n <= ? order by n limit ?"
            gone = self._db.execute(f"delete from rows where n in ({some})", (until, _AT_ONCE)).rowcount
            return gone == _AT_ONCE

    def raise_alarm(self, station: str, code: str, text: str, level: Level = "alarm") -> bool:
        """Note that something is wrong, once until it has ended; True where it is new."""
        with self._lock, _named(self._path), self._transaction():
            open_one = self._db.execute(
                "select n from alarms where station = ? and code = ? and ended is null", (station, code)
            ).fetchone()
            if open_one:
                self._db.execute("update alarms set text = ? where n = ?", (text, open_one[0]))
                return False
            now = time.time()
            self._db.execute(
                "insert into alarms(at, station, code, text, level, ended) values(?,?,?,?,?,?)",
                (now, station, code, text, level, now if level == "note" else None),
            )
        return True

    def end_alarm(self, station: str, code: str) -> bool:
        """Note that it is well again; True where something was wrong."""
        with self._lock, _named(self._path):
            changed = self._db.execute(
                "update alarms set ended = ? where station = ? and code = ? and ended is null",
                (time.time(), station, code),
            )
            return changed.rowcount > 0

    def open_alarms(self, station: str) -> set[str]:
        """Give the codes of what is wrong with a station now."""
        found = self._dicts("select code from alarms where station = ? and ended is null", (station,))
        return {str(one["code"]) for one in found}

    def acknowledge(self, number: int, who: str) -> bool:
        """Note that a person has seen an alarm; False where there is none of this number to be seen."""
        with self._lock, _named(self._path):
            changed = self._db.execute(
                "update alarms set acknowledged = ?, acknowledged_by = ? "
                "where n = ? and acknowledged is null",
                (time.time(), who, number),
            )
            return changed.rowcount > 0

    def alarms(self, many: int = 50) -> list[dict[str, Any]]:
        """Give the last alarms and notes, those that are open or not acknowledged first."""
        return self._dicts(
            "select * from alarms order by (ended is null) desc, "
            "(acknowledged is null and level != 'note') desc, n desc limit ?",
            (many,),
        )

    def last_rows(self, many: int) -> list[dict[str, Any]]:
        """Give the summaries of the last rows, the newest first."""
        found = self._dicts(
            "select n, key, station, run, kind, at, summary from rows order by n desc limit ?", (many,)
        )
        return [row | {"summary": json.loads(row["summary"])} for row in found]

    def wish(self, station: str, recipe: str, who: str) -> None:
        """Note which recipe somebody wants a station to measure with."""
        with self._lock, _named(self._path):
            self._db.execute("insert or replace into wishes values(?,?,?)", (station, recipe, who))

    def requested_recipe(self, station: str) -> str | None:
        """Give the recipe that is wanted of a station; None where nobody has said."""
        found = self._dicts("select recipe from wishes where station = ?", (station,))
        return str(found[0]["recipe"]) if found else None

    def ask_check(self, station: str, who: str) -> int:
        """Note that somebody wants a station to measure its known block; give the check's number."""
        with self._lock, _named(self._path), self._transaction():
            found = self._db.execute(
                "select n from checks where station = ? and ended is null", (station,)
            ).fetchone()
            if found is None:
                found = self._db.execute(
                    "insert into checks(station, asked, who) values(?,?,?) returning n",
                    (station, time.time(), who),
                ).fetchone()
        return int(found[0])

    def end_check(self, number: int, verdict: str, text: str) -> None:
        """Note what a check found."""
        with self._lock, _named(self._path):
            self._db.execute(
                "update checks set ended = ?, verdict = ?, text = ? where n = ?",
                (time.time(), verdict, text, number),
            )

    def last_check(self, station: str) -> dict[str, Any] | None:
        """Give the check that was asked for last: when, by whom, what it found; None where there was none."""
        found = self._dicts("select * from checks where station = ? order by n desc limit 1", (station,))
        return found[0] if found else None

    def beat(self, component: str, state: str, figures: Mapping[str, Any]) -> None:
        """Note that a process is alive, and how it is."""
        with self._lock, _named(self._path):
            self._db.execute(
                "insert or replace into health(component, pid, at, state, figures) values(?,?,?,?,?)",
                (component, os.getpid(), time.time(), state, json.dumps(figures)),
            )

    def health(self) -> dict[str, dict[str, Any]]:
        """Give what each process said last, by its name."""
        found = self._dicts("select * from health", ())
        return {one["component"]: one | {"figures": json.loads(one["figures"])} for one in found}

    def close(self) -> None:
        """Close it."""
        with self._lock:
            self._db.close()
            os.close(self._wake)

    def _count_after(self, number: int) -> int:
        with self._lock, _named(self._path):
            return int(self._db.execute("select count(*) from rows where n > ?", (number,)).fetchone()[0])

    def _dicts(self, query: str, given: Sequence[Any]) -> list[dict[str, Any]]:
        with self._lock, _named(self._path):
            cursor = self._db.execute(query, given)
            names = [column[0] for column in cursor.description]
            return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._db.execute("begin immediate")
        try:
            yield
        except BaseException:
            with suppress(sqlite3.Error):
                self._db.execute("rollback")
            raise
        self._db.execute("commit")


def _fifo(path: Path) -> int:
    """Open the named pipe that wakes who waits; unlike a socket's, its path may be of any length."""
    with suppress(FileExistsError):
        os.mkfifo(path)
    return os.open(path, os.O_RDWR | os.O_NONBLOCK)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise OutputError(
            f"{path}: {error}", hint="is the disk full, or the folder not to be written? It is tried again"
        ) from error
