"""The shipped herring roe data are what the simulator makes today."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry_simulate import herring_roe
from roemetry_simulate.herring_dataset import SHIPPED

DATA = Path(__file__).parents[3] / "recipes" / "herring_roe"

pytestmark = pytest.mark.skipif(not (DATA / "truth.csv").exists(), reason="the herring roe data are not here")


def read(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return image


def test_every_row_of_truth_has_its_two_images():
    with (DATA / "truth.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["seed"]), row["defect"]) for row in rows] == [
        (seed, "none" if kind == "healthy" else kind) for seed, kind in SHIPPED
    ]
    for row in rows:
        for path in (DATA / row["file"], DATA / row["file"].replace("images/", "images_plain/")):
            image = read(path)
            assert image.shape == (480, 640)
            assert image.dtype == np.uint8
    for name in ("block.png", "belt.png"):
        assert read(DATA / "calibration" / name).shape == (480, 640)


def test_a_shipped_image_can_be_made_again():
    # another processor may round a rare grey level to its neighbour
    made = herring_roe.render_scene(herring_roe.scene(*SHIPPED[5]))
    assert np.mean(made != read(DATA / "images" / "skein_06.png")) < 1e-3


def test_a_shipped_stripe_truth_can_be_made_again():
    with np.load(DATA / "truth_stripes.npz") as stored:
        x_px, on_product = stored["x_px"], stored["on_product"]
    assert x_px.shape == on_product.shape == (len(SHIPPED), 11, 480)
    truth = herring_roe.stripe_truth(herring_roe.scene(*SHIPPED[6]))
    np.testing.assert_array_equal(truth.on_product, on_product[6])
    np.testing.assert_allclose(truth.x_px, x_px[6], rtol=0, atol=1e-4)


def test_the_folder_stays_small():
    size = (
        sum(path.stat().st_size for path in DATA.rglob("*.png")) + (DATA / "truth_stripes.npz").stat().st_size
    )
    assert size < 4_000_000


def test_the_scene_and_the_data_set_belong_together():
    from roemetry.dataset import Dataset
    from roemetry.scene import Scene

    data, scene_file = Dataset(DATA), Scene.load(DATA)
    assert list(data.faults()) == []
    assert data.description.made_from["scene_sha256"] == scene_file.sha256
    assert "roemetry simulate scene.yaml" in data.description.made_with
    with (DATA / "truth.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with np.load(DATA / "truth_stripes.npz") as stored:
        x_px = stored["x_px"]
    for number, (item, row) in enumerate(zip(data.items(), rows, strict=True)):
        product = item.products[0]
        assert item.files["laser"] == row["file"]
        assert (product.label, product.defect) == (row["class"], row["defect"])
        assert product.mass_g == pytest.approx(float(row["weight_g"]), abs=1e-3)
        assert product.visible_mm3 == pytest.approx(float(row["visible_volume_mm3"]), abs=0.1)
        assert product.figures["defect_seen_mm"] == pytest.approx(float(row["defect_seen_mm"]), abs=0.02)
        np.testing.assert_allclose(data.truth(item).stripes.x_px, x_px[number], rtol=0, atol=1e-4)


def test_the_scene_file_makes_a_shipped_image():
    from roemetry.scene import Scene

    stage = Scene.load(DATA).make()
    made = stage.calibration_frames(1)["belt"]["belt"]
    assert np.mean(made.pixels != read(DATA / "calibration" / "belt.png")) < 1e-3
