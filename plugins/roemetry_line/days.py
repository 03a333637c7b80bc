"""Days of the history that are over, as Parquet files; then what is older than is kept is taken out.

A line has it done once an hour, by ``python -m roemetry_line.days LINE.yaml``, so that nobody who measures or
delivers waits for it. Where a day cannot be written nothing is taken out.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from roemetry.errors import OutputError, RoemetryError
from roemetry.io.files import make_folder
from roemetry_line.line_file import HISTORY, Line
from roemetry_line.log import log
from roemetry_line.outbox import Outbox
from roemetry_line.outlets.database import COLUMNS, NUMBERS, PostgresTable, SqliteTable, connect

_DAY_S, _HOUR_S = 86400.0, 3600.0  # seconds in each
_FIRST_S = 60.0
"""After so long it is done first, s: not while the line starts."""
_LATE_DAYS = 7
"""Rows may come late, after an outage or a restart: for so many days they are added to their day's file."""
_OF_DAY = "from roemetry_rows where line = {0} and time_s >= {0} and time_s < {0}"


def write_days(
    table: SqliteTable | PostgresTable, line: str, folder: Path, now: float | None = None
) -> list[Path]:
    """Write each closed day (UTC) of a line that has no file yet as DAY.parquet; give the files written."""
    try:
        import pyarrow.parquet as pq
    except ImportError as error:
        raise OutputError(
            "Parquet needs the module pyarrow", hint="install it with `pip install 'roemetry[line]'`"
        ) from error
    make_folder(folder)
    today = math.floor((now or time.time()) / _DAY_S)
    first = table.ask(f"select min(time_s) from roemetry_rows where line = {table.mark}", (line,))[0][0]
    written = []
    for day in range(math.floor(first / _DAY_S), today) if first is not None else ():
        path = folder / f"{datetime.fromtimestamp(_DAY_S * day, UTC):%Y-%m-%d}.parquet"
        if path.exists() and day < today - _LATE_DAYS:
            continue
        counting = f"select count(*) {_OF_DAY.format(table.mark)}"
        rows = table.ask(counting, (line, _DAY_S * day, _DAY_S * (day + 1)))[0][0]
        if rows > (pq.ParquetFile(path).metadata.num_rows if path.exists() else 0):
            _write(table, line, day, path)
            written.append(path)
    return written


def _write(table: SqliteTable | PostgresTable, line: str, day: int, path: Path) -> None:
    """Write a day hour by hour: a day of a fast line would not fit into memory."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = dict.fromkeys(("time_s", *NUMBERS), pa.float64()) | {"late": pa.int64()}
    schema = pa.schema([(name, kinds.get(name, pa.string())) for name in COLUMNS])
    asked = f"select {', '.join(COLUMNS)} {_OF_DAY.format(table.mark)} order by time_s, run, id"
    part = path.with_suffix(f".{os.getpid()}.part")
    with pq.ParquetWriter(part, schema) as writer:
        for hour in range(24):
            begin_s = _DAY_S * day + _HOUR_S * hour
            rows = table.ask(asked, (line, begin_s, begin_s + _HOUR_S))
            if rows:
                columns: dict[str, list[Any]] = {
                    name: [row[i] for row in rows] for i, name in enumerate(COLUMNS)
                }
                writer.write_table(pa.table(columns, schema))
    part.replace(path)


def tidy(line: Line) -> None:
    """Write the closed days of a line's history, where the line file asks for it, and forget old rows."""
    if line.history is None or line.history_url is None or not line.history_begun:
        return
    table = connect(line.history_url)
    try:
        if line.history.days is not None:
            write_days(table, line.name, line.folder / line.history.days)
        table.forget(line.name, time.time() - _DAY_S * line.history.keep_days)
    finally:
        table.close()


class HourlyTidying:
    """Has a line's history tidied once an hour, by a process beside; the operator is told where it fails."""

    def __init__(self, line: Line, outbox: Outbox) -> None:
        self._line, self._outbox = line, outbox
        self._process: subprocess.Popen[bytes] | None = None
        self._next_s = time.monotonic() + _FIRST_S

    def look(self) -> None:
        """Begin it when an hour is over, and see what came of it; OutputError where that cannot be told."""
        if self._process is None:
            if self._line.history is not None and time.monotonic() > self._next_s:
                self._next_s = time.monotonic() + _HOUR_S
                command = [sys.executable, "-m", "roemetry_line.days", str(self._line.path)]
                self._process = subprocess.Popen(command, stderr=subprocess.PIPE)
        elif self._process.poll() is not None:
            told, failed = self._process.communicate()[1], self._process.returncode != 0
            self._process = None
            said = told.decode(errors="replace").strip().rpartition("\n")[2]
            if not failed:
                self._outbox.end_alarm(HISTORY, "days")
            elif self._outbox.raise_alarm(HISTORY, "days", f"closed days are not written: {said}"):
                log("error", "days", said)


def main() -> int:
    """Tidy the history of the line file that the command line names."""
    os.nice(10)
    try:
        tidy(Line.load(Path(sys.argv[1]), with_recipes=False))
    except (RoemetryError, OSError) as error:
        print(error, file=sys.stderr)  # noqa: T201 - the process that started this one tells it
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
