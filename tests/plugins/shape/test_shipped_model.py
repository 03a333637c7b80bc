"""The model that comes with the recipe: small, says where it is from, right on the recipe's images."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.traced import traced
from roemetry import Pipeline, Recipe
from roemetry_shape.learned import Learned, LearnedOptions

FOLDER = Path(__file__).parents[3] / "recipes" / "herring_roe"
SETS = (
    "stages.extractor.use=centre-of-gravity",
    "stages.extractor.options={}",
    "stages.classifier.use=learned",
    "stages.classifier.options={model: classifier.json}",
)


def test_the_model_is_small_and_says_what_it_was_fitted_on() -> None:
    path = FOLDER / "classifier.json"
    assert path.stat().st_size < 2**16
    assert "no real skein" in json.loads(path.read_text("utf-8"))["about"]["fitted_on"]


@pytest.mark.parametrize(
    ("skein", "label"),
    [
        ("skein_01", "good"),
        ("skein_03", "dent"),
        ("skein_06", "twist"),
        ("skein_08", "good"),
        ("skein_09", "bend"),
    ],
)
def test_the_model_names_what_stripes_show(skein: str, label: str) -> None:
    """Images that nothing was fitted to, calibrated by the recipe's block."""
    recipe = Recipe.load(FOLDER, sets=SETS)
    source = recipe.source.make()
    (reference,) = (one for one in source.references(recipe.source_path) if one.id == skein)
    grade = Pipeline(recipe).trace(source.read(reference)).products[0].grade
    assert grade.label == label
    assert grade.probability > 0.5


THOROUGH = [pytest.param(family, marks=pytest.mark.thorough) for family in ("fillet", "wedge")]


@pytest.mark.parametrize("family", ["staircase", "truncated-pyramid", *THOROUGH])
def test_what_is_no_skein_is_unknown(family: str) -> None:
    """Measured without an image, on a rig about the recipe's; and the feature that tells is named."""
    learned = Learned(LearnedOptions(model=FOLDER / "classifier.json"))
    product = traced(7, family=family).exact
    assert product is not None
    grade = learned.classify(product)
    assert grade.label == "unknown"
    assert [reason.code for reason in grade.reasons] == ["unlike-anything-learned"]
    assert grade.features["novelty"] > 1.0
    assert grade.reasons[0].text.split(" is ")[0] in grade.features
