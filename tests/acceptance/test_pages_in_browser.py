"""Every kind of page in a real browser: no script error, nothing overflows, contrast, keyboard, print.

Recipes whose pages differ in kind are looked at in every run; with `-m thorough`, every shipped recipe.
"""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from roemetry import Recipe, run_recipe
from roemetry.cli.calibration import calibrate, check_calibration
from roemetry_line.line_file import Line
from roemetry_line.outbox import NewRow, Outbox
from roemetry_line.page.server import serve_page
from roemetry_study.commands import accept, gauge
from roemetry_study.commands import calibration as certify
from roemetry_tools.compare import compare
from roemetry_tools.plan import plan
from tests.browser import opened, served

HOME = Path(__file__).resolve().parents[2] / "recipes"


def some(quick: list[str], thorough: list[str]) -> list[Any]:
    return [*quick, *(pytest.param(one, marks=pytest.mark.thorough) for one in thorough)]


OTHERS = ["bread_roll", "egg", "fish_fillet", "potato", "herring_roe", "herring_roe/by_words.yaml"]
# with an outline and by a calibration with error; a groove; a scan; a pattern of light, which stands for all
REPORTS = some(
    ["herring_roe/with_outline.yaml", "weld_groove", "belt_scan", "potato_grid"],
    ["potato_dots", "potato_circles", *OTHERS],
)
RECIPES = some(
    ["herring_roe/with_outline.yaml", "belt_scan"],
    ["potato_dots", "potato_grid", "weld_groove", *OTHERS],
)
PATTERNS = ("potato_dots", "potato_grid")
"""Recipes whose extractor no other one can stand in for: an option of it is changed instead."""
RIGS = some(["bread_roll/rig.yaml", "herring_roe/boards.yaml"], ["egg/rig.yaml"])
"""One for each way to calibrate."""

PRODUCTS = 2
WIDTHS = (1300, 420)
"""A desk's and a telephone's, px. Paper is as wide whichever it was: each page is printed from the first."""

OVERFLOW = """() => {
  const wide = document.documentElement.clientWidth, found = [];
  const scrolled = document.documentElement.scrollWidth;
  if (scrolled > wide) found.push(`the page is ${scrolled} px wide`);
  for (const node of document.querySelectorAll("body *")) {
    const box = node.getBoundingClientRect(), style = getComputedStyle(node);
    if (!box.width || !box.height || node.closest(".scroll, .defs, [hidden]") !== null) continue;
    if (style.visibility === "hidden" || style.clipPath !== "none") continue;
    if (!node.ownerSVGElement && (box.right > wide + 1 || box.left < -1))
      found.push(`${node.tagName} .${node.className.baseVal ?? node.className}`);
    if (node.tagName !== "text") continue;
    const room = node.ownerSVGElement.getBoundingClientRect();
    const beside = Math.max(room.left - box.left, box.right - room.right);
    const out = Math.max(beside, room.top - box.top, box.bottom - room.bottom);
    if (out > 2) found.push(`"${node.textContent}" leaves "${node.ownerSVGElement.ariaLabel}" by ${out} px`);
  }
  for (const plot of document.querySelectorAll("svg.plot, svg.chart")) {
    const texts = Array.from(plot.querySelectorAll("text"));
    const boxes = texts.map((text) => [text.getBoundingClientRect(), text.textContent]);
    boxes.forEach(([a, one], k) => boxes.slice(k + 1).forEach(([b, other]) => {
      const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const along = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (across > 2 && along > 4) found.push(`"${one}" and "${other}" overlap in "${plot.ariaLabel}"`);
    }));
  }
  if (wide > 1000) for (const node of document.querySelectorAll(".scroll:has(.rows)"))
    if (node.scrollWidth > node.clientWidth + 1)
      found.push(`"${node.ariaLabel}" is cut off: ${node.scrollWidth} of ${node.clientWidth} px`);
  return found;
}"""
"""What is wider than the page, text that leaves its picture or covers other text, tables that are cut off."""

