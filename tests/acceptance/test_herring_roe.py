"""The shipped recipe on the shipped skeins, against their truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roemetry.calibrating import calibrate
from roemetry.config.dataset import Dataset
from roemetry.config.recipe import Recipe
from roemetry.config.rig import Rig
from roemetry.records import Trace, Truth
from roemetry.records.calibration import Calibration
from roemetry.run.pipeline import Pipeline


@pytest.fixture(scope="module")
def folder() -> Path:
    return Path(__file__).resolve().parents[2] / "recipes" / "herring_roe"


@pytest.fixture(scope="module")
def traces(folder: Path) -> dict[str, Trace]:
    recipe = Recipe.load(folder)
    source, pipeline = recipe.source.make(), Pipeline(recipe, debug=True)
    return {
        reference.id: pipeline.trace(source.read(reference))
        for reference in source.references(recipe.source_path)
    }


@pytest.fixture(scope="module")
def truth(folder: Path) -> dict[str, Truth]:
    data = Dataset(folder)
    return {item.id: data.truth(item) for item in data.items()}


def wrong_points(trace: Trace, x_px: np.ndarray) -> np.ndarray:
    """(stripe, row) seen points whose nearest true centre within 3 px belongs to another stripe."""
    stripes = trace.stripes
    off = np.abs(x_px[None, :, :] - np.where(stripes.seen, stripes.x_px, np.nan)[:, None, :])
    off = np.where(np.isnan(off), np.inf, off)
    own = np.arange(stripes.stripe_count)[:, None]
    return (off.min(axis=1) <= 3.0) & (off.argmin(axis=1) != own)


def test_no_point_is_labelled_wrong_and_99_of_100_visible_ones_are_labelled(
    traces: dict[str, Trace], truth: dict[str, Truth]
) -> None:
    visible_points, right_points = 0, 0
    for name, trace in traces.items():
        known = truth[name].stripes
        assert wrong_points(trace, known.x_px).sum() == 0, name
        visible = known.on_product
        right = visible & trace.stripes.seen & (np.abs(trace.stripes.x_px - known.x_px) <= 3.0)
        visible_points += visible.sum()
        right_points += right.sum()
    assert right_points / visible_points >= 0.99


def test_every_skein_is_one_product_with_all_results(
    traces: dict[str, Trace], truth: dict[str, Truth]
) -> None:
    assert set(traces) == set(truth)
    for name, trace in traces.items():
        assert len(trace.products) == 1, name
        assert trace.absent == {}, name
        assert trace.products[0].absent == {}, name


def test_the_papers_rule_grades_as_stated(traces: dict[str, Trace], truth: dict[str, Truth]) -> None:
    """It keeps every good skein, and misses what bends in the plane of the belt or lies between stripes."""
    grades = {name: trace.products[0].grade.label for name, trace in traces.items()}
    known = {name: one.products[0] for name, one in truth.items()}
    assert all(grades[name] == "good" for name, one in known.items() if one.label == "good")
    seen_dents = [name for name, one in known.items() if one.figures["hollow_seen_mm"] > 1.5]
    assert seen_dents
    assert all(grades[name] == "henkei" for name in seen_dents)


def test_visible_volume_is_off_by_what_the_method_leaves_out(
    traces: dict[str, Trace], truth: dict[str, Truth]
) -> None:
    """Within 10 % of the visible volume each: ends beyond the outer stripes lose, perspective gains."""
    for name, trace in traces.items():
        value = trace.products[0].volume.visible_mm3.value
        assert value / truth[name].products[0].visible_mm3 == pytest.approx(1.0, abs=0.10), name


def test_an_end_beyond_the_outer_stripes_is_said(traces: dict[str, Trace], truth: dict[str, Truth]) -> None:
    for name, known in truth.items():
        figures = known.products[0].figures
        codes = {reason.code for reason in traces[name].products[0].volume.reasons}
        beyond = figures["left_stripe"] == 1 or figures["right_stripe"] == 11
        assert ("beyond-outer-stripes" in codes) == beyond, name


def test_the_stored_calibration_is_the_one_the_rig_file_makes(folder: Path) -> None:
    made, stored = calibrate(Rig.load(folder / "rig.yaml")), Calibration.load(folder / "calibration.yaml")
    np.testing.assert_allclose(made.rest_px, stored.rest_px, rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        made.parameters["omega_mm_per_px"], stored.parameters["omega_mm_per_px"], rtol=0, atol=1e-9
    )
    assert made.image_sha256 == stored.image_sha256


def test_the_calibration_gives_back_the_rig(folder: Path) -> None:
    """The simulator's rig has 0.2 mm a pixel at the belt; the block is turned by 0.9°."""
    stored = Calibration.load(folder / "calibration.yaml")
    assert stored.parameters["mm_per_px"][0] == pytest.approx(0.2, abs=0.001)
    assert stored.target["yaw_deg"] == pytest.approx(0.9, abs=0.1)
