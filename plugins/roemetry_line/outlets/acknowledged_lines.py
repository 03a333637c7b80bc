"""Rows as lines of JSON, each acknowledged: the protocol of the outlets `tcp` and `serial`.

Each row is a line of JSON that ends in a line feed, with its ``key``. The receiver answers ``ok KEY`` and a
line feed when it has it. What is not answered in time is sent again on a new connection.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Literal

from pydantic import Field

from roemetry.errors import OutputError
from roemetry.records.live import LineRow
from roemetry.stages import StageOptions


class LineOptions(StageOptions):
    """What is sent, and how long is waited."""

    content: Literal["summary", "all"] = Field(
        default="summary", description="`summary`: a few numbers, `all`: the whole row"
    )
    timeout_s: float = Field(default=2.0, gt=0, le=60, description="how long an answer may take, s")


def delivering(
    receiver: str, options: LineOptions, send: Callable[[bytes], object], answer: Callable[[], bytes]
) -> Callable[[Sequence[LineRow]], None]:
    """Give what delivers rows over a connection.

    `send` writes all it is given; `answer` gives the next line, or nothing where the other side has closed.
    Both raise OSError where the connection is lost, TimeoutError where nothing comes in time.
    """

    def deliver(rows: Sequence[LineRow]) -> None:
        try:
            send(b"".join(_line(row, options.content) for row in rows))
            for row in rows:
                found = answer().decode("utf-8", "replace").strip()
                if not found:
                    raise OutputError(f"{receiver}: closed the connection")
                if found != f"ok {row.key}":
                    raise OutputError(f"{receiver}: answered {found[:80]!r}, expected 'ok {row.key}'")
        except OSError as error:
            raise unreachable(receiver, error) from error

    return deliver


def unreachable(receiver: str, error: OSError) -> OutputError:
    """Give the error for a receiver that does not answer."""
    why = "no answer in time" if isinstance(error, TimeoutError) else error.strerror or str(error)
    return OutputError(f"{receiver}: {why}", hint="does the receiver run and listen there?")


def _line(row: LineRow, content: str) -> bytes:
    if content == "all":
        text = f'{{"key": {json.dumps(row.key)}, {row.text[1:]}'
    else:
        text = json.dumps({"key": row.key, "kind": row.kind, **row.summary}, ensure_ascii=False)
    return text.encode() + b"\n"
