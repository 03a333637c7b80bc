"""The pictures of README and the docs, as a browser shows them: a skein's report, and the tuning page.

``python -m benchmarks report_picture [--skein skein_03] [--picture docs/images/herring_roe.png]`` keeps the
report's first panels; ``--turning docs/images/turning.webp`` keeps the surface behind the volume, turned once
about; ``--tune docs/images/tune.png`` the page of ``roemetry tune`` with a threshold that is too high.
"""

from __future__ import annotations

import shutil
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.command import parser_of
from roemetry import Recipe, run_recipe

_RECIPE = Path("recipes/herring_roe")
_PANELS = 4
_STEPS, _MS = 45, 100
"""Frames of the moving picture, and how long each stands: once about in four seconds."""


def main() -> None:
    """Open what is asked for in a browser, and keep what it looks like."""
    parser = parser_of(__doc__)
    parser.add_argument("--skein", default="skein_03")
    parser.add_argument("--picture", type=Path, default=Path("docs/images/herring_roe.png"))
    parser.add_argument("--turning", type=Path, help="write the moving picture there instead")
    parser.add_argument("--tune", type=Path, help="write the picture of the tuning page there instead")
    given = parser.parse_args()
    if given.tune:
        _tuned(given.tune)
    else:
        with tempfile.TemporaryDirectory() as folder:
            report = _report(
                given.skein, "with_outline.yaml" if given.turning else "recipe.yaml", Path(folder)
            )
            if given.turning:
                _turned(report, given.turning)
            else:
                _photographed(report, given.picture)
    print(given.tune or given.turning or given.picture)


@contextmanager
def _page(width: int, url: str) -> Iterator[Any]:
    """Open a page in a browser of this machine."""
    from playwright.sync_api import sync_playwright

    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next(filter(None, map(shutil.which, names)), None)
    if browser is None:
        raise SystemExit("there is no browser on this machine to open the page in")
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        try:
            page = opened.new_page(viewport={"width": width, "height": 900})
            page.goto(url)
            yield page
        finally:
            opened.close()


def _report(skein: str, recipe: str, folder: Path) -> str:
    """Measure a skein; give the address of its report."""
    image = (_RECIPE / "images" / f"{skein}.png").resolve()
    sets = [f"source.path={image}", "sinks=[report]"]
    run_recipe(Recipe.load(_RECIPE / recipe, sets=sets), folder / "run")
    return (folder / "run" / "report.html").resolve().as_uri()


def _photographed(report: str, picture: Path) -> None:
    with _page(1000, report) as page:
        panels = page.locator("section.acquisition .panels .panel").all()[:_PANELS]
        boxes = [box for panel in panels if (box := panel.bounding_box()) is not None]
        left, top = min(box["x"] for box in boxes), min(box["y"] for box in boxes)
        right = max(box["x"] + box["width"] for box in boxes)
        low = max(box["y"] + box["height"] for box in boxes)
        clip = {"x": left - 5, "y": top - 7, "width": right - left + 10, "height": low - top + 10}
        page.screenshot(path=str(picture), full_page=True, clip=clip)


def _turned(report: str, picture: Path) -> None:
    """Turn the three-dimensional view by its keys, and write what it shows as an animated WebP."""
    shots = []
    with _page(900, report) as page:
        solid = page.locator("figure.solid").first
        solid.scroll_into_view_if_needed()
        page.wait_for_selector("figure.solid.live canvas")
        solid.get_by_role("button", name="Height").click()
        canvas = solid.locator("canvas")
        quiet = ".solid-bar { visibility: hidden } canvas:focus-visible { outline: 0 !important }"
        page.add_style_tag(content=quiet)
        canvas.focus()
        page.keyboard.press("0")
        for _ in range(_STEPS):
            shot = cv2.imdecode(np.frombuffer(canvas.screenshot(), np.uint8), cv2.IMREAD_COLOR)
            shots.append(cv2.resize(shot, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA))
            page.keyboard.press("ArrowRight")
            page.keyboard.press("ArrowRight")
    animation = cv2.Animation()
    animation.frames, animation.durations = shots, [_MS] * len(shots)
    if not cv2.imwriteanimation(str(picture), animation, [cv2.IMWRITE_WEBP_QUALITY, 75]):
        raise SystemExit(f"{picture} could not be written")


def _tuned(picture: Path) -> None:
    """Show a threshold that is too high: gaps at the product's edges, and the profiles as saved in grey."""
    import uvicorn

    from roemetry_tools.tune.server import LOOPBACK, app_of
    from roemetry_tools.tune.session import Session

    session = Session(_RECIPE)
    session.warm_up()
    with socket.socket() as listening:
        listening.bind((LOOPBACK, 0))
        listening.listen()
        server = uvicorn.Server(uvicorn.Config(app_of(session), log_level="warning", lifespan="off"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            with _page(1440, f"http://{LOOPBACK}:{listening.getsockname()[1]}/") as page:
                page.wait_for_selector("body[data-took]")
                answered = page.get_attribute("body", "data-answers")
                page.locator("#extractor-threshold").fill("60")
                page.wait_for_selector(f'body:not([data-answers="{answered}"])')
                page.locator("#picture").focus()
                saved = "document.getElementById('file').textContent = 'recipes/herring_roe/recipe.yaml'"
                page.evaluate(saved)
                page.wait_for_timeout(400)
                page.screenshot(path=str(picture))
        finally:
            server.should_exit = server.force_exit = True
            thread.join(20)
