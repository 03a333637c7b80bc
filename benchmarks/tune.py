"""Time from a moved slider to the answer, in a real browser and without one; and the picture of the page.

``python -m benchmarks tune [--recipe recipes/herring_roe] [--moves 40] [--picture docs/images/tune.png]``
"""

from __future__ import annotations

import argparse
import shutil
import socket
import statistics
import threading
import time
from pathlib import Path
from typing import Any

from roemetry_tools.tune.request import StageRequest, TuneRequest
from roemetry_tools.tune.server import LOOPBACK, app_of
from roemetry_tools.tune.session import Session, unpacked


def main() -> None:
    """Print medians and largest times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recipe", type=Path, default=Path("recipes/herring_roe"))
    parser.add_argument("--moves", type=int, default=40)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    session = Session(given.recipe)
    session.warm_up()
    for kind in ("extractor", "coder", "weigher"):
        _told(f"server, {kind} changed", [_moved(session, kind, i) for i in range(given.moves)])
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        print("no browser on this machine: the page itself is not timed")
        return
    _in_browser(session, browser, given.moves, given.picture)


def _told(name: str, seconds: list[float]) -> None:
    milliseconds = sorted(1e3 * one for one in seconds)
    print(
        f"{name:34} median {statistics.median(milliseconds):6.1f} ms, "
        f"95 % {milliseconds[int(0.95 * (len(milliseconds) - 1))]:6.1f} ms, most {milliseconds[-1]:6.1f} ms"
    )


def _moved(session: Session, kind: str, turn: int) -> float:
    """Change one number of a stage to a value it never had, and take the time of the answer."""
    recipe = session.recipe()
    stage = next(stage for stage in recipe["stages"] if stage["kind"] == kind)
    choice = next(one for one in stage["choices"] if one["use"] == stage["chosen"]["use"])
    field = next(f for f in choice["fields"] if f["kind"] in ("number", "integer") and f["high"] is not None)
    usual = float(stage["chosen"]["options"].get(field["name"], field["default"]))
    value = usual + turn + 1 if field["kind"] == "integer" else usual * (1.0 + 0.01 * (turn + 1))
    options = {**stage["chosen"]["options"], field["name"]: f"{min(value, field['high']):g}"}
    wish = TuneRequest(stages={kind: StageRequest(use=stage["chosen"]["use"], options=options)})
    begin = time.perf_counter()
    data = session.answer(wish)
    took = time.perf_counter() - begin
    assert not unpacked(data)[0]["faults"], unpacked(data)[0]["faults"]
    return took


def _in_browser(session: Session, browser: str, moves: int, picture: Path | None) -> None:
    import uvicorn
    from playwright.sync_api import sync_playwright

    with socket.socket() as listening, sync_playwright() as driver:
        listening.bind((LOOPBACK, 0))
        listening.listen()
        server = uvicorn.Server(uvicorn.Config(app_of(session), log_level="warning", lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        found = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        try:
            page = found.new_page(viewport={"width": 1440, "height": 900})
            page.goto(f"http://{LOOPBACK}:{listening.getsockname()[1]}/")
            page.wait_for_selector("body[data-took]")
            _told("page, extractor's slider moved", [_dragged(page) for _ in range(moves)])
            if picture is not None:
                _photographed(page, picture)
        finally:
            found.close()
            server.should_exit = server.force_exit = True
            thread.join(20)


def _dragged(page: Any) -> float:
    """Move the first slider by one step with a key; the page tells how long its own answer took."""
    answered = page.get_attribute("body", "data-answers")
    page.locator("[data-kind=extractor] input[type=range]").first.press("ArrowRight")
    page.wait_for_selector(f'body:not([data-answers="{answered}"])')
    return float(page.get_attribute("body", "data-took")) / 1e3


def _photographed(page: Any, picture: Path) -> None:
    """Show a threshold that is too high: gaps at the product's edges, and the profiles as saved in grey."""
    answered = page.get_attribute("body", "data-answers")
    page.locator("#extractor-threshold").fill("60")
    page.wait_for_selector(f'body:not([data-answers="{answered}"])')
    page.locator("#picture").focus()
    page.evaluate("document.getElementById('file').textContent = 'recipes/herring_roe/recipe.yaml'")
    page.wait_for_timeout(400)
    page.screenshot(path=str(picture))
    print(picture)


if __name__ == "__main__":
    main()
