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


@pytest.fixture(scope="module")
def stage():
    return Scene.load(DATA).make()


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None, path
    return image


def test_every_file_is_there_and_unchanged(data: Dataset) -> None:
    assert list(data.faults()) == []
    items = list(data.items())
    assert [item.id for item in items] == [f"skein_{number:02d}" for number in range(1, 11)]
    for item in items:
        assert set(item.files) == {"laser", "plain"}
        for name in item.files.values():
            image = read(DATA / name)
            assert (image.shape, image.dtype) == ((480, 640), np.uint8)


def test_the_scene_and_the_data_set_belong_together(data: Dataset) -> None:
    assert data.description.made_from["scene_sha256"] == Scene.load(DATA).sha256
    assert "roemetry simulate scene.yaml --count 10 --seed 1" in data.description.made_with
    assert data.calibration_truth()["block"]["height_mm"] == 16.5
    assert data.sensor.gain_grey_per_electron == 0.0255


def test_an_item_can_be_made_again(data: Dataset, stage) -> None:
    # another processor may round a rare grey level to its neighbour
    item = list(data.items())[5]
    made, known = stage.simulate(5, 1), data.truth(item)
    for frame in made.frames:
        assert np.mean(frame.pixels != read(DATA / item.files[frame.role])) < 1e-3
    np.testing.assert_array_equal(made.truth.stripes.product, known.stripes.product)
    np.testing.assert_allclose(made.truth.stripes.x_px, known.stripes.x_px, rtol=0, atol=1e-4)
    (one,), (other,) = made.truth.products, known.products
    assert (one.label, one.defect) == (other.label, other.defect)
    assert one.visible_mm3 == pytest.approx(other.visible_mm3, rel=1e-9)
    assert one.figures == pytest.approx(other.figures, abs=1e-6)


def test_a_calibration_image_can_be_made_again(stage) -> None:
    made = stage.calibration_frames(1)["belt"]["belt"]
    assert np.mean(made.pixels != read(DATA / "calibration" / "belt.png")) < 1e-3


def test_one_dent_lies_under_a_stripe_and_one_between(data: Dataset) -> None:
    truths = [item.products[0] for item in data.items()]
    under, between = truths[2], truths[3]
    assert {under.defect, between.defect} == {"dented"}
    assert under.figures["defect_seen_mm"] > 0.8 * under.figures["defect_depth_mm"]
    assert between.figures["defect_depth_mm"] >= 2.0
    assert between.figures["defect_seen_mm"] < 0.5
    assert {one.label for one in (under, between)} == {"henkei"}


def test_what_is_shown_of_a_healthy_skein_has_no_defect(data: Dataset) -> None:
    figures = list(data.items())[1].products[0].figures
    assert (figures["left_stripe"], figures["right_stripe"]) == (1, 11)
    assert figures["defect_depth_mm"] == 0.0
    assert figures["defect_seen_mm"] == pytest.approx(0.0, abs=1e-9)
    assert figures["hollow_seen_mm"] < 0.1
    assert 0.0 < figures["overhang_left_mm"] < 1.5 * 8.75
    assert 0.0 < figures["overhang_right_mm"] < 1.5 * 8.75


def test_all_eleven_stripes_lie_on_the_calibration_block(stage) -> None:
    from roemetry_simulate.solid import Block, EmptyBelt
    from roemetry_simulate.truth import stripe_centres

    rig, block = stage.rig, Block(*stage.options.targets.block.model_dump().values())
    truth, belt = (stripe_centres(rig.camera, rig.laser, one) for one in (block, EmptyBelt()))
    assert (truth.on_product == 1).sum(axis=1).min() > 180
    assert ((truth.on_product == 0).sum(axis=1) > 180).all()
    np.testing.assert_allclose(truth.xyz_mm[truth.on_product == 1][:, 2], 16.5, atol=1e-6)
    assert np.isfinite(belt.x_px).all()
    spacing_px = np.diff(belt.x_px, axis=0).mean()
    shift_px = np.nanmean(np.where(truth.on_product == 1, truth.x_px - belt.x_px, np.nan))
    assert 1.0 <= shift_px / spacing_px <= 1.15
