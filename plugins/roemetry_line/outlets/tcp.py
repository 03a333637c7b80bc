"""Lines of JSON over TCP, each acknowledged: what a small program, or a PLC with a socket block, can take."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from pydantic import Field

from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet
from roemetry_line.outlets.acknowledged_lines import LineOptions, delivering, unreachable


class TcpOptions(LineOptions):
    """Where the receiver listens."""

    host: str = Field(default="127.0.0.1", min_length=1, description="the receiver's address")
    port: int = Field(default=9100, ge=1, le=65535, description="the receiver's port")


class Tcp(Outlet[TcpOptions]):
    """Sends rows to a listening receiver and waits for its answer to each."""

    Options = TcpOptions
    capabilities = Capabilities(fixture="roemetry_line.conformance:tcp")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Connect; OutputError where nobody listens."""
        address = (self.options.host, self.options.port)
        receiver = f"{self.options.host}:{self.options.port}"
        try:
            connection = socket.create_connection(address, self.options.timeout_s)
        except OSError as error:
            raise unreachable(receiver, error) from error
        with connection, connection.makefile("rb") as answers:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            yield delivering(receiver, self.options, connection.sendall, lambda: answers.readline(1000))
