from __future__ import annotations

import base64
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import cv2
import numpy as np
import pytest

from roemetry.html import plots as svg
from roemetry.records import AMBIGUOUS, Frame, ImageArrows
from roemetry_report import palette
from roemetry_report.charts import height_charts, share_bar, slice_chart
from roemetry_report.panels import arc_panel, base_image, curves, panels

NUMBER = re.compile(r"[A-Za-z]|-?(?:\d+(?:\.\d*)?|\.\d+)")


def points(data: str) -> np.ndarray:
    """Follow path data (M, m, l, h, v, z) and give every place the pen comes to, absolute."""
    tokens = NUMBER.findall(data)
    x = y = 0.0
    found, i, command = [], 0, ""
    while i < len(tokens):
        if tokens[i].isalpha():
            command = tokens[i]
            i += 1
        if command in "zZ":
            continue
        a = float(tokens[i])
        if command in "hv":
            x, y = (x + a, y) if command == "h" else (x, y + a)
            i += 1
        else:
            b = float(tokens[i + 1])
            x, y = (a, b) if command == "M" else (x + a, y + b)
            i += 2
            command = {"M": "l", "m": "l"}.get(command, command)
        found.append((x, y))
    return np.array(found)


@pytest.fixture(scope="module")
def trace(synthetic):
    return synthetic.trace_of(synthetic.Scene("a", ambiguous=((5, 100, 120),)))


@pytest.fixture(scope="module")
def drawn(trace):
    return {panel.letter: ElementTree.fromstring(panel.drawing) for panel in panels(trace, "k")}


def test_the_view_has_pixel_centres_at_whole_numbers_and_the_image_once(drawn):
    assert set(drawn) == set("abcd")
    assert {element.get("viewBox") for element in drawn.values()} == {"-.5 -.5 640 480"}
    image = drawn["a"].find("image")
    assert [image.get(of) for of in ("x", "y", "width", "height")] == ["-.5", "-.5", "640", "480"]
    assert [e.get("href") for e in drawn["c"].iter("use")] == ["#k-image", "#k-curves"]
    assert drawn["b"].find("g").get("id") == "k-peaks"
    assert drawn["d"].find("g").get("id") == "k-curves"
    numbers = [e.text for e in drawn["d"].iter("text") if e.get("class") == "number"]
    assert numbers == [str(i) for i in range(1, 12)], "stripes are numbered from one at their tops"


def test_every_peak_is_a_dot_where_it_was_found(trace, drawn):
    data = drawn["b"].find("g").find("path").get("d")
    found = np.unique(np.round(points(data), 2), axis=0)
    given = np.unique(np.round(np.column_stack([trace.peaks.x_px, trace.peaks.row]), 2), axis=0)
    np.testing.assert_allclose(found, given, atol=1e-9)


def test_a_bright_pixel_and_its_peak_lie_on_each_other(trace):
    pixels = np.zeros((40, 60), np.uint8)
    pixels[10, 20] = 255
    one = replace(trace, frame=Frame(pixels), acquisition=None, peaks=None, stripes=None)
    image = base_image(one)
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(image.uri.split(",")[1]), np.uint8), 0)
    row, column = np.unravel_index(int(shown.argmax()), shown.shape)
    # The picture begins at −0.5, so the middle of its pixel (row, column) is at (column, row).
    assert (-0.5 + column + 0.5, -0.5 + row + 0.5) == (20, 10)
    assert svg.dots(np.array([20.0]), np.array([10.0])) == "M20 10h0"


def test_curves_lie_where_the_stripes_are_and_bridges_reach_their_neighbours(trace):
    stripe, first, last = 4, 236, 250
    drawing = ElementTree.fromstring(f"<g>{curves(trace.stripes)}</g>")
    colour = palette.stripe_colour(stripe)
    mine = [e for e in drawing if e.get("stroke") == colour]
    solid = points(next(e for e in mine if "c-bridged" not in e.get("class")).get("d"))
    dashed = points(next(e for e in mine if "c-bridged" in e.get("class")).get("d"))
    x = trace.stripes.x_px[stripe]
    np.testing.assert_allclose(solid[:, 0], x[solid[:, 1].astype(int)], atol=0.005 + 1e-9)
    gap = dashed[(dashed[:, 1] >= first - 1) & (dashed[:, 1] <= last)]
    assert gap[:, 1].tolist() == list(range(first - 1, last + 1))
    assert not np.isin(np.arange(first, last), solid[:, 1]).any()
    belt = [e for e in drawing if "c-belt" in e.get("class")]
    assert {e.get("stroke") for e in belt} == {palette.BELT}


