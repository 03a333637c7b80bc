"""Lines of JSON over a serial line (RS-232, RS-485, USB), each acknowledged."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Literal

from pydantic import Field

from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet
from roemetry_line.outlets.acknowledged_lines import LineOptions, delivering, unreachable


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

    Options = SerialOptions
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
