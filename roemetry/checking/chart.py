"""The control chart: checks of a line's calibrations in a small SQLite file."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from roemetry.checking.judging import Check, Quantity
from roemetry.errors import DataError, OutputError
from roemetry.json_values import json_values
from roemetry.records import Reason

T = TypeVar("T")

_FORMAT = 1
_TABLE = """
CREATE TABLE IF NOT EXISTS checks
(made TEXT NOT NULL, calibration_sha256 TEXT NOT NULL, content TEXT NOT NULL)
"""


class Chart:
    """A file of checks; each is written whole or not at all.

    Parameters
    ----------
    path
        The file; made at the first check.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def add(self, check: Check) -> None:
        """Write a check down; raise OutputError where the file cannot be written."""
        row = (check.made, check.calibration_sha256, json.dumps(json_values(asdict(check))))
        try:
            with self._opened() as base:
                base.execute(_TABLE)
                base.execute(f"PRAGMA user_version = {_FORMAT}")
                base.execute("INSERT INTO checks VALUES (?, ?, ?)", row)
                base.commit()
        except sqlite3.OperationalError as error:
            raise OutputError(
                f"{self._path}: the check cannot be written: {error}",
                hint="can the folder be written, and is the disk not full? earlier checks are as they were",
            ) from error
        except sqlite3.DatabaseError as error:
            raise self._damaged(error) from error

    def checks(self, calibration_sha256: str | None = None) -> tuple[Check, ...]:
        """Give the checks, oldest first: of one calibration, or of all; none where there is no file."""
        if not self._path.is_file():
            return ()
        query = "SELECT content FROM checks"
        try:
            with self._opened() as base:
                if calibration_sha256 is None:
                    rows = base.execute(f"{query} ORDER BY made, rowid").fetchall()
                else:
                    wanted = f"{query} WHERE calibration_sha256 = ? ORDER BY made, rowid"
                    rows = base.execute(wanted, (calibration_sha256,)).fetchall()
            return tuple(_check(json.loads(content)) for (content,) in rows)
        except (sqlite3.DatabaseError, ValueError, KeyError, TypeError) as error:
            raise self._damaged(error) from error

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        with closing(sqlite3.connect(self._path, timeout=10.0)) as base:
            yield base

    def _damaged(self, error: Exception) -> DataError:
        return DataError(
            f"{self._path}: this is no control chart, or it is damaged: {error}",
            hint="name another file; the checks begin anew there",
        )


def _check(data: dict[str, Any]) -> Check:
    lengths = {name: Quantity(**_numbers(data[name])) for name in ("height", "belt", "width")}
    reasons = tuple(Reason._make(reason) for reason in data["reasons"])
    return Check(**{**_numbers(data), **lengths, "reasons": reasons})


def _numbers(data: dict[str, Any]) -> dict[str, Any]:
    return {name: math.nan if value is None else value for name, value in data.items()}