def test_ambiguous_and_unlabelled_peaks_differ_in_shape_and_colour(trace, drawn):
    paths = {e.get("class"): e for e in drawn["d"].iter("path")}
    ambiguous, unlabelled = paths["c c-ambiguous"], paths["c c-unlabelled"]
    assert ambiguous.get("stroke") == palette.AMBIGUOUS
    assert ambiguous.get("d").count("M") == int((trace.stripes.peak_stripe == AMBIGUOUS).sum()) == 20
    assert ambiguous.get("d").count("z") == 20
    assert "z" not in unlabelled.get("d")
    centre = points("M" + unlabelled.get("d").split("M")[1])[0]
    first = np.flatnonzero(trace.stripes.peak_stripe == -1)[0]
    np.testing.assert_allclose(centre, [trace.peaks.x_px[first], trace.peaks.row[first]], atol=0.006)


def test_colour_is_kept_and_turned_with_the_frame(synthetic):
    scene = synthetic.Scene("a", turn_deg=90, colour=True)
    image = base_image(synthetic.trace_of(scene))
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(image.uri.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
    grey = synthetic.trace_of(scene).frame.pixels.astype(float)
    assert shown.shape == (480, 640, 3)
    assert np.corrcoef(shown[:, :, 2].ravel(), grey.ravel())[0, 1] > 0.97
    assert shown[:, :, 2].mean() > 2 * shown[:, :, 0].mean()
    assert image.notes[0].startswith("turned by 90°")


def test_a_dark_sixteen_bit_picture_is_brightened_and_a_large_one_scaled(trace):
    pixels = np.zeros((2000, 3000), np.uint16)
    pixels[::2] = 500
    image = base_image(replace(trace, frame=Frame(pixels, bit_depth=12), acquisition=None))
    assert (image.rows, image.columns) == (2000, 3000)
    assert any("brightened" in note for note in image.notes)
    assert any("scaled" in note for note in image.notes)
    assert len(image.uri) < 100_000
    black = Frame(np.zeros((480, 640), np.uint8))
    bare = replace(trace, frame=black, acquisition=None, peaks=None, stripes=None)
    assert [panel.letter for panel in panels(bare, "k")] == ["a"]


def test_arrows_that_lead_too_far_are_counted_and_left_out(trace):
    ends = np.array([[330.0, 310.0], [5000.0, 300.0], [300.0, 720.0], [np.nan, np.nan]])
    radii, flagged = np.array([30.0, 4700.0, 420.0, np.nan]), np.array([True, False, False, False])
    marks = ImageArrows("centre of arc", "px", np.full(4, 4), np.full((4, 2), 300.0), ends, radii, flagged)
    panel = arc_panel(marks, trace.stripes, 1, (480, 640), "k")
    drawing = ElementTree.fromstring(panel.drawing)
    groups = {g.get("class"): [points(p.get("d")) for p in g] for g in drawing.iter("g")}
    np.testing.assert_allclose(groups["flagged"], [[[300, 300], [330, 310]]])
    assert len(groups["mark"]) == 1
    said = "; ".join(panel.notes)
    assert "4 arrows, 1 flagged" in said
    assert "1 not drawn: farther away than 1.5 image heights" in said
    assert "1 without a place" in said
    assert "1 leads out of the picture" in said
    x, y, width, height = map(float, drawing.get("viewBox").split())
    assert width < 640 and height < 480, "zoomed to the product"
    assert x <= 330 <= x + width and y <= 310 <= y + height
    empty = np.empty((0, 2))
    none = ImageArrows("centre", "px", np.empty(0, int), empty, empty, np.empty(0), np.empty(0, bool))
    assert arc_panel(none, trace.stripes, 9, (480, 640), "k") is None
    assert "0 arrows" in "; ".join(arc_panel(none, trace.stripes, 1, (480, 640), "k").notes)


def test_a_bars_face_is_its_slices_volume_and_shares_fill_the_bar(synthetic):
    (row,) = synthetic.measurements_of(synthetic.Scene("a"))
    spacing = row.volume.slice_spacing_mm * np.linspace(1.0, 2.0, row.volume.slice_spacing_mm.size)
    volume = replace(row.volume, slice_spacing_mm=spacing)
    bars = list(ElementTree.fromstring(slice_chart(volume)).iter("rect"))
    faces = np.array([(float(b.get("width")) + 1.5) * float(b.get("height")) for b in bars])
    volumes = volume.slice_area_mm2 * volume.slice_spacing_mm
    np.testing.assert_allclose(faces / faces.sum(), volumes / volumes.sum(), atol=2e-4)
    parts = list(ElementTree.fromstring(share_bar(row.volume.shares)).iter("rect"))
    assert [p.get("class") for p in parts] == ["seen", "interpolated", "assumed"]
    assert sum(float(p.get("width")) for p in parts) == pytest.approx(100, abs=0.02)


def test_height_charts_show_each_slice_that_carries_the_product(synthetic):
    s = synthetic
    scene = s.Scene("a", (s.Dome(165, 200, 120, 90), s.Dome(480, 290, 125, 100, 12)), gaps=())
    trace = s.trace_of(scene)
    first, second = (height_charts(trace.products[n].product.profiles, n + 1) for n in (0, 1))
    assert [c.title for c in first] == ["Stripe 1", "Stripe 2", "Stripe 3", "Stripe 4"]
    assert second[-1].title == "Stripe 11"
    kinds = {e.get("class") for c in first for e in ElementTree.fromstring(c.drawing).iter("path")}
    assert {"seen", "bridged"} <= kinds


def test_paths_do_not_drift():
    x = np.cumsum(np.full(5000, 0.005))
    y = np.arange(5000.0)
    np.testing.assert_allclose(points(svg.polyline(x, y))[:, 0], x, atol=0.0051)


SIGHTS = {  # Machado, Oliveira, Fernandes (2009), severity 1
    "usual": [1, 0, 0, 0, 1, 0, 0, 0, 1],
    "protan": [0.152286, 1.052583, -0.204868, 0.114503, 0.786281, 0.099216, -0.003882, -0.048116, 1.051998],
    "deutan": [0.367322, 0.860646, -0.227968, 0.280085, 0.672501, 0.047413, -0.011820, 0.042940, 0.968881],
    "tritan": [1.255528, -0.076749, -0.178779, -0.078411, 0.930809, 0.147602, 0.004733, 0.691367, 0.303900],
}


@pytest.mark.parametrize("sight", SIGHTS)
def test_neighbouring_stripes_differ_for_colour_blind_eyes(sight):
    c = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in palette.ON_DARK]) / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.reshape(SIGHTS[sight], (3, 3)).T, 0, 1).astype(np.float32)
    lab = cv2.cvtColor(seen[None], cv2.COLOR_LRGB2Lab)[0]
    assert np.linalg.norm(lab - np.roll(lab, -1, axis=0), axis=1).min() > 22


def test_lines_that_run_across_are_named_where_they_are_not_drawn(trace):
    """A grid's second family has stripes numbered on from the first, in an image of its own."""
    (plain,) = (panel for panel in panels(trace, "k") if panel.letter == "d")
    assert not [note for note in plain.notes if "across" in note]
    profiles = trace.profiles
    turned = profiles.xyz_mm[:, :, [1, 0, 2]]
    both = ("product", "seen", "x_px", "row_px", "height_std_mm", "frame", "plane")
    grid = replace(
        profiles,
        stripe=np.concatenate([profiles.stripe, profiles.stripe + 11]),
        xyz_mm=np.concatenate([profiles.xyz_mm, turned]),
        **{name: np.concatenate([getattr(profiles, name)] * 2) for name in both},
    )
    (drawn,) = (panel for panel in panels(replace(trace, profiles=grid), "k") if panel.letter == "d")
    assert "stripes 12 to 22, which run across, are not drawn" in drawn.notes
    titles = [chart.title for chart in height_charts(grid, 1)]
    half = len(titles) // 2
    assert [title.endswith(", over X") for title in titles] == [False] * half + [True] * half
