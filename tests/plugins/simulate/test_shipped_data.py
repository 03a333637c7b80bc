"""The shipped herring roe data are what the simulator makes today of the scene that lies beside them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.config.dataset import Dataset
from roemetry.config.scene import Scene

DATA = Path(__file__).parents[3] / "recipes" / "herring_roe"

pytestmark = pytest.mark.skipif(
    not (DATA / "items.jsonl").exists(), reason="the herring roe data are not here"
)


@pytest.fixture(scope="module")
def data() -> Dataset:
    return Dataset(DATA)


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return image


def test_every_file_is_there_unchanged_and_of_its_scene(data: Dataset) -> None:
    assert list(data.faults()) == []
    assert data.description.made_from["scene_sha256"] == Scene.load(DATA).sha256
    assert "roemetry simulate scene.yaml --count 10 --seed 1" in data.description.made_with
    assert data.calibration_truth()["block"]["height_mm"] == 16.5
    assert data.sensor.gain_grey_per_electron == 0.0255
    items = list(data.items())
    assert [item.id for item in items] == [f"skein_{number:02d}" for number in range(1, 11)]
    for item in items:
        assert set(item.files) == {"laser", "plain"}
        for name in item.files.values():
            image = read(DATA / name)
            assert (image.shape, image.dtype) == ((480, 640), np.uint8)


def test_an_item_and_a_calibration_image_can_be_made_again(data: Dataset) -> None:
    # another processor may round a rare grey level to its neighbour
    item = list(data.items())[5]
    stage = Scene.load(DATA).make()
    made, known = stage.simulate(5, 1), data.truth(item)
    for frame in made.frames:
        assert np.mean(frame.pixels != read(DATA / item.files[frame.role])) < 1e-3
    np.testing.assert_array_equal(made.truth.stripes.product, known.stripes.product)
    np.testing.assert_allclose(made.truth.stripes.x_px, known.stripes.x_px, rtol=0, atol=1e-4)
    (one,), (other,) = made.truth.products, known.products
    assert (one.label, one.defect) == (other.label, other.defect)
    assert one.visible_mm3 == pytest.approx(other.visible_mm3, rel=1e-9)
    assert one.figures == pytest.approx(other.figures, abs=1e-6)
    belt = stage.calibration_frames(1)["belt"]["belt"]
    assert np.mean(belt.pixels != read(DATA / "calibration" / "belt.png")) < 1e-3


def test_one_dent_lies_under_a_stripe_and_one_between(data: Dataset) -> None:
    truths = [item.products[0] for item in data.items()]
    under, between = truths[2], truths[3]
    assert {under.defect, between.defect} == {"dented"}
    assert under.figures["defect_seen_mm"] > 0.8 * under.figures["defect_depth_mm"]
    assert between.figures["defect_depth_mm"] >= 2.0
    assert between.figures["defect_seen_mm"] < 0.5
    assert {one.label for one in (under, between)} == {"henkei"}
    assert truths[1].label == "good"
    assert truths[1].figures["defect_depth_mm"] == 0.0
