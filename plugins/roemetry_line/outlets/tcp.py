"""Lines of JSON over TCP, each acknowledged: what a small program, or a PLC with a socket block, can take.

The receiver listens; each row is a line of JSON that ends in a line feed, with its ``key``. The receiver
answers ``ok KEY`` and a line feed when it has it. What is not answered in time is sent again on a new
connection.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Literal

from pydantic import Field

from roemetry.errors import OutputError
from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions


class TcpOptions(StageOptions):
    """Where the receiver listens."""

    host: str = Field(default="127.0.0.1", min_length=1, description="the receiver's address")
    port: int = Field(default=9100, ge=1, le=65535, description="the receiver's port")
    content: Literal["summary", "all"] = Field(
        default="summary", description="`summary`: a few numbers, `all`: the whole row"
    )
    timeout_s: float = Field(default=2.0, gt=0, le=60, description="how long an answer may take, s")


class Tcp(Outlet[TcpOptions]):
    """Sends rows to a listening receiver and waits for its answer to each."""

    Options = TcpOptions
    capabilities = Capabilities(fixture="roemetry_line.conformance:tcp")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Connect; OutputError where nobody listens."""
        address = (self.options.host, self.options.port)
        try:
            connection = socket.create_connection(address, self.options.timeout_s)
        except OSError as error:
            raise _unreachable(self.options, error) from error
        with connection, connection.makefile("rb") as answers:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

            def deliver(rows: Sequence[LineRow]) -> None:
                try:
                    connection.sendall(b"".join(_line(row, self.options.content) for row in rows))
                    for row in rows:
                        answer = answers.readline(1000).decode("utf-8", "replace").strip()
                        if answer != f"ok {row.key}":
                            raise OutputError(
                                f"{self.options.host}:{self.options.port}: answered {answer[:80]!r}, "
                                f"expected 'ok {row.key}'"
                                if answer
                                else f"{self.options.host}:{self.options.port}: closed the connection"
                            )
                except OSError as error:
                    raise _unreachable(self.options, error) from error

            yield deliver


def _line(row: LineRow, content: str) -> bytes:
    if content == "all":
        text = f'{{"key": {json.dumps(row.key)}, {row.text[1:]}'
    else:
        text = json.dumps({"key": row.key, "kind": row.kind, **row.summary}, ensure_ascii=False)
    return text.encode() + b"\n"


def _unreachable(options: TcpOptions, error: OSError) -> OutputError:
    why = "no answer in time" if isinstance(error, TimeoutError) else error.strerror or str(error)
    return OutputError(
        f"{options.host}:{options.port}: {why}", hint="does the receiver run and listen there?"
    )
