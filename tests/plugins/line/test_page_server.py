"""The page's server: who holds a connection by doing next to nothing is dropped, others are served."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="the extra line has uvicorn")

from roemetry_line.log import _AsLine
from roemetry_line.page import server as page_server


async def app(scope: Any, receive: Any, send: Any) -> None:
    """Answer "well", or, for /endless, more than any buffer takes."""
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"4")]
                if scope["path"] != "/endless" else []})  # fmt: skip
    while scope["path"] == "/endless" and not (await _gone(receive)):
        await send({"type": "http.response.body", "body": bytes(1 << 20), "more_body": True})
    await send({"type": "http.response.body", "body": b"well"})


async def _gone(receive: Any) -> bool:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(0.001):
            return bool((await receive())["type"] == "http.disconnect")
    return False


@pytest.fixture
def at(monkeypatch) -> Iterator[int]:
    """Give the port of a server that has little patience."""
    monkeypatch.setattr(page_server, "_REQUEST_S", 0.3)
    monkeypatch.setattr(page_server, "_STALL_S", 0.3)
    server = page_server.server_of(app)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=asyncio.run, args=(server.serve([listener]),))
        thread.start()
        yield listener.getsockname()[1]
        server.should_exit = True
        thread.join(10)
    assert not thread.is_alive()


def asked(connection: socket.socket) -> bytes:
    connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    found = b""
    while not found.endswith(b"well"):
        part = connection.recv(4096)
        assert part, found
        found += part
    return found


@pytest.mark.parametrize(
    ("head", "before"),
    [
        (b"", False),
        (b"GET / HTTP/1.1\r\nHost: x\r\nX-Long: ", False),
        (b"GET / HTTP/1.1\r\nHost: x\r\nX-Long: ", True),
        (b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 100000\r\n\r\n", False),
    ],
    ids=["nothing", "head", "second head", "body"],
)
def test_a_request_that_comes_byte_by_byte_is_dropped(at, head, before) -> None:
    begin = time.monotonic()
    with socket.create_connection(("127.0.0.1", at), 5.0) as slow:
        if before:
            asked(slow)
        slow.sendall(head)
        with pytest.raises(ConnectionError):
            while time.monotonic() - begin < 3.0:
                slow.sendall(b"a")
                time.sleep(0.02)
        with socket.create_connection(("127.0.0.1", at), 5.0) as other:
            assert asked(other).startswith(b"HTTP/1.1 200")
    assert time.monotonic() - begin < 3.0


def test_who_asks_and_reads_is_kept_and_who_does_not_read_is_dropped(at) -> None:
    with socket.create_connection(("127.0.0.1", at), 5.0) as connection:
        for _ in range(3):
            assert asked(connection).startswith(b"HTTP/1.1 200")
            time.sleep(0.2)
    with socket.create_connection(("127.0.0.1", at), 5.0) as stuck:
        stuck.sendall(b"GET /endless HTTP/1.1\r\nHost: x\r\n\r\n")
        time.sleep(0.6)
        until_s = time.monotonic() + 2.0
        with contextlib.suppress(ConnectionError):
            while stuck.recv(1 << 20):  # what the buffers hold
                assert time.monotonic() < until_s


def test_what_a_library_warns_of_is_a_line_of_json(capsys, monkeypatch) -> None:
    logger = logging.getLogger("roemetry.test.library")
    monkeypatch.setattr(logger, "propagate", False)
    monkeypatch.setattr(logger, "handlers", [_AsLine()])
    try:
        raise ValueError("twice\nas long")
    except ValueError:
        logger.exception("of %d lines\nin all", 2)
    (line,) = capsys.readouterr().err.splitlines()
    told = json.loads(line)
    assert (told["level"], told["logger"]) == ("error", "roemetry.test.library")
    assert told["text"] == "of 2 lines\nin all"
    assert "ValueError: twice" in told["raised"]
