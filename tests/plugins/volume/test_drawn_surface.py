"""The surface an estimator gives for drawings holds the volume it states, ends included."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry import Pipeline, Recipe, make_stage
from roemetry.records import Surface
from roemetry.stages import Classifier
from roemetry.testing.solids import BOX, HALF_CYLINDER, HALF_ELLIPSOID, Solid, product_of

RECIPES = Path(__file__).resolve().parents[3] / "recipes"


def volume_mm3(surface: Surface) -> float:
    """Integrate the height over the belt, two triangles to a cell."""
    xyz, total = surface.xyz_mm, 0.0
    for a, b, c in (
        (xyz[:-1, :-1], xyz[1:, :-1], xyz[1:, 1:]),
        (xyz[:-1, :-1], xyz[1:, 1:], xyz[:-1, 1:]),
    ):
        u, v = b - a, c - a
        area = 0.5 * (u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
        total += float(np.nansum(area * (a[..., 2] + b[..., 2] + c[..., 2]) / 3.0))
    return abs(total)


@pytest.mark.parametrize("solid", [BOX, HALF_CYLINDER, HALF_ELLIPSOID])
def test_slices_with_their_caps_hold_the_volume(solid: Solid) -> None:
    product = product_of(solid)
    estimator = make_stage("volume", "slice-pchip")
    surface = estimator.surface(product)
    assert volume_mm3(surface) == pytest.approx(estimator.estimate(product).visible_mm3.value, rel=0.03)
    assert surface.assumed.any() and not surface.assumed.all()


def test_the_plate_over_the_outline_holds_the_volume() -> None:
    recipe = Recipe.load(RECIPES / "herring_roe" / "with_outline.yaml", sets=["uncertainty=none"])
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    (reference, *_) = source.references(recipe.source_path)
    (found,) = pipeline.trace(source.read(reference), surfaces=True).products
    assert found.volume is not None and found.surface is not None
    assert volume_mm3(found.surface) == pytest.approx(found.volume.visible_mm3.value, rel=0.005)
    assert np.nanmin(found.surface.xyz_mm[..., 2]) >= 0.0
    (unasked,) = pipeline.trace(source.read(reference)).products
    assert unasked.surface is None, "only where it is asked for"
    assert found.grade is not None and unasked.grade is not None
    assert found.grade.relief is not None and unasked.grade.relief is None, "nor is the relief"
    assert found.grade.features == unasked.grade.features


def test_a_relief_that_a_classifier_gives_with_its_grade_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = Recipe.load(RECIPES / "herring_roe" / "with_outline.yaml", sets=["uncertainty=none"])
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    kind = type(recipe.stages["classifier"].make())
    classify, relief = kind.classify, kind.relief
    monkeypatch.setattr(kind, "relief", Classifier.relief)
    monkeypatch.setattr(
        kind,
        "classify",
        lambda self, product, *, rng=None: replace(classify(self, product), relief=relief(self, product)),
    )
    (reference, *_) = source.references(recipe.source_path)
    (found,) = pipeline.trace(source.read(reference), surfaces=True).products
    assert found.grade is not None and found.grade.relief is not None
