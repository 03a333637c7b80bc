"""Records in a console and in a notebook, and as other libraries' tables."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

import roemetry
from roemetry import Recipe
from roemetry.records import Estimate, Measurement, Volume


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
