"""The process that serves the page."""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
from pathlib import Path

import uvicorn

from roemetry.errors import ConfigurationError
from roemetry_line.line_file import Line, PageSection
from roemetry_line.log import log
from roemetry_line.outbox import Outbox
from roemetry_line.page.app import LinePage
from roemetry_line.page.users import Users
from roemetry_line.process import until_asked

_END_S = 1
"""Streams that are open would keep the server for ever; after so long they are cut, s."""


def listening(page: PageSection) -> socket.socket:
    """Listen where the page is to be; ConfigurationError where that cannot be."""
    try:
        return socket.create_server((page.host, page.port), backlog=100)
    except OSError as error:
        raise ConfigurationError(
            f"page.host {page.host}, page.port {page.port}: {error.strerror or error}",
            hint="is the address this machine's, and the port free?",
        ) from error


async def serve_page(line: Line, page: PageSection, stop: threading.Event) -> None:
    """Serve the page until asked to stop."""
    shown = LinePage(line, Outbox(line.folder), Users(line.folder))
    hosts = list(page.hosts)
    config = uvicorn.Config(
        shown.app(hosts), log_level="warning", access_log=False, lifespan="off",
        timeout_graceful_shutdown=_END_S, limit_concurrency=200, h11_max_incomplete_event_size=32_000,
    )  # fmt: skip
    server = uvicorn.Server(config)
    with listening(page) as listener:
        host, port = listener.getsockname()[:2]
        log("info", "page", f"http://{host}:{port}/")
        polling = asyncio.create_task(shown.poll())
        serving = asyncio.create_task(server.serve(sockets=[listener]))
        while not stop.is_set() and not serving.done():
            await asyncio.sleep(0.2)
        server.should_exit = True
        await serving
        polling.cancel()


def main() -> int:
    """Serve the page of the line file that the command line names."""
    stop = until_asked()
    line = Line.load(Path(sys.argv[1]), with_recipes=False)
    if line.page is not None:
        asyncio.run(serve_page(line, line.page, stop))
    return 0


if __name__ == "__main__":
    sys.exit(main())
