"""Rows as lines of JSON over TCP or a serial line, each acknowledged: the outlets `tcp` and `serial`.

Each row is a line of JSON that ends in a line feed, with its ``key``. The receiver answers ``ok KEY`` and a
line feed when it has it. What is not answered in time is sent again on a new connection.
"""

from __future__ import annotations

import json
import os
import select
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Literal

from pydantic import Field

from roemetry.errors import OutputError
from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions


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


class TcpOptions(LineOptions):
    """Where the receiver listens."""

    host: str = Field(default="127.0.0.1", min_length=1, description="the receiver's address")
    port: int = Field(default=9100, ge=1, le=65535, description="the receiver's port")


class Tcp(Outlet[TcpOptions]):
    """Sends rows to a listening receiver and waits for its answer to each."""

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


class SerialOptions(LineOptions):
    """Which serial line, and how it is set: 8 data bits, no flow control."""

    device: str = Field(
        default="/dev/ttyS0", min_length=1, description="the serial line's device, such as /dev/ttyUSB0"
    )
    baud: Literal[9600, 19200, 38400, 57600, 115200, 230400] = Field(
        default=115200, description="bits in a second, as the receiver has them"
    )
    parity: Literal["none", "even", "odd"] = Field(
        default="none", description="the parity bit, as the receiver has it"
    )


class Serial(Outlet[SerialOptions]):
    """Sends rows over a serial line and waits for the answer to each."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:serial")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Open the device; OutputError where there is none, or it is no serial line."""
        try:
            port = _Port(self.options)
        except OSError as error:
            raise unreachable(self.options.device, error) from error
        try:
            yield delivering(self.options.device, self.options, port.send, port.line)
        finally:
            port.close()


class _Port:
    """A serial line that is open; what waits in it from before is thrown away."""

    def __init__(self, options: SerialOptions) -> None:
        import termios

        self._timeout_s = options.timeout_s
        self._rest = b""
        self._descriptor = os.open(options.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            rate = getattr(termios, f"B{options.baud}")
            parity = {"none": 0, "even": termios.PARENB, "odd": termios.PARENB | termios.PARODD}
            control = termios.CS8 | termios.CREAD | termios.CLOCAL | parity[options.parity]
            *_, characters = termios.tcgetattr(self._descriptor)
            raw = [0, 0, control, 0, rate, rate, characters]
            termios.tcsetattr(self._descriptor, termios.TCSANOW, raw)
            termios.tcflush(self._descriptor, termios.TCIOFLUSH)
        except termios.error as error:
            self.close()
            raise OSError(*error.args) from error

    def send(self, content: bytes) -> None:
        """Write everything."""
        until_s = time.monotonic() + self._timeout_s + 12.0 * len(content) / 9600.0
        while content:
            self._wait([], [self._descriptor], until_s)
            content = content[os.write(self._descriptor, content) :]

    def line(self) -> bytes:
        """Read a line."""
        until_s = time.monotonic() + self._timeout_s
        while b"\n" not in self._rest and len(self._rest) < 1000:
            self._wait([self._descriptor], [], until_s)
            read = os.read(self._descriptor, 1000)
            if not read:
                return b""
            self._rest += read
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def close(self) -> None:
        """Close it."""
        with suppress(OSError):
            os.close(self._descriptor)

    def _wait(self, reading: list[int], writing: list[int], until_s: float) -> None:
        if not any(select.select(reading, writing, [], max(0.0, until_s - time.monotonic()))):
            raise TimeoutError
