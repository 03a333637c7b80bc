"""The history: every row of a line in a table, in SQLite or PostgreSQL.

The table `roemetry_rows` has a line a product or notice: key (line, run, id), time, station, kind, the
numbers of the summary, and everything as JSON. A row that comes a second time changes nothing.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pydantic import Field

from roemetry.errors import OutputError, PluginError
from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions

NUMBERS = ("mass_g", "mass_std_g", "volume_mm3", "volume_std_mm3", "height_mm", "latency_ms")
WORDS = ("product", "status", "grade", "decision", "lane", "reason")
COLUMNS = ("line", "run", "id", "station", "kind", "time_s", *NUMBERS, *WORDS, "late", "text")


class DatabaseOptions(StageOptions):
    """Which database."""

    url: str = Field(
        default="sqlite:history.sqlite",
        pattern="^(sqlite:.+|postgresql://.+)$",
        description="`sqlite:FILE` or `postgresql://USER@HOST/NAME`; a password is better kept in ~/.pgpass",
    )


class Database(Outlet[DatabaseOptions]):
    """Puts rows into a table, each once."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:database")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Connect and make the table if need be; OutputError where the database cannot be had."""
        kept = connect(self.options.url)
        try:
            yield lambda rows: kept.insert([_values(row) for row in rows])
        finally:
            kept.close()


class _Table:
    """The table `roemetry_rows`; a class for each kind of database says how it is reached."""

    mark: str
    """What stands for a value in a query."""
    _types: tuple[str, str]
    """What the database calls whole numbers and numbers."""
    _db: Any

    def insert(self, rows: Sequence[Sequence[Any]]) -> None:
        """Add rows; those that are there stay as they are."""
        raise NotImplementedError

    def forget(self, line: str, before_s: float) -> None:
        """Take out what a line told before a time, s since 1970."""
        with self._named():
            which = f"line = {self.mark} and time_s < {self.mark}"
            self._db.execute(f"delete from roemetry_rows where {which}", (line, before_s))

    def ask(self, query: str, given: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Give the rows of a query."""
        with self._named():
            found: list[tuple[Any, ...]] = self._db.execute(query, given).fetchall()
            return found

    def close(self) -> None:
        """Close it."""
        self._db.close()

    def _make(self) -> None:
        integer, real = self._types
        numbers = ", ".join(f"{name} {real}" for name in NUMBERS)
        words = ", ".join(f"{name} text" for name in WORDS)
        self._db.execute(
            "create table if not exists roemetry_rows(line text not null, run text not null, id text not "
            f"null, station text not null, kind text not null, time_s {real} not null, {numbers}, {words}, "
            f"late {integer}, text text not null, primary key(line, run, id))"
        )
        self._db.execute("create index if not exists roemetry_rows_line_time on roemetry_rows(line, time_s)")

    @contextmanager
    def _named(self) -> Iterator[None]:
        raise NotImplementedError
        yield


class SqliteTable(_Table):
    """The table in a SQLite file."""

    mark = "?"
    _types = ("integer", "real")

    def __init__(self, path: str) -> None:
        self._path = path
        with self._named():
            self._db = sqlite3.connect(path, timeout=10.0, isolation_level=None, check_same_thread=False)
            self._db.execute("pragma journal_mode=wal")
            self._db.execute("pragma synchronous=normal")
            self._make()

    def insert(self, rows: Sequence[Sequence[Any]]) -> None:
        """Add rows; those that are there stay as they are."""
        marks = ", ".join("?" * len(COLUMNS))
        with self._named():
            self._db.execute("begin immediate")
            try:
                self._db.executemany(
                    f"insert or ignore into roemetry_rows({', '.join(COLUMNS)}) values({marks})", rows
                )
            except BaseException:
                self._db.execute("rollback")
                raise
            self._db.execute("commit")

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise OutputError(
                f"{self._path}: {error}", hint="is the folder there, and room on the disk?"
            ) from error


class PostgresTable(_Table):
    """The table in a PostgreSQL database."""

    mark = "%s"
    _types = ("bigint", "double precision")

    def __init__(self, url: str) -> None:
        try:
            import psycopg
        except ImportError as error:
            raise PluginError(
                "PostgreSQL needs the module psycopg", hint="install it with `pip install 'roemetry[line]'`"
            ) from error
        self._shown = url.partition("@")[2] or url
        self._fault = psycopg.Error
        with self._named():
            self._db = psycopg.connect(url, autocommit=True, connect_timeout=3)
            self._make()

    def insert(self, rows: Sequence[Sequence[Any]]) -> None:
        """Add rows by COPY into a table of the transaction, and from there those that are new."""
        columns = ", ".join(COLUMNS)
        with self._named(), self._db.transaction():
            self._db.execute(
                "create temporary table arrived (like roemetry_rows including defaults) on commit drop"
            )
            with self._db.cursor().copy(f"copy arrived({columns}) from stdin") as copy:
                for row in rows:
                    copy.write_row(row)
            self._db.execute(
                f"insert into roemetry_rows({columns}) select {columns} from arrived on conflict do nothing"
            )

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except self._fault as error:
            said = str(error).strip().splitlines()
            raise OutputError(
                f"PostgreSQL {self._shown}: {said[0] if said else type(error).__name__}",
                hint="does the server run, and may this user write there?",
            ) from error


def connect(url: str) -> SqliteTable | PostgresTable:
    """Open the history at a URL; OutputError where it cannot be had."""
    kind, _, path = url.partition(":")
    return SqliteTable(path) if kind == "sqlite" else PostgresTable(url)


def _values(row: LineRow) -> tuple[Any, ...]:
    line, run, name = row.key.split("/", 2)
    told = json.loads(row.text)
    found = {**row.summary, "latency_ms": told.get("latency_ms"), "product": told.get("product")}
    time_s = (told.get("taken") or {}).get("time_s") or time.time()
    return (
        line,
        run,
        name,
        told.get("station", ""),
        row.kind,
        time_s,
        *(found.get(column) for column in (*NUMBERS, *WORDS)),
        found.get("late"),
        row.text.replace("\0", ""),
    )
