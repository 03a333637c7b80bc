"""Light of circles around an outline: drawn on the belt of a real calibration, and the shipped scene."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry import Recipe
from roemetry.records.cones import half_on_belt
from roemetry.records.view import View
from roemetry_volume.circle_light import CircleLight, circle_light

CIRCLES = Path("recipes/potato_circles")
MIDDLE, AXES = np.array([330.0, 235.0]), np.array([110.0, 80.0])
TURN = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
EDGE = MIDDLE + AXES * np.column_stack([np.cos(TURN), np.sin(TURN)])
NOWHERE, ASIDE = np.zeros(2), np.array([4.0, 0.0])


@pytest.fixture(scope="module")
def view() -> View:
    """Camera and cones of the shipped calibration."""
    calibration = Recipe.load(CIRCLES).calibration
    assert calibration is not None and calibration.view is not None
    return calibration.view


def drawn(view: View, rng: np.random.Generator, *, noise: float, specks: float = 0.0) -> np.ndarray:
    """Draw the belt's circles around an ellipse, and on it the same ones, moved by 11 px along the rows."""
    scale = 4
    belt, body = (np.zeros(tuple(scale * n for n in view.image_size), np.float32) for _ in range(2))
    for cone in view.cones:
        place = view.project(half_on_belt(cone, view.T_belt_camera[:3, 0]))
        for image, right in ((belt, 0.0), (body, 11.0)):
            at = np.rint(scale * (place + np.array([right + 0.375, 0.375]))).astype(np.int32)
            cv2.polylines(image, [at], False, 100.0, 3 * scale)
    inside = np.zeros(belt.shape, np.uint8)
    cv2.fillPoly(inside, [np.rint(scale * (EDGE + 0.375)).astype(np.int32)], 1)
    image = cv2.resize(np.where(inside > 0, body, belt), view.image_size[::-1], interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.7) + 5.0 + rng.normal(0.0, noise, image.shape)
    image[rng.random(image.shape) < specks] = 255.0
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def scaled(scale: float) -> np.ndarray:
    """Give the ellipse larger or smaller."""
    return np.asarray(MIDDLE + scale * (EDGE - MIDDLE))


@pytest.mark.parametrize(("noise", "specks"), [(0.5, 0.0), (4.0, 0.0), (0.5, 0.01)])
def test_light_of_belt_and_product_lies_on_both_sides_of_an_edge(
    view: View, rng: np.random.Generator, noise: float, specks: float
) -> None:
    light = circle_light(drawn(view, rng, noise=noise, specks=specks), view).near(EDGE, 24.0)
    for scale in (0.97, 0.985, 1.0, 1.015, 1.03):
        off = light.off_px(scaled(scale), NOWHERE)
        assert off is not None
        larger_px = (scale - 1.0) * AXES.mean()
        told_px = 0.5 * np.sign(larger_px) * (off[1] - off[0])
        # light crosses the edge in some places alone, and the ellipse grows by more where it is long
        assert 0.5 * abs(larger_px) - 0.3 < told_px < 1.3 * abs(larger_px) + 0.3
        assert max(off) < abs(larger_px) + 0.5
        # the true edge has no sign to tell by: light blurred over it moves both sides by some 0.4 px
        assert 0.5 * abs(off[1] - off[0]) < 1.3 * abs(larger_px) + 0.5
    moved = light.off_px(EDGE + ASIDE, NOWHERE)
    back = light.off_px(EDGE + ASIDE, -ASIDE)
    assert moved is not None and back is not None
    assert max(moved) > 2.0 and max(back) < 0.5


def test_light_that_crosses_a_circle_of_the_belt_is_not_the_belts() -> None:
    """Six pixels on a circle of the belt, all inside of the edge: no light comes in from outside."""
    across = MIDDLE + np.array([AXES[0] - 4.0, 0.0]) + np.column_stack([np.zeros(6), np.arange(6.0) - 3.0])
    around = scaled(1.1)[::4]
    product = scaled(0.95)
    nothing = np.zeros((480, 640), np.bool_)
    number = np.repeat([1, 2], [6, len(around)]).astype(np.int32)
    light = CircleLight(np.vstack([across, around]), number, product, nothing, nothing)
    off = light.off_px(EDGE, NOWHERE)
    assert off is not None and off[1] < 0.0
    few = CircleLight(around[:3], np.ones(3, np.int32), product, nothing, nothing)
    assert few.off_px(EDGE, NOWHERE) is None


def test_light_that_leaves_a_circle_of_the_belt_within_the_edge_is_on_a_thin_rim() -> None:
    """Two ridges along a row into the ellipse: one leaves the belt's circle 15 px inside, the other ends."""
    ridge, leaves = np.zeros((2, 480, 640), np.bool_)
    ridge[210, 395:480] = ridge[260, 410:480] = leaves[210, 395:415] = True
    row, column = np.nonzero(ridge & ~leaves)
    belt, number = np.column_stack([column, row]).astype(float), (row == 260) + 1
    light = CircleLight(belt, number.astype(np.int32), scaled(0.98), ridge, leaves).near(EDGE, 50.0)
    assert set(light.belt[:, 1]) == {210.0, 260.0}
    inside = ((light.belt - MIDDLE) ** 2 / AXES**2).sum(axis=1) < 0.98
    assert set(light.belt[inside, 1]) == {260.0}


def test_an_image_without_light_has_none(view: View) -> None:
    light = circle_light(np.full(view.image_size, 7, np.uint8), view)
    assert len(light.belt) == len(light.product) == 0


TRUE_MM3 = {"potato_01": 122_865.2, "potato_02": 105_596.6}
"""Visible volumes, from the scene (`simulated.yaml`, seed 1)."""


@pytest.mark.parametrize("name", TRUE_MM3)
@pytest.mark.parametrize("scale", [0.96, 0.985, 0.993, 0.997, 1.007, 1.015, 1.04])
def test_a_plain_image_of_another_scale_is_refused_or_in_the_interval(name: str, scale: float) -> None:
    recipe = Recipe.load(CIRCLES)
    laser, plain = (
        cv2.imread(str(CIRCLES / folder / f"{name}.png"), -1) for folder in ("images", "images_plain")
    )
    assert laser is not None and plain is not None
    rows, columns = plain.shape
    turned = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), 0.0, scale)
    other = cv2.warpAffine(
        plain, turned, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )
    (found,) = recipe.measure(laser, plain=other)
    if found.volume is None:
        assert abs(scale - 1.0) > 0.01
    else:
        low, high = found.volume.visible_mm3.interval
        assert low < TRUE_MM3[name] < high
