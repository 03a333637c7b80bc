"""Products from points: bodies of known volume, and points that are no section."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import roemetry
from roemetry.errors import ConfigurationError, DataError
from roemetry.records.arrays import Floats


def ellipsoid(x: Floats, y: Floats) -> Floats:
    """Height of half an ellipsoid of 40 × 20 × 15 mm half axes; NaN beside it."""
    with np.errstate(invalid="ignore"):
        return 15.0 * np.sqrt(1.0 - (x / 40.0) ** 2 - (y / 20.0) ** 2)


TRUE_MM3 = 2.0 / 3.0 * math.pi * 40.0 * 20.0 * 15.0


def test_half_an_ellipsoid_from_slices_within_half_a_percent() -> None:
    slices = []
    for x in np.linspace(-37.0, 37.0, 19):
        y = np.arange(-20.0, 20.01, 0.1)
        z = ellipsoid(np.full(y.size, x), y)
        on = np.isfinite(z)
        slices.append(np.column_stack([np.full(on.sum(), x), y[on], z[on]]))
    product = roemetry.product_from_points(slices[::-1])
    volume = roemetry.make_stage("volume", "slice-pchip").estimate(product)
    assert volume.visible_mm3.value == pytest.approx(TRUE_MM3, rel=0.005)


def test_half_an_ellipsoid_from_a_cloud_within_two_percent(rng: np.random.Generator) -> None:
    xy = rng.uniform((-40.0, -20.0), (40.0, 20.0), (60_000, 2))
    z = ellipsoid(*xy.T)
    cloud = np.column_stack([xy, z])[np.isfinite(z)]
    product = roemetry.product_from_points(cloud, slice_mm=2.0)
    volume = roemetry.make_stage("volume", "slice-pchip").estimate(product)
    assert volume.visible_mm3.value == pytest.approx(TRUE_MM3, rel=0.02)


@pytest.mark.parametrize(
    ("points", "slice_mm", "words"),
    [
        (np.zeros((9, 3)), None, "cloud needs slice_mm"),
        ([np.zeros((9, 2))], None, r"shape \(9, 2\)"),
        ([np.array([[0.0, 0.0, np.nan]] * 4)], None, "finite"),
        ([np.zeros((2, 3))], None, "2 points"),
        (
            [np.column_stack([10.0 * np.arange(9.0), np.zeros(9), np.arange(9.0) % 2])],
            None,
            "no section along Y",
        ),
        (np.zeros((9, 3)), -1.0, "more than 0"),
    ],
)
def test_points_that_are_no_section_are_refused(points: object, slice_mm: float | None, words: str) -> None:
    with pytest.raises(DataError) as told:
        roemetry.product_from_points(points, slice_mm=slice_mm)  # type: ignore[arg-type]

    assert re.search(words, f"{told.value} {told.value.hint}")


def test_a_stage_is_made_by_name_and_says_what_it_does_not_know() -> None:
    assert roemetry.make_stage("extractor", "gaussian", threshold=25).options.threshold == 25
    with pytest.raises(ConfigurationError, match="threshhold"):
        roemetry.make_stage("extractor", "gaussian", threshhold=25)
    with pytest.raises(ConfigurationError, match="gaussian"):
        roemetry.make_stage("extractor", "gausian")


def test_a_recipe_takes_stages_as_objects() -> None:
    recipe = roemetry.Recipe.of(
        {
            "roemetry": 1,
            "product": "skeins",
            "source": {"path": "images"},
            "stages": {
                "extractor": roemetry.make_stage("extractor", "gaussian", threshold=25),
                "coder": "window-tracking",
            },
        },
        folder="recipes/herring_roe",
    )
    assert recipe.stages["extractor"].options.model_dump()["threshold"] == 25