EMPTY_COLUMNS = """() => {
  const table = document.querySelector("table.rows"), rows = Array.from(table.tBodies[0].rows);
  const filled = (cell) => cell.textContent.replace(/[\\s–]/g, "") || cell.querySelector("svg");
  const heads = Array.from(table.tHead.rows[0].cells);
  return heads.filter((_, k) => !rows.some((row) => filled(row.cells[k]))).map((head) => head.textContent);
}"""
"""Headings of the summary table with nothing under them."""

UNREACHABLE = """() => {
  const found = [], rgb = (text) => [...text.match(/[\\d.]+/g).map(Number), 1].slice(0, 4);
  const linear = (v) => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
  const weights = [.2126, .7152, .0722];
  const luminance = (c) => weights.reduce((sum, w, k) => sum + w * linear(c[k] / 255), 0);
  const behind = (node) => {
    for (let n = node; n; n = n.parentElement) {
      const c = rgb(getComputedStyle(n).backgroundColor);
      if (c[3] > .8) return c;
    }
    return [255, 255, 255, 1];
  };
  for (const node of document.querySelectorAll("body *")) {
    const box = node.getBoundingClientRect(), style = getComputedStyle(node);
    if (!Array.from(node.childNodes).some((c) => c.nodeType === 3 && c.textContent.trim())) continue;
    if (!box.width || style.visibility === "hidden" || node.ownerSVGElement) continue;
    if (node.closest("[hidden], script, style, .defs, :disabled")) continue;
    const size = parseFloat(style.fontSize), bold = parseInt(style.fontWeight) >= 700;
    const least = size >= 24 || (bold && size >= 18.66) ? 3 : 4.5;
    const [light, dark] = [luminance(rgb(style.color)), luminance(behind(node))].sort((a, b) => b - a);
    const ratio = (light + .05) / (dark + .05), words = node.textContent.trim().slice(0, 40);
    if (ratio < least) found.push(`"${words}" has a contrast of ${ratio.toFixed(2)}`);
  }
  const controls = "a[href], button, input, select, textarea, summary, .scroll";
  for (const node of document.querySelectorAll(controls)) {
    if (!node.getBoundingClientRect().width || node.disabled || node.closest("[hidden]")) continue;
    const label = node.ariaLabel || node.getAttribute("aria-labelledby");
    if (!(label || node.textContent.trim() || node.labels?.length))
      found.push(`nothing says what this is: ${node.outerHTML.slice(0, 90)}`);
    if (node.tabIndex < 0) found.push(`the keyboard does not reach ${node.outerHTML.slice(0, 90)}`);
  }
  for (const node of document.querySelectorAll("canvas, svg:not([aria-hidden] svg, svg[aria-hidden])"))
    if (!node.ariaLabel && !node.getAttribute("aria-labelledby"))
      found.push(`no words for those who cannot see it: ${node.outerHTML.slice(0, 90)}`);
  return found;
}"""
"""WCAG 2 AA by computed styles: text below 4.5 : 1 (large: 3 : 1), controls without name or out of reach of
the keyboard, pictures without words."""


def few_products_of(name: str, folder: Path, products: int = PRODUCTS) -> Path:
    """Copy a shipped recipe with few products."""
    line, _, file = name.partition("/")
    folder = folder / line
    shutil.copytree(HOME / line, folder)
    if (items := folder / "data" / "items.jsonl").exists():
        items.write_text("".join(items.read_text("utf-8").splitlines(keepends=True)[:products]), "utf-8")
    for images in folder.glob("images*"):
        for image in sorted(images.iterdir())[products:]:
            image.unlink()
    if (items := folder / "items.jsonl").exists():
        items.write_text("".join(items.read_text("utf-8").splitlines(keepends=True)[:products]), "utf-8")
    return folder / (file or "recipe.yaml")


