"""The picture of README: the first panels of the report on one shipped skein, as a browser shows them.

``python -m benchmarks report_picture [--skein skein_03] [--picture docs/images/herring_roe.png]``
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
    given = parser.parse_args()
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        raise SystemExit("there is no browser on this machine to open the report in")
    image = (_RECIPE / "images" / f"{given.skein}.png").resolve()
    with tempfile.TemporaryDirectory() as folder:
        recipe = Recipe.load(_RECIPE, sets=[f"source.path={image}", "sinks=[report]"])
        run_recipe(recipe, Path(folder) / "run")
        _photographed(browser, Path(folder) / "run" / "report.html", given.picture)
    print(given.picture)


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


if __name__ == "__main__":
    main()
