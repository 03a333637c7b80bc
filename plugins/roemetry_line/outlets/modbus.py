"""A Modbus TCP server whose registers hold the last results: what every PLC can read.

The protocol's part that is needed is small (Modbus application protocol 1.1b3: functions 3, 4, 6 and 16;
Modbus messaging on TCP/IP 1.0b), and is written here, so that no library decides when a PLC gets its
answer. Holding and input registers are the same. Numbers of 32 bit stand in two registers, the high one
first.

| register | holds |
|---|---|
| 0 | heartbeat: counts up ten times a second |
| 1 | number of the last result, 1 to 65535, then 1 again; 0: none yet |
| 2 | written by the PLC: the last result that it has taken |
| 16 … 31 | the last result |
| 32 … 47, 48 … 63, … | the seven results before it, the newest first |
| 144 | shift register: number of products that are on their way to the gate |
| 145 | number of products whose result came after they had passed the gate |
| 146 … 149 | the product that reaches the gate next: encoder count, 32 bit; class; lane |
| 150 … 153, … | the seven products after it, in the order in which they reach the gate |

A result's 16 registers: its number; status; class; lane; late; x and y in tenths of a millimetre (signed);
height in hundredths of a millimetre; mass, g, float32; volume, mm³, float32; encoder count at the gate, 32
bit; two unused. Not known is 0x8000 in a signed register, NaN in a float and 0xFFFFFFFF in a count.
"""

from __future__ import annotations

import math
import socketserver
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from pydantic import Field

from roemetry.errors import OutputError
from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions
from roemetry_line.gate import ShiftRegister

STATUS = {
    "measured": 1,
    "empty": 2,
    "failed": 3,
    "late": 4,
    "frame-incomplete": 5,
    "frames-lost": 6,
    "calibration-check": 7,
}
"""What stands in a result's second register."""
# registers: docs/reference/plugins/modbus.md
_RESULTS = 8  # that are kept, the newest first
_SIZE = 16  # registers of a result
_FIRST = 16  # register of the newest result
_TAKEN = 2  # register that a client writes
_SHIFT = _FIRST + _RESULTS * _SIZE
_SHIFT_SIZE = 4  # registers of a product under way to the gate
_REGISTERS = _SHIFT + 2 + _RESULTS * _SHIFT_SIZE
_BEAT_S = 0.1  # after which the heartbeat counts on
_CLIENTS_MAX = 8  # at once: each has a thread
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3  # exception codes of Modbus


class ModbusOptions(StageOptions):
    """Where the server listens, and the words that get a number."""

    host: str = Field(default="127.0.0.1", min_length=1, description="address to listen at")
    port: int = Field(default=5020, ge=0, le=65535, description="port to listen at; Modbus's own is 502")
    classes: tuple[str, ...] = Field(
        default=(),
        description="decisions (grades without a grader) that are 1, 2, …; others are 0",
    )
    lanes: tuple[str, ...] = Field(default=(), description="lanes that are 1, 2, …; others are 0")
    encoder_bits: int = Field(
        default=32, ge=8, le=32, description="bits of the encoder's counter, as in the station's `gate`"
    )
    handshake: bool = Field(
        default=False,
        description="whether each result waits until the PLC has written its number into register 2; else "
        "the eight last results are there to be read, and who reads too seldom misses some",
    )
    timeout_s: float = Field(default=5.0, gt=0, le=600, description="how long the PLC may take for that, s")


class Modbus(Outlet[ModbusOptions]):
    """Shows results to PLCs that read them; anybody who reaches the port may read."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:modbus")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Listen; OutputError where this machine cannot listen there."""
        registers = Registers()
        try:
            server = _Server((self.options.host, self.options.port), registers)
        except OSError as error:
            raise OutputError(
                f"Modbus server at {self.options.host}:{self.options.port}: {error.strerror or error}",
                hint="is the address this machine's, and the port free? Ports below 1024 need a privilege",
            ) from error
        with server:
            threading.Thread(target=server.serve_forever, args=(_BEAT_S,), daemon=True).start()
            try:
                yield lambda rows: self._show(registers, rows)
            finally:
                server.shutdown()

    def _show(self, registers: Registers, rows: Sequence[LineRow]) -> None:
        for row in rows:
            number = 1 + (row.number - 1) % 65535
            if registers.push(_result(number, row.summary, self.options)):
                registers.shift(row.summary, self.options)
            if self.options.handshake and not registers.wait_taken(number, self.options.timeout_s):
                raise OutputError(
                    f"Modbus: the PLC has not written {number} into register {_TAKEN} within "
                    f"{self.options.timeout_s:g} s",
                    hint="does the PLC run, and does its program acknowledge results?",
                )