def assert_fits(page: Any, address: str) -> None:
    found = page.evaluate(OVERFLOW)
    found += page.evaluate(UNREACHABLE)
    assert found == [], f"{address}: {found[:5]}"


def assert_prints(browser: Any, page_file: Path) -> None:
    """A page without controls of its own, at both widths."""
    for width in WIDTHS:
        with opened(browser, page_file.as_uri(), width=width) as page:
            assert_fits(page, page_file.name)
            if width == WIDTHS[0]:
                assert len(page.pdf()) > 10_000


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_turns_enlarges_and_prints(browser: Any, tmp_path: Path, name: str) -> None:
    recipe = few_products_of(
        name, tmp_path, 1 if name in ("belt_scan", "potato_dots", "potato_grid") else PRODUCTS
    )
    run_recipe(Recipe.load(recipe, sets=["sinks=[report]", "draws=0"]), recipe.parent / "run")
    for width in WIDTHS:
        assert_a_report_answers(browser, (recipe.parent / "run" / "report.html").as_uri(), width)


def assert_a_report_answers(browser: Any, report: str, width: int) -> None:
    with opened(browser, report, width=width) as page:
        assert_fits(page, report)
        panels = page.locator("figure.panel")
        # a scan has no image, and so no panels of its peaks
        assert panels.count() >= (3 if "/belt_scan/" in report else 4)
        assert page.evaluate(EMPTY_COLUMNS) == []
        assert page.locator("figure.panel .enlarge").count() == panels.count()
        for panel in (panels.first, panels.last):
            small = panel.locator("svg").first.bounding_box()
            panel.locator(".enlarge").click()
            large = panel.locator("svg").first.bounding_box()
            assert large["width"] * large["height"] > 1.1 * small["width"] * small["height"]
            assert large["x"] >= 0 and large["x"] + large["width"] <= width
            page.keyboard.press("Escape")
            assert page.locator(".large").count() == 0
        for follow in page.locator("figure.follow").all()[:1]:
            said = follow.locator("output").inner_text()
            assert "mm" in said
            follow.locator("svg.screen").focus()
            page.keyboard.press("ArrowRight")
            assert follow.locator("output").inner_text() != said
        for solid in page.locator("figure.solid").all()[:1]:
            solid.scroll_into_view_if_needed()
            page.wait_for_selector("figure.solid.live canvas")
            before = solid.locator("canvas").screenshot()
            solid.locator("canvas").focus()
            page.keyboard.press("Shift+ArrowLeft")
            page.wait_for_timeout(100)
            assert solid.locator("canvas").screenshot() != before
            assert_fits(page, report)
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        assert page.locator("details:not([open])").count() == 0
        if width == WIDTHS[0]:
            assert len(page.pdf()) > 10_000


@pytest.mark.parametrize("name", RECIPES)
def test_a_comparison_prints_and_a_tuning_page_answers(browser: Any, tmp_path: Path, name: str) -> None:
    recipe, out = few_products_of(name, tmp_path), tmp_path / "compared"
    vary = "extractor=centre-of-gravity,dominant-peak"
    if name in PATTERNS:
        vary = "stages.extractor.options.width_max_px=9,11"
    with contextlib.suppress(typer.Exit):
        compare(recipe, vary=[vary], sets=["draws=0"], out=out)
    assert_prints(browser, out / "comparison.html")
    with served(recipe) as address:
        for width in WIDTHS:
            with opened(browser, address, width=width) as page:
                page.wait_for_selector("body[data-took]")
                assert_fits(page, address)
                assert "No product" not in page.locator("#numbers").inner_text()
                assert page.locator("#profiles-title").inner_text() != ""
                assert page.locator("#stage").is_hidden() == (name == "belt_scan"), "a scan has no frame"
                answers = page.get_attribute("body", "data-answers")
                if name in PATTERNS:
                    page.get_by_label("width_max_px: slider").first.focus()
                    page.keyboard.press("ArrowLeft")
                else:
                    extractor = page.get_by_label("extractor: plugin")
                    others = {"gaussian", "centre-of-gravity"} - {extractor.input_value()}
                    extractor.select_option(min(others))
                page.wait_for_selector(f'body:not([data-answers="{answers}"])')
                assert_fits(page, address)


