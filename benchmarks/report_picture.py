"""The pictures of README and the docs' first page: one shipped skein's report, as a browser shows it.

``python -m benchmarks report_picture [--skein skein_03] [--picture docs/images/herring_roe.png]`` keeps the
first panels; ``--turning docs/images/turning.webp`` keeps the surface behind the volume, turned once about.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

from roemetry import Recipe, run_recipe

_RECIPE = Path("recipes/herring_roe")
_PANELS = 4


def main() -> None:
    """Measure the skein, open its report, and keep what its first panels look like."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skein", default="skein_03")
    parser.add_argument("--picture", type=Path, default=Path("docs/images/herring_roe.png"))
    parser.add_argument("--turning", type=Path, help="write the moving picture there instead")
    given = parser.parse_args()
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        raise SystemExit("there is no browser on this machine to open the report in")
    image = (_RECIPE / "images" / f"{given.skein}.png").resolve()
    with tempfile.TemporaryDirectory() as folder:
        name = "with_outline.yaml" if given.turning else "recipe.yaml"
        recipe = Recipe.load(_RECIPE / name, sets=[f"source.path={image}", "sinks=[report]"])
        run_recipe(recipe, Path(folder) / "run")
        report = Path(folder) / "run" / "report.html"
        if given.turning:
            _turned(browser, report, given.turning)
        else:
            _photographed(browser, report, given.picture)
    print(given.turning or given.picture)


def _photographed(browser: str, report: Path, picture: Path) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = opened.new_page(viewport={"width": 1000, "height": 900})
        page.goto(report.resolve().as_uri())
        boxes = [
            box
            for panel in page.locator("section.acquisition .panels .panel").all()[:_PANELS]
            if (box := panel.bounding_box()) is not None
        ]
        left, top = min(box["x"] for box in boxes), min(box["y"] for box in boxes)
        right = max(box["x"] + box["width"] for box in boxes)
        low = max(box["y"] + box["height"] for box in boxes)
        page.screenshot(
            path=str(picture),
            full_page=True,
            clip={"x": left - 5, "y": top - 7, "width": right - left + 10, "height": low - top + 10},
        )
        opened.close()


_STEPS, _MS = 45, 100
"""Frames of the moving picture, and how long each stands: once about in four seconds."""


def _turned(browser: str, report: Path, picture: Path) -> None:
    """Turn the three-dimensional view by its keys, and write what it shows as an animated WebP."""
    import cv2
    import numpy as np
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = opened.new_page(viewport={"width": 900, "height": 900})
        page.goto(report.resolve().as_uri())
        solid = page.locator("figure.solid").first
        solid.scroll_into_view_if_needed()
        page.wait_for_selector("figure.solid.live canvas")
        solid.get_by_role("button", name="Height").click()
        canvas = solid.locator("canvas")
        page.add_style_tag(
            content=".solid-bar { visibility: hidden } canvas:focus-visible { outline: 0 !important }"
        )
        canvas.focus()
        page.keyboard.press("0")
        shots = []
        for _ in range(_STEPS):
            shots.append(cv2.imdecode(np.frombuffer(canvas.screenshot(), np.uint8), cv2.IMREAD_COLOR))
            page.keyboard.press("ArrowRight")
            page.keyboard.press("ArrowRight")
        opened.close()
    animation = cv2.Animation()
    animation.frames = [
        cv2.resize(shot, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA) for shot in shots
    ]
    animation.durations = [_MS] * len(shots)
    if not cv2.imwriteanimation(str(picture), animation, [cv2.IMWRITE_WEBP_QUALITY, 75]):
        raise SystemExit(f"{picture} could not be written")


if __name__ == "__main__":
    main()
