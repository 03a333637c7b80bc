"""Records in a console and in a notebook, and as other libraries' tables."""

import math
from pathlib import Path

import numpy as np
import pytest

import roemetry
from roemetry import Recipe
from roemetry.records import Estimate, Frame, Measurement, Volume


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    return Recipe.load("recipes/herring_roe")


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    import cv2

    return cv2.imread("recipes/herring_roe/images/skein_01.png", cv2.IMREAD_GRAYSCALE)


def test_every_record_of_a_trace_fits_on_one_line(recipe: Recipe, image: np.ndarray) -> None:
    trace = recipe.trace(image)
    found = trace.products[0]
    parts = (trace.frame, trace.peaks, trace.stripes, trace.profiles, found, found.volume, found.grade)
    for record in (trace, *parts, recipe.calibration, *recipe.measure(image)):
        assert len(repr(record)) <= 200
        assert "\n" not in repr(record)
    assert len(repr(recipe)) <= 400
    assert "extractor" in repr(recipe)


def test_a_rig_and_the_stages_of_a_recipe_fit_on_one_line(recipe: Recipe) -> None:
    rig = roemetry.Rig.load(Path(__file__).parents[2] / "recipes/herring_roe/rig.yaml")
    for shown in (rig, *recipe.stages.values()):
        assert len(repr(shown)) <= 300
        assert "\n" not in repr(shown)
    assert "1 block, 1 belt" in rig._repr_html_()


def test_arrays_are_shown_by_type_and_shape() -> None:
    assert "uint8 (3, 5)" in repr(Frame(np.zeros((3, 5), np.uint8), role="laser", name="a", bit_depth=8))


def test_a_notebook_sees_picture_and_numbers(recipe: Recipe, image: np.ndarray) -> None:
    shown = recipe.trace(image)._repr_html_()
    assert "data:image/png;base64," in shown
    assert "visible volume" in shown
    row = recipe.measure(image)[0]
    assert f"{row.volume.visible_mm3.value / 1000:.5g}" in row._repr_html_()
    assert row._repr_html_().count("<path") > 50, "its surface is drawn"
    assert "seen_xyz_mm" not in row.to_json()
    assert "dominant-peak" in recipe._repr_html_()


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
