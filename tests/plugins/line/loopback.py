"""What tests of a line share: rows, a port that is free, a TCP receiver, a wait that ends."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from roemetry.records.live import LineRow


def row(number: int, **summary: Any) -> LineRow:
    told = {"id": f"{number:06d}#1", "status": "measured", "mass_g": 20.0 + number, **summary}
    text = {"station": "s", "kind": "product", "taken": {"time_s": 1000.0 + number}, "latency_ms": 3.5}
    return LineRow(number, f"l/r/{number:06d}#1", "product", told, json.dumps(text))


def keys(*numbers: int) -> list[str]:
    return [f"l/r/{number:06d}#1" for number in numbers]


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return listening.getsockname()[1]


def wait_for(condition: Callable[[], object], otherwise: str, seconds: float = 20.0) -> None:
    until_s = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until_s, otherwise
        time.sleep(0.01)


class Receiver:
    """Takes rows by TCP and says ok to each; hangs up once, without a word, at the row of number `limit`."""

    def __init__(self) -> None:
        self.got: list[dict[str, Any]] = []
        self.limit = 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            # who delivers may be killed at any moment
            with contextlib.suppress(OSError), connection, connection.makefile("rb") as lines:
                for line in lines:
                    self.got.append(json.loads(line))
                    if len(self.got) == self.limit:
                        break
                    connection.sendall(f"ok {self.got[-1]['key']}\n".encode())

    def close(self) -> None:
        self._server.close()

    @property
    def keys(self) -> list[str]:
        return [one["key"] for one in self.got]
