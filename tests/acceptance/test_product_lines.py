"""Every shipped product line and the recipe by words give the numbers of its page and are near the truth."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from benchmarks.products import Row, rows
from roemetry import Recipe
from roemetry.calibrating import calibrate
from roemetry.config.dataset import Dataset
from roemetry.config.rig import Rig
from roemetry.records.calibration import Calibration
from roemetry.run.pipeline import Pipeline

HOME = Path(__file__).resolve().parents[2] / "recipes"

VISIBLE_OFF = {"potato": 0.02, "fish_fillet": 0.02, "bread_roll": 0.04, "egg": 0.06}
"""Largest relative error of a product's visible volume, of those that are measured."""

MEASURED = {"potato": 6, "fish_fillet": 4, "bread_roll": 5, "egg": 8}
"""Products that must be measured, of 6, 4, 5 and 9."""


@pytest.fixture(scope="module", params=sorted(MEASURED))
def line(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def found(line: str) -> list[Row]:
    recipe = Recipe.load(HOME / line)
    return list(rows(recipe, recipe.source_path))


def table_of(line: str) -> list[list[str]]:
    page = (HOME / line / "README.md").read_text("utf-8")
    told = page.split("## What was found")[1].split("\nOn ")[0]
    start = [row for row in told.splitlines() if row.startswith("| ") and "#" in row.split("|")[1]]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in start]


def test_the_page_tells_what_is_measured(line: str, found: list[Row]) -> None:
    """To a thousandth, which is what another machine's arithmetic may change; classes as they are."""
    told = table_of(line)
    assert [row[0] for row in told] == [row.id for row in found]
    for cells, row in zip(told, found, strict=True):
        if cells[2] == "–":
            assert math.isnan(row.visible_cm3), row.id
        else:
            assert abs(float(cells[2]) / row.visible_cm3 - 1.0) <= 0.001, row.id
            assert abs(float(cells[4].rstrip(" %")) - 100 * row.off("visible_mm3")) <= 0.1, row.id
            assert cells[-1] == row.says, row.id


def test_volumes_are_near_the_truth(line: str, found: list[Row]) -> None:
    off = [off for row in found if not math.isnan(off := row.off("visible_mm3"))]
    assert len(off) >= MEASURED[line]
    assert max(map(abs, off)) <= VISIBLE_OFF[line]


def test_the_stated_calibration_is_the_one_of_the_images(line: str) -> None:
    """Made again from the images that lie there, it gives the same heights to a hundredth of a millimetre."""
    made = calibrate(Rig.load(HOME / line / "rig.yaml"))
    kept = Calibration.load(HOME / line / "calibration.yaml")
    assert made.stripe_count == kept.stripe_count
    for one, other in zip(made.displacement_px_per_mm, kept.displacement_px_per_mm, strict=True):
        assert abs(one - other) < 1e-4


def test_images_and_truth_are_whole(line: str) -> None:
    assert list(Dataset(HOME / line / "data").faults()) == []


RECIPE = Path(__file__).resolve().parents[2] / "recipes" / "herring_roe" / "by_words.yaml"

CALLED = {
    "skein_01": "good",
    "skein_03": "dent",
    "skein_05": "bend",
    "skein_06": "twist",
    "skein_07": "fold",
    "skein_08": "good",
}
"""Of each kind one. The dent of skein 4 lies between stripes; the end of skein 10 is broken off smoothly."""


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    return Pipeline(Recipe.load(RECIPE))


@pytest.mark.parametrize(("skein", "label"), CALLED.items())
def test_words_about_outline_and_heights_name_what_is_there(
    skein: str, label: str, pipeline: Pipeline
) -> None:
    source = pipeline.recipe.source.make()
    (reference,) = (one for one in source.references(pipeline.recipe.source_path) if one.id == skein)
    grade = pipeline.trace(source.read(reference)).products[0].grade
    assert grade.label == label
    assert grade.features[f"truth_{label}"] == max(
        value for name, value in grade.features.items() if name.startswith("truth_")
    )


def test_the_bent_one_is_told_by_its_outline_alone(pipeline: Pipeline) -> None:
    """Without the plain-light image's outline the words about it are missing, and that is said."""
    blind = Recipe.load(RECIPE, sets=["stages.outliner=null", "stages.volume=slice-pchip"])
    source = blind.source.make()
    reference = next(iter(source.references(blind.source_path)))
    grade = Pipeline(blind).trace(source.read(reference)).products[0].grade
    assert grade.label == "unknown"
    assert grade.reasons[0].code == "no-such-feature"
    assert "convexity" in grade.reasons[0].text


@pytest.mark.parametrize(("pattern", "within"), [("circles", 0.006), ("two_colours", 0.004)])
def test_potatoes_under_other_patterns_are_measured_in_their_intervals(pattern: str, within: float) -> None:
    found = Recipe.load(HOME / f"potato_{pattern}", sets=["sinks=[]"]).run()
    for product, true_mm3 in zip(found, (122865.2, 105596.6), strict=True):
        assert product.volume is not None
        volume = product.volume.visible_mm3
        assert abs(volume.value - true_mm3) < within * true_mm3
        assert volume.interval[0] < true_mm3 < volume.interval[1]
