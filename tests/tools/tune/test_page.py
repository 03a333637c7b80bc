"""The page in a real browser: what a user does, and what is to be seen of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.io.yaml_source import read
from tests.browser import opened, served


class Bench:
    """A page on a recipe."""

    def __init__(self, page: Any) -> None:
        self.page = page
        page.wait_for_selector("body[data-took]")

    def after(self, action: Callable[[], Any]) -> None:
        """Do something and wait until it is answered."""
        answered = int(self.page.get_attribute("body", "data-answers"))
        action()
        for _ in range(2400):  # kernels that were never compiled here take their time
            if int(self.page.get_attribute("body", "data-answers")) > answered:
                self.page.wait_for_timeout(80)  # frames are drawn
                return
            self.page.wait_for_timeout(25)
        raise AssertionError("no answer")

    def number(self, label: str, column: int = 1) -> str:
        """Give a value of the table of numbers: column 1 is now, 2 as saved."""
        row = self.page.locator(".values tr", has_text=label).first
        return str(row.locator("td").nth(column - 1).inner_text())

    def picture(self) -> np.ndarray:
        data = self.page.locator("#picture").screenshot()
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


@pytest.fixture
def recipe(line: Callable[..., Path]) -> Path:
    path = line()
    path.write_text("# ours\n" + path.read_text("utf-8"), "utf-8")
    return path


@pytest.fixture
def bench(browser: Any, recipe: Path) -> Iterator[Bench]:
    with served(recipe) as address, opened(browser, address, width=1440) as page:
        yield Bench(page)


DRAWN = """async (what) => {
  const { drawProfiles } = await import("./page/charts.js");
  const along = [[0, -9, 1], [0, 0, what === "dots" ? NaN : 2], [0, 9, 1]];
  const other = what === "grid" ? [[-5, 0, 1], [0, 0, 2], [5, 0, 1]] : along;
  const slices = [along, other];
  const arrays = {
    "profiles.xyz_mm": { shape: [2, 3, 3], data: Float64Array.from(slices.flat(2)) },
    "profiles.seen": { shape: [2, 3], data: Uint8Array.from([1, 1, 1, 1, 1, 1]) },
    "profiles.product": { shape: [2, 3], data: Int32Array.from([1, 1, 1, 1, 1, 1]) },
    "profiles.stripe": { shape: [2], data: Int32Array.from([0, 15]) },
  };
  return drawProfiles(document.getElementById("profiles"), { arrays }, null, -1);
}"""


def test_lines_of_a_grid_that_run_across_are_drawn_over_x(bench: Bench) -> None:
    assert bench.page.evaluate(DRAWN, "lines") == "height Z over Y, mm, of every slice on a product"
    alone = bench.page.locator("#profiles").screenshot()
    said = "height Z over Y, or over X along lines across, mm, of every slice on a product"
    assert bench.page.evaluate(DRAWN, "grid") == said
    assert bench.page.locator("#profiles").screenshot() != alone


def test_points_without_a_neighbour_are_drawn_as_dots(bench: Bench) -> None:
    """A matrix of dots has no others: the chart of its profiles was empty."""
    bench.page.evaluate(DRAWN, "dots")
    data = np.frombuffer(bench.page.locator("#profiles").screenshot(), np.uint8)
    drawn = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2HSV)
    assert np.count_nonzero(drawn[..., 1] > 100) > 4, "axes and words are grey"


def test_what_is_moved_exchanged_or_wrong_is_to_be_seen_and_can_be_taken_back(bench: Bench) -> None:
    page = bench.page
    before, volume = bench.picture(), bench.number("visible volume")
    profiles = page.locator("#profiles").screenshot()
    threshold, fault = page.locator("#extractor-threshold"), page.locator("#extractor-threshold-fault")
    page.locator("[data-kind=extractor] input[type=range]").first.focus()
    bench.after(lambda: page.keyboard.press("End"))
    assert threshold.input_value() == "255"
    assert bench.picture().tobytes() != before.tobytes()
    assert page.locator("#profiles").screenshot() != profiles
    assert page.locator("text=no peaks at all").count() == 1
    bench.after(lambda: page.get_by_label("threshold: as the recipe has it").click())
    assert threshold.input_value() == "60"
    assert bench.number("visible volume") == volume
    assert page.locator("#save").is_disabled()
    bench.after(lambda: threshold.fill("abc"))
    assert "number" in fault.inner_text()
    assert threshold.get_attribute("aria-invalid") == "true"
    assert page.locator("#stale").is_visible()
    assert page.locator("#save").is_disabled()
    assert bench.number("visible volume") == volume
    bench.after(lambda: threshold.fill("70"))
    assert fault.is_hidden()
    assert page.locator("#stale").is_hidden()
    plugin = page.get_by_label("extractor: plugin")
    bench.after(lambda: plugin.select_option("log-parabola"))
    assert page.locator("#extractor-width_max_px").input_value() == "40"
    assert page.get_by_role("button", name="auto").first.get_attribute("aria-pressed") == "true"
    bench.after(lambda: plugin.select_option("dominant-peak"))
    assert threshold.input_value() == "70", "what was set comes back"
    assert bench.number("visible volume", 2) != ""
    bench.after(lambda: page.get_by_label("triangulator: plugin").select_option(""))
    said = page.locator("[data-kind=volume] > .fault").inner_text()
    assert said == "it works on the result of the triangulator; add one"


def test_keys_choose_row_and_frame_and_problem_places_are_marked(bench: Bench, recipe: Path) -> None:
    """Peaks at the white level are magenta at their own place; unticked, they are not."""
    page = bench.page
    page.locator("#picture").focus()
    assert "row 120" in page.locator("#row-title").inner_text()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Shift+ArrowDown")
    assert "row 131" in page.locator("#row-title").inner_text()
    before = bench.picture()
    for key in ("+", "0"):
        page.keyboard.press(key)
        page.wait_for_timeout(150)
        assert (bench.picture().tobytes() == before.tobytes()) == (key == "0")
    file = recipe.parent / "images" / "p02.png"
    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    image[20:30, 79:82] = 255  # saturated light on the second stripe, which rests at x 80
    cv2.imwrite(str(file), image)
    bench.after(lambda: page.keyboard.press("n"))
    assert page.locator("#acquisition").input_value() == "p02"

    def magenta() -> np.ndarray:
        shown = bench.picture().astype(int)
        return np.argwhere((shown[..., 2] > 200) & (shown[..., 0] > 200) & (shown[..., 1] < 150))

    marked = magenta()
    assert len(marked) > 10
    box = page.locator("#picture").bounding_box()
    scale = min(box["width"] / 320, box["height"] / 240)
    left, top = (box["width"] - 320 * scale) / 2, (box["height"] - 240 * scale) / 2
    x, row = (marked[:, 1].mean() - left) / scale - 0.5, (marked[:, 0].mean() - top) / scale - 0.5
    assert abs(x - 80.0) < 5.0
    assert abs(row - 24.5) < 3.0
    page.locator("#layer-saturated").uncheck()
    page.wait_for_timeout(150)
    assert len(magenta()) == 0
    page.locator("#layer-saturated").check()
    page.locator("button.show.saturated").click()
    page.wait_for_timeout(150)
    assert len(magenta()) > len(marked), "shown large"


def test_saving_shows_the_changes_and_writes_them(bench: Bench, recipe: Path) -> None:
    page = bench.page
    before = recipe.read_text("utf-8")
    bench.after(lambda: page.locator("#extractor-threshold").fill("75"))
    page.locator("#save").click()
    assert page.locator("#changes").inner_text().split() == [
        "stages.extractor.options.threshold", "60", "→", "75",
    ]  # fmt: skip
    bench.after(lambda: page.locator("#save-now").click())
    assert recipe.read_text("utf-8") == before.replace("threshold: 60", "threshold: 75")
    assert "recipe.yaml.old-1" in page.locator("#file").inner_text()
    assert (recipe.parent / "recipe.yaml.old-1").read_text("utf-8") == before
    assert page.locator("#save").is_disabled()
    bench.after(lambda: page.locator("#extractor-threshold").fill("80"))
    recipe.write_text(recipe.read_text("utf-8") + "# mine\n", "utf-8")
    page.locator("#save").click()
    page.locator("#save-now").click()
    page.wait_for_selector("#save-fault:not([hidden])")
    assert "changed by someone else" in page.locator("#save-fault").inner_text()
    page.locator("#save-name").fill("another.yaml")
    bench.after(lambda: page.locator("#save-now").click())
    saved = read(recipe.parent / "another.yaml").data
    assert saved["stages"]["extractor"]["options"]["threshold"] == 80
    page.faults.clear()  # the browser itself notes that a request was refused
