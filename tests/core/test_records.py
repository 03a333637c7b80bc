"""Records refuse what they must not hold, cannot be changed, come back from a run, and are shown."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import roemetry
from roemetry import Recipe
from roemetry.errors import DataError, RecordError
from roemetry.records import (
    Coding,
    Estimate,
    Frame,
    Grade,
    Measurement,
    Peaks,
    Reason,
    Shares,
    StripeMap,
    Volume,
    Weight,
)


def peaks(row: list[int], x_px: list[float], size: tuple[int, int] = (4, 20)) -> Peaks:
    n = len(row)
    nothing = np.full(n, np.nan)
    return Peaks(size, np.array(row), np.array(x_px), nothing, nothing, nothing, nothing, np.zeros(n))


def test_peaks_are_found_by_row() -> None:
    found = peaks([0, 0, 2, 2, 2], [1.0, 5.0, 2.0, 3.0, 9.0])
    assert found.row_start.tolist() == [0, 2, 2, 5, 5]
    assert len(peaks([], [])) == 0


@pytest.mark.parametrize(
    ("row", "x_px", "fault"),
    [
        ([1, 0], [1.0, 1.0], "not sorted"),
        ([0, 0], [5.0, 1.0], "not sorted"),
        ([0, 9], [1.0, 1.0], "row is outside"),
        ([0], [25.0], "x_px is outside"),
    ],
)
def test_peaks_refuse(row: list[int], x_px: list[float], fault: str) -> None:
    with pytest.raises(DataError, match=fault):
        peaks(row, x_px)


def test_all_faults_of_a_record_are_told_at_once() -> None:
    three = np.zeros(3)
    with pytest.raises(DataError, match=r"x_px has shape \(2,\)(.|\n)*amplitude has shape \(1,\)"):
        Peaks((4, 20), three, np.zeros(2), three, np.zeros(1), three, three, three)


def test_records_are_read_only_and_leave_the_array_they_came_from_alone() -> None:
    x_px = np.array([1.0, 5.0])
    made = Peaks((4, 20), np.array([0, 0]), x_px, x_px, x_px, x_px, x_px, np.zeros(2))
    with pytest.raises(ValueError, match="read-only"):
        made.x_px[0] = 3.0
    x_px[0] = 0.5


def test_frames_refuse() -> None:
    assert Frame(np.zeros((2, 2), np.uint16), bit_depth=12).white == 4095
    with pytest.raises(DataError, match="cannot hold"):
        Frame(np.zeros((2, 2), np.uint8), bit_depth=12)
    byte = np.uint8
    for pixels, says in ((np.zeros((0, 4), byte), "empty"), (np.zeros((4, 4, 2), byte), "shape")):
        with pytest.raises(DataError, match=says):
            Frame(pixels)


def test_a_stripe_map_without_x_has_no_product() -> None:
    nan, zero = np.full((1, 2), np.nan), np.zeros((1, 2))
    with pytest.raises(DataError, match="product is −1 exactly where"):
        StripeMap(nan, nan, zero, zero, nan, zero, nan, np.zeros(0))


texts = st.text(max_size=20)
words = texts.filter(lambda text: text.strip() != "")
reasons = st.lists(st.builds(Reason, words, words), max_size=3).map(tuple)
whys = st.lists(st.builds(Reason, words, words), min_size=1, max_size=3).map(tuple)
parts = st.floats(0.0, 1e300) | st.just(math.nan)
estimates = st.builds(Estimate, parts, parts, st.dictionaries(texts, parts, max_size=3))


@given(st.data())
@settings(max_examples=40)
def test_a_measurement_comes_back_from_its_line(data: st.DataObject) -> None:
    slices = data.draw(st.integers(0, 4))
    measurement = Measurement(
        id=data.draw(texts),
        acquisition=data.draw(texts),
        product=data.draw(st.integers(0, 9)),
        status=data.draw(st.sampled_from(["measured", "empty", "failed"])),
        products=data.draw(st.integers(1, 9)),
        coding=data.draw(st.none() | st.just(Coding(11, 9, 100, 90, 6, 4, 50, 3, math.nan, -3.5))),
        height_max_mm=data.draw(estimates),
        volume=Volume(
            data.draw(estimates),
            data.draw(st.none() | estimates),
            Shares(0.5, 0.25, 0.25),
            np.arange(slices),
            np.linspace(0, 1, slices),
            np.ones(slices),
            data.draw(whys),
        ),
        weight=Weight(data.draw(estimates), data.draw(whys)),
        grade=Grade(
            data.draw(st.text(min_size=1).filter(str.strip)),
            data.draw(st.floats(0.0, 1.0)),
            {"arcs": 3.0},
            data.draw(reasons),
        ),
        absent=data.draw(st.dictionaries(texts, st.builds(Reason, words, words), max_size=2)),
        reasons=data.draw(reasons),
        provenance=data.draw(st.dictionaries(texts, texts, max_size=2)),
    )
    line = measurement.to_json()
    assert "\n" not in line
    json.loads(line, parse_constant=lambda constant: pytest.fail(f"{constant} is no JSON"))
    assert Measurement.from_json(line).to_json() == line


def test_a_line_of_an_older_version_can_be_read() -> None:
    coding = Coding(11, 11, 100, labelled=90, ambiguous=4, unlabelled=6, rows_seen=80, rows_interpolated=3)
    line = Measurement("a#1", "a", 1, "measured", coding=coding).to_json()
    older = line.replace('"labelled"', '"coded"').replace('"unlabelled"', '"uncoded"')
    assert older != line
    assert Measurement.from_json(older).coding == coding


@pytest.mark.parametrize("line", ["", "{}", "[1]", '{"id": 3}', "nonsense"])
def test_a_line_that_is_no_measurement(line: str) -> None:
    with pytest.raises(DataError, match="not a measurement"):
        Measurement.from_json(line)


def test_a_line_with_a_number_that_no_array_holds_is_no_measurement() -> None:
    volume = Volume(
        Estimate(1.0), None, Shares(1.0, 0.0, 0.0), np.array([1]), np.array([1.0]), np.array([1.0])
    )
    line = Measurement("a#1", "a", 1, "measured", volume=volume).to_json()
    large = line.replace('"stripe": 1', f'"stripe": {2**70}')
    assert large != line
    with pytest.raises(DataError, match="not a measurement.*slice_stripe cannot be made int64"):
        Measurement.from_json(large)


@pytest.mark.parametrize("given", [[2**70], ["word"], [None]])
def test_what_cannot_be_an_array_names_the_field(given: list[Any]) -> None:
    with pytest.raises(RecordError, match="Peaks: row cannot be made int64"):
        Peaks((4, 20), given, *[np.zeros(1)] * 6)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda: Estimate(math.inf), "value is inf"),
        (lambda: Estimate(1.0, -0.1), "std -0.1"),
        (lambda: Estimate(1.0, 0.1, {"noise": math.inf}), "noise inf"),
        (lambda: Estimate(1.0, 0.1, interval=(2.0, 1.0)), "ends before it begins"),
        (lambda: Estimate(1.0, 0.1, interval=(2.0, 3.0)), "lies outside its interval"),
        (lambda: Reason("no-peak", " "), "expected words in both"),
        (lambda: Shares(0.9, 0.3, 0.0), "add up to 1"),
        (lambda: Volume(Estimate(-4321.0), None, Shares(1.0, 0.0, 0.0)), "visible volume is -4321 mm³"),
        (lambda: Volume(Estimate(1.0), Estimate(-2.0), Shares(1.0, 0.0, 0.0)), "true volume is -2 mm³"),
        (lambda: Volume(Estimate(math.nan), None, Shares(1.0, 0.0, 0.0)), "volume is NaN, and no reason"),
        (lambda: Weight(Estimate(-7.0)), "mass is -7 g"),
        (lambda: Weight(Estimate(math.nan)), "mass is NaN, and no reason"),
        (lambda: Weight(Estimate(1.0), features={"ml_per_g": math.inf}), "infinite: ml_per_g"),
        (lambda: Grade("good", features={"length_mm": math.inf}), "infinite: length_mm"),
        (lambda: Grade("good", 7.0), "probability is 7.0"),
        (lambda: Grade(" "), "label is empty"),
    ],
)
def test_results_that_cannot_be_are_refused(make: Any, fault: str) -> None:
    with pytest.raises(RecordError, match=re.escape(fault)):
        make()


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    return Recipe.load("recipes/herring_roe")


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    import cv2

    return cv2.imread("recipes/herring_roe/images/skein_01.png", cv2.IMREAD_GRAYSCALE)


def test_a_notebook_sees_picture_and_numbers(recipe: Recipe, image: np.ndarray) -> None:
    trace = recipe.trace(image)
    rig = roemetry.Rig.load("recipes/herring_roe/rig.yaml")
    for record in (
        trace,
        trace.frame,
        trace.peaks,
        trace.profiles,
        trace.products[0],
        recipe.calibration,
        rig,
    ):
        assert len(repr(record)) <= 300
        assert "\n" not in repr(record)
    assert "1 block, 1 belt" in rig._repr_html_()
    shown = trace._repr_html_()
    assert "data:image/png;base64," in shown
    assert "visible volume" in shown
    row = recipe.measure(image)[0]
    assert f"{row.volume.visible_mm3.value / 1000:.5g}" in row._repr_html_()
    assert row._repr_html_().count("<path") > 50, "its surface is drawn"
    assert "seen_xyz_mm" not in row.to_json()
    assert "dominant-peak" in recipe._repr_html_()


def test_rows_of_a_run_have_a_picture_that_costs_little(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for name in ("skein_01", "skein_02"):
        shutil.copy(f"recipes/herring_roe/images/{name}.png", images)
    sets = ["source.use=image-files", f"source.path={images}"]
    recipe = Recipe.load("recipes/herring_roe", sets=sets)
    for row in recipe.run():
        assert row._repr_html_().count("<path") > 50
        assert row.seen_xyz_mm.nbytes < 20_000, "a list of many rows stays small"
        assert np.nanmax(row.seen_xyz_mm[..., 2]) == pytest.approx(row.height_max_mm.value, rel=0.1)
    (images / "skein_02.png").write_bytes(b"")
    *_, unreadable = recipe.run()
    assert unreadable.status == "failed"
    assert unreadable.seen_xyz_mm is None


def test_text_of_records_is_no_markup_and_what_is_not_stated_is_said() -> None:
    row = Measurement("<b>#1", "<b>", 1, "measured", volume=None, height_max_mm=Estimate(math.nan))
    assert "<b>" not in row._repr_html_()
    assert "not stated" in row._repr_html_()


def test_a_data_frame_has_a_row_a_product(recipe: Recipe, image: np.ndarray) -> None:
    rows = recipe.measure(image)
    table = roemetry.to_pandas(rows)
    assert len(table) == len(rows)
    volume = rows[0].volume
    assert isinstance(volume, Volume)
    assert table["volume.visible_mm3.value"][0] == volume.visible_mm3.value
    assert roemetry.to_pandas([]).empty


def test_profiles_as_a_data_set_and_as_a_point_cloud(recipe: Recipe, image: np.ndarray) -> None:
    profiles = recipe.trace(image).profiles
    data = roemetry.to_xarray(profiles)
    np.testing.assert_array_equal(data["z_mm"].values, profiles.xyz_mm[:, :, 2])
    cloud = np.asarray(roemetry.to_point_cloud(profiles).points)
    assert len(cloud) == ((profiles.product > 0) & profiles.seen).sum()
    assert np.isfinite(cloud).all()
