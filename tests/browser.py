"""A real browser for the tests of pages: started once, and each page's faults kept."""

from __future__ import annotations

import shutil
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A browser of this machine; tests that need one are skipped where there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"no browser on this machine: none of {', '.join(NAMES)}")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(
            executable_path=found,
            # in a container there is no sandbox to be had; the rest keeps the browser itself offline
            args=["--no-sandbox", "--disable-background-networking", "--disable-component-update"],
        )
        yield started
        started.close()


@contextmanager
def opened(browser: Any, address: str, *, width: int = 1300, scripts: bool = True) -> Iterator[Any]:
    """Open a page; its console must stay empty, and it must ask for nothing from elsewhere."""
    context = browser.new_context(viewport={"width": width, "height": 900}, java_script_enabled=scripts)
    page = context.new_page()
    page.set_default_timeout(20_000)
    page.faults = []
    page.on("pageerror", lambda error: page.faults.append(str(error)))
    page.on("console", lambda said: page.faults.append(said.text))
    page.on(
        "request",
        lambda asked: page.faults.extend([] if asked.url.startswith((address, "data:")) else [asked.url]),
    )
    page.goto(address)
    try:
        yield page
        assert page.faults == [], page.faults
    finally:
        context.close()


@contextmanager
def served(recipe: Path) -> Iterator[str]:
    """Serve a recipe's tuning page from this process, on a port of its own."""
    uvicorn = pytest.importorskip("uvicorn")
    from roemetry_tools.tune.server import LOOPBACK, app_of
    from roemetry_tools.tune.session import Session

    session = Session(recipe)
    session.warm_up()
    with socket.socket() as listening:
        listening.bind((LOOPBACK, 0))
        listening.listen()
        server = uvicorn.Server(uvicorn.Config(app_of(session), log_level="warning", lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield f"http://{LOOPBACK}:{listening.getsockname()[1]}/"
        finally:
            server.should_exit = server.force_exit = True
            thread.join(20)