@pytest.mark.parametrize("rig", RIGS)
def test_a_calibration_page_prints(browser: Any, tmp_path: Path, rig: str) -> None:
    path, doctor = tmp_path / "calibration.html", tmp_path / "doctor.html"
    calibrate(HOME / rig, out=tmp_path / "calibration.yaml", report=path, doctor=doctor)
    assert_prints(browser, doctor)
    for width in WIDTHS:
        with opened(browser, path.as_uri(), width=width) as page:
            assert_fits(page, rig)
            for space in page.locator("figure.space svg").all():
                before = space.inner_html()
                space.focus()
                page.keyboard.press("ArrowLeft")
                assert space.inner_html() != before
            if width == WIDTHS[0]:
                assert len(page.pdf()) > 10_000


@pytest.mark.parametrize("line", ["herring_roe", "potato"])
def test_a_plan_prints(browser: Any, tmp_path: Path, line: str) -> None:
    plan(HOME / line, out=tmp_path / "plan.html")
    assert_prints(browser, tmp_path / "plan.html")


def test_certificates_and_a_control_chart_print(browser: Any, tmp_path: Path) -> None:
    home = HOME / "herring_roe"
    study = tmp_path / "a_folder_with_a_name_as_long_as_a_job_on_a_build_server" / "heads.csv"
    study.parent.mkdir()
    shutil.copy(home / "studies" / "heads.csv", study)
    gauge([study], "visible_cm3", by="head", tolerance=4.0, out=tmp_path)
    accept(home / "acceptance.yaml", out=tmp_path)
    certify(home / "calibration.yaml", out=tmp_path)
    chart, block = tmp_path / "line.sqlite", home / "calibration" / "block.png"
    check_calibration(home, block, chart=chart, report=tmp_path / "chart.html")
    pages = sorted(tmp_path.glob("*.html"))
    assert [page.stem for page in pages] == ["acceptance", "calibration", "chart", "gauge"]
    for page in pages:
        assert_prints(browser, page)


def test_the_page_of_a_line_shows_its_last_product(browser: Any, line: Callable[..., Path]) -> None:
    file = line().parent / "line.yaml"
    file.write_text(
        "roemetry_line: 1\nname: line-1\nfolder: data\n"
        "stations: [{name: one, recipe: recipe.yaml, feed: folder-watch}]\npage: {port: 0}\n",
        "utf-8",
    )
    loaded = Line.load(file)
    assert loaded.page is not None
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    section = loaded.page.model_copy(update={"port": port})
    outbox = Outbox(loaded.folder)
    outbox.raise_alarm("one", "camera", "the camera is gone")
    summary = {"id": "p01#1", "status": "measured", "grade": "good", "decision": None, "lane": None,
               "late": 0, "mass_g": 20.5, "mass_std_g": 0.4, "volume_mm3": 20_100.0, "height_mm": 9.0,
               "reason": None}  # fmt: skip
    outbox.put([NewRow("p01", "one", "run-1", "product", summary, "p01 good")])
    stop = threading.Event()
    serving = threading.Thread(target=lambda: asyncio.run(serve_page(loaded, section, stop)))
    serving.start()
    try:
        for width in WIDTHS:
            with opened(browser, f"http://127.0.0.1:{port}/", width=width) as page:
                page.get_by_text("the camera is gone").wait_for()
                page.get_by_text("20.50 ± 0.40").wait_for()
                assert_fits(page, "line")
                if width == WIDTHS[0]:
                    assert len(page.pdf()) > 10_000
    finally:
        stop.set()
        serving.join(20)
