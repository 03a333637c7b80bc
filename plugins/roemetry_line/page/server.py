"""The process that serves the page."""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
from pathlib import Path
from typing import Any

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from roemetry.errors import ConfigurationError
from roemetry_line.line_file import Line, PageSection
from roemetry_line.log import log, log_libraries
from roemetry_line.outbox import Outbox
from roemetry_line.page.app import LinePage
from roemetry_line.page.users import Users
from roemetry_line.process import stop_event

_END_S = 1
"""Answers that nobody reads would keep the server for ever; after so long they are cut, s."""
_REQUEST_S = 10.0
"""From its first byte, or from the connection on, a request must be whole within this, s."""
_STALL_S = 30.0
"""So long a client may read nothing of an answer that waits for it, s."""


class _Timer:
    """Cuts a connection after a time, unless it is ended before."""

    def __init__(self, transport: asyncio.Transport, seconds: float) -> None:
        self._transport, self._seconds = transport, seconds
        self._handle: asyncio.TimerHandle | None = None

    def begin(self) -> None:
        """Begin, where it has not begun."""
        if self._handle is None:
            loop = asyncio.get_running_loop()
            self._handle = loop.call_later(self._seconds, self._transport.abort)

    def end(self) -> None:
        """End it."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None


class _Patience(H11Protocol):
    """Drops clients that keep a connection by a byte now and then, or by reading nothing."""

    def connection_made(self, transport: Any) -> None:
        """Give the first request its time."""
        super().connection_made(transport)
        self._coming, self._reading = _Timer(transport, _REQUEST_S), _Timer(transport, _STALL_S)
        self._coming.begin()

    def data_received(self, data: bytes) -> None:
        """Give a request that begins its time; it is whole once its body, too, is there."""
        super().data_received(data)
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            self._coming.begin()
        else:
            self._coming.end()

    def pause_writing(self) -> None:
        """Give who does not read his time."""
        super().pause_writing()
        self._reading.begin()

    def resume_writing(self) -> None:
        """Note that he reads."""
        super().resume_writing()
        self._reading.end()

    def connection_lost(self, exc: Exception | None) -> None:
        """Leave no timer behind."""
        super().connection_lost(exc)
        self._coming.end()
        self._reading.end()


def listening(page: PageSection) -> socket.socket:
    """Listen where the page is to be; ConfigurationError where that cannot be."""
    try:
        return socket.create_server((page.host, page.port), backlog=100)
    except OSError as error:
        raise ConfigurationError(
            f"page.host {page.host}, page.port {page.port}: {error.strerror or error}",
            hint="is the address this machine's, and the port free?",
        ) from error


def server_of(app: Any) -> uvicorn.Server:
    """Make the server of an application."""
    config = uvicorn.Config(
        app, http=_Patience, log_config=None, access_log=False, lifespan="off",
        timeout_graceful_shutdown=_END_S, limit_concurrency=200, h11_max_incomplete_event_size=32_000,
    )  # fmt: skip
    return uvicorn.Server(config)


async def serve_page(line: Line, page: PageSection, stop: threading.Event) -> None:
    """Serve the page until asked to stop."""
    shown = LinePage(line, Outbox(line.folder), Users(line.folder))
    server = server_of(shown.app(list(page.hosts)))
    with listening(page) as listener:
        host, port = listener.getsockname()[:2]
        log("info", "page", f"http://{host}:{port}/")
        polling = asyncio.create_task(shown.poll())
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        while not stop.is_set() and not serving.done():
            await asyncio.sleep(0.2)
        await shown.end()
        server.should_exit = True
        await serving
        polling.cancel()


def main() -> int:
    """Serve the page of the line file that the command line names."""
    log_libraries()
    stop = stop_event()
    line = Line.load(Path(sys.argv[1]), with_recipes=False)
    if line.page is not None:
        asyncio.run(serve_page(line, line.page, stop))
    return 0


if __name__ == "__main__":
    sys.exit(main())