class Registers:
    """What PLCs read and write: each request sees a whole state."""

    def __init__(self) -> None:
        self._values = [0] * _REGISTERS
        self._under_way: ShiftRegister | None = None
        self._changed = threading.Condition()

    def push(self, result: Sequence[int]) -> bool:
        """Put a result before the others, the oldest is gone; False where it is there already."""
        with self._changed:
            if self._values[1] == result[0]:
                return False
            older = self._values[_FIRST : _SHIFT - _SIZE]
            self._values[_FIRST:_SHIFT] = [*result, *older]
            self._values[1] = result[0]
            return True

    def shift(self, told: Mapping[str, Any], options: ModbusOptions) -> None:
        """Move the shift register on to a row's encoder count, and put its product into it."""
        encoder, count = told.get("encoder_count"), told.get("gate_count")
        if encoder is None:
            return
        self._under_way = self._under_way or ShiftRegister(options.encoder_bits)
        self._under_way.move(encoder)
        if count is not None:
            self._under_way.put(int(count), _classes(told, options))
        waiting = self._under_way.waiting[:_RESULTS]
        shown = [register for at, (kind, lane) in waiting for register in (at >> 16, at & 0xFFFF, kind, lane)]
        shown += [0] * (_RESULTS * _SHIFT_SIZE - len(shown))
        with self._changed:
            counts = [len(self._under_way.waiting), self._under_way.missed % 65536]
            self._values[_SHIFT:] = [*counts, *shown]

    def wait_taken(self, number: int, timeout_s: float) -> bool:
        """Wait until a PLC has written that it has taken a result."""
        with self._changed:
            return self._changed.wait_for(lambda: self._values[_TAKEN] == number, timeout_s)

    def read(self, first: int, many: int) -> list[int] | None:
        """Give registers; None where there are not so many."""
        with self._changed:
            self._values[0] = int(time.monotonic() / _BEAT_S) % 65536
            return self._values[first : first + many] if first + many <= _REGISTERS else None

    def write(self, first: int, values: Sequence[int]) -> bool:
        """Write the one register that a PLC may write; False for any other."""
        if first != _TAKEN or len(values) != 1:
            return False
        with self._changed:
            self._values[_TAKEN] = values[0]
            self._changed.notify_all()
        return True


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, address: tuple[str, int], registers: Registers) -> None:
        self.registers = registers
        self._clients = threading.Semaphore(_CLIENTS_MAX)
        super().__init__(address, _Client)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a client, unless there are too many."""
        if self._clients.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a client in its thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._clients.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Let a client that breaks off go in silence."""


class _Client(socketserver.StreamRequestHandler):
    timeout = 60.0

    def handle(self) -> None:
        registers = self.server.registers  # type: ignore[attr-defined]
        while len(header := self.rfile.read(7)) == 7:
            transaction, protocol, length, unit = struct.unpack(">HHHB", header)
            if protocol != 0 or not 2 <= length <= 254:
                return
            request = self.rfile.read(length - 1)
            if len(request) < length - 1:
                return
            answer = answered(registers, request)
            self.wfile.write(struct.pack(">HHHB", transaction, 0, len(answer) + 1, unit) + answer)


def answered(registers: Registers, request: bytes) -> bytes:
    """Answer one request, from its function code on, by what it asks or by an exception of the protocol."""
    function, rest = request[0], request[1:]
    if function in (3, 4) and len(rest) == 4:
        first, many = struct.unpack(">HH", rest)
        if not 1 <= many <= 125:
            return bytes([function | 0x80, _ILLEGAL_VALUE])
        found = registers.read(first, many)
        if found is None:
            return bytes([function | 0x80, _ILLEGAL_ADDRESS])
        return bytes([function, 2 * many]) + struct.pack(f">{many}H", *found)
    if function == 6 and len(rest) == 4:
        first, value = struct.unpack(">HH", rest)
        return request if registers.write(first, [value]) else bytes([function | 0x80, _ILLEGAL_ADDRESS])
    if function == 16 and len(rest) >= 5:
        first, many, size = struct.unpack(">HHB", rest[:5])
        if size != 2 * many or len(rest) != 5 + size:
            return bytes([function | 0x80, _ILLEGAL_VALUE])
        if registers.write(first, struct.unpack(f">{many}H", rest[5:])):
            return bytes([function]) + rest[:4]
        return bytes([function | 0x80, _ILLEGAL_ADDRESS])
    return bytes([function | 0x80, _ILLEGAL_FUNCTION if function not in (3, 4, 6, 16) else _ILLEGAL_VALUE])


def _result(number: int, told: Mapping[str, Any], options: ModbusOptions) -> list[int]:
    count = told.get("gate_count")
    packed = struct.pack(
        ">5HhhhffI2H",
        number,
        STATUS.get(str(told.get("status")), 0),
        *_classes(told, options),
        int(told.get("late") or 0),
        _scaled(told.get("x_mm"), 10.0),
        _scaled(told.get("y_mm"), 10.0),
        _scaled(told.get("height_mm"), 100.0),
        _or_nan(told.get("mass_g")),
        _or_nan(told.get("volume_mm3")),
        0xFFFFFFFF if count is None else int(count) % (1 << 32),
        0,
        0,
    )
    return list(struct.unpack(f">{_SIZE}H", packed))


def _classes(told: Mapping[str, Any], options: ModbusOptions) -> tuple[int, int]:
    """Give the numbers of class and lane; 0 for those that have none."""
    word, lane = told.get("decision") or told.get("grade"), told.get("lane")
    return (
        options.classes.index(word) + 1 if word in options.classes else 0,
        options.lanes.index(lane) + 1 if lane in options.lanes else 0,
    )


def _scaled(value: float | None, by: float) -> int:
    if value is None or not math.isfinite(value):
        return -0x8000
    return max(-0x7FFF, min(0x7FFF, round(by * value)))


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
