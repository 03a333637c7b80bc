"""The view in three dimensions: what is sent is what was measured; a browser turns it, paper shows it."""

from __future__ import annotations

import base64
import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.records import Profiles
from roemetry_report.sink import Report
from roemetry_report.solid import Solid, solid
from tests.browser import opened


def read(given: Solid) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray]:
    """Give head, points (mm), flags and uncertainties (mm) as the page's script reads them."""
    head = json.loads(given.head)
    data = base64.b64decode(given.points)
    count = sum(entry[2] for entry in head["slices"])
    corners = sum(rows * columns for _, rows, columns, _ in head["grids"])
    assert len(data) == 12 * count + 11 * corners
    steps = np.frombuffer(data, "<i2", 3 * count).reshape(count, 3)
    at = 10 * count + 6 * corners
    flags = np.frombuffer(data, np.uint8, count, at)
    shares = np.frombuffer(data, np.uint8, count, at + count)
    std = np.where(shares == 255, np.nan, shares / 254 * head["std"])
    return head, steps * head["step"] + np.array(head["origin"]), flags, std


@pytest.fixture(scope="module")
def profiles(synthetic: Any) -> Profiles:
    found: Profiles = synthetic.trace_of(synthetic.Scene("a")).profiles
    return found


def test_every_point_that_is_sent_was_measured_to_a_hundredth(profiles: Profiles) -> None:
    given = solid(profiles)
    assert given is not None
    head, xyz, flags, std = read(given)
    assert [entry[1] for entry in head["slices"]] == [1] * len(head["slices"])
    at = 0
    for stripe, product, count in head["slices"]:
        index = int(np.flatnonzero(profiles.stripe == stripe)[0])
        on = profiles.product[index] == product
        measured = profiles.xyz_mm[index, on]
        mine = xyz[at : at + count]
        apart = np.abs(mine[:, None, :] - measured[None, :, :]).max(axis=2)
        assert apart.min(axis=1).max() <= 0.0051
        nearest = apart.argmin(axis=1)
        assert np.all(np.diff(nearest) > 0), "in the slice's own order"
        assert {0, int(on.sum()) - 1} <= set(nearest.tolist()), "both ends are kept"
        assert np.array_equal(flags[at : at + count] & 1, profiles.seen[index, on][nearest])
        at += count
    assert at == len(xyz) <= 720 + 4 * len(head["slices"])
    assert np.isnan(std).all() and head["std"] == 0.0


def test_a_hole_in_a_slice_is_not_joined(profiles: Profiles) -> None:
    index = 5
    on = np.flatnonzero(profiles.product[index] > 0)
    hole = on[40:60]
    arrays = {of: getattr(profiles, of).copy() for of in ("xyz_mm", "product", "seen", "x_px", "row_px")}
    for of, nothing in zip(arrays, (np.nan, -1, False, np.nan, np.nan), strict=True):
        arrays[of][index, hole] = nothing
    holed = replace(profiles, **arrays)
    given = solid(holed)
    assert given is not None
    head, points, flags, _ = read(given)
    slices = [entry[0] for entry in head["slices"]].index(int(profiles.stripe[index]))
    at = sum(entry[2] for entry in head["slices"][:slices])
    count = head["slices"][slices][2]
    free = np.flatnonzero((flags[at : at + count] & 2) == 0)
    assert len(free) == 2 and free[0] == 0
    edges = points[at + free[1] - 1 : at + free[1] + 1, 1]
    assert np.allclose(edges, profiles.xyz_mm[index, [hole[0] - 1, hole[-1] + 1], 1], atol=0.0051)


def test_uncertainties_come_out_within_a_percent_of_the_largest(
    profiles: Profiles, rng: np.random.Generator
) -> None:
    std = np.where(
        np.isfinite(profiles.xyz_mm[..., 2]), rng.uniform(0.01, 0.2, profiles.height_std_mm.shape), np.nan
    )
    given = solid(replace(profiles, height_std_mm=std))
    assert given is not None
    head, xyz, _, told = read(given)
    assert head["std"] <= 0.2
    known = np.isfinite(profiles.xyz_mm).all(axis=2) & (profiles.product > 0)
    where = profiles.xyz_mm[known]
    for point, value in list(zip(xyz, told, strict=True))[::40]:
        true = std[known][np.abs(where - point).max(axis=1).argmin()]
        assert abs(value - true) <= 0.002


def test_two_products_are_never_bridged(synthetic: Any) -> None:
    scene = synthetic.Scene(
        "a", (synthetic.Dome(165, 200, 120, 90), synthetic.Dome(480, 290, 125, 100)), gaps=()
    )
    given = solid(synthetic.trace_of(scene).profiles)
    assert given is not None
    products = [entry[1] for entry in json.loads(given.head)["slices"]]
    assert products == sorted(products) and set(products) == {1, 2}
    cells = len(re.findall("solid-cell", str(given.still)))
    assert cells == 7 * (len(products) - 2)
    assert [(grid[0], grid[3]) for grid in json.loads(given.head)["grids"]] == [(1, 0), (2, 0)]


def test_the_still_picture_keeps_within_its_frame_and_says_what_it_is(profiles: Profiles) -> None:
    given = solid(profiles)
    assert given is not None
    drawing = ElementTree.fromstring(given.still)
    assert "mm high" in drawing.get("aria-label", "")
    assert len(str(given.still)) < 9000
    assert len(given.points) < 32_000
    for path in drawing.iter("path"):
        x, y = map(float, re.match(r"M(-?[\d.]+)[ ]?(-?[\d.]+)", path.get("d", "")).groups())  # type: ignore[union-attr]
        assert 0 <= x <= 760 and 0 <= y <= 400
    belt = replace(profiles, product=np.where(profiles.product > 0, 0, profiles.product).astype(np.int16))
    assert solid(belt) is None, "nothing on a product is nothing to show"


def test_it_turns_in_a_browser_and_is_a_picture_without_scripts(
    browser: Any, synthetic: Any, tmp_path: Path
) -> None:
    scene = synthetic.Scene("one")
    run = synthetic.run_of(tmp_path, synthetic.measurements_of(scene), {"one": synthetic.trace_of(scene)})
    (report,) = Report().write(run)

    def coloured(page: Any) -> float:
        """Share of the picture in the colours of heights, which are neither grey nor white."""
        page.wait_for_timeout(120)
        data = page.locator("figure.solid .solid-stage").first.screenshot()
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return float((np.ptp(image.astype(int), axis=2) > 25).mean())

    with opened(browser, report.as_uri(), scripts=False) as page:
        assert coloured(page) > 0.05
        assert page.locator("figure.solid canvas").count() == 0
    with opened(browser, report.as_uri()) as page:
        page.locator("figure.solid").first.scroll_into_view_if_needed()
        page.wait_for_selector("figure.solid.live canvas")
        before = coloured(page)
        assert before > 0.05
        page.locator("figure.solid canvas").first.drag_to(page.locator("figure.solid").first)
        assert coloured(page) != before, "a drag turns it"
        page.get_by_role("button", name="Seen and assumed").first.click()
        assert coloured(page) != before
