"""Fuzzy rules over outline and heights: the shipped recipe calls its own skeins what they are."""

from __future__ import annotations

from pathlib import Path

import pytest

from roemetry.config.recipe import Recipe
from roemetry.run.pipeline import Pipeline

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
