"""Contours of one edge in two images, and the ambient light of a laser image."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from roemetry_volume.ambient_light import ambient_light
from roemetry_volume.contour_fusion import confirmed, weighted_mean
from roemetry_volume.edge_search import Edge, Scene

MIDDLE, RADIUS_PX, SIZE = (190.4, 160.7), 70.0, (320, 400)


def circle(radius_px: float) -> np.ndarray:
    """400 points around the middle, (point, 2) px."""
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    return np.array(MIDDLE) + radius_px * np.column_stack([np.cos(angle), np.sin(angle)])


def radius_of(edge: Edge) -> float:
    return float(np.hypot(*(edge.xy_px - np.array(MIDDLE)).T).mean())


def laser_image(rng: np.random.Generator, *, body: float, belt: float) -> np.ndarray:
    """A disc in ambient light under stripes 30 px apart, noise of one grey level."""
    row, column = np.mgrid[0 : SIZE[0] : 0.25, 0 : SIZE[1] : 0.25] - 0.375
    inside = np.hypot(column - MIDDLE[0], row - MIDDLE[1]) < RADIUS_PX
    light = cv2.resize(np.where(inside, body, belt), SIZE[::-1], interpolation=cv2.INTER_AREA)
    light = cv2.GaussianBlur(light, (0, 0), 0.6)
    for x in np.arange(15.0, SIZE[1], 30.0):
        light += 150.0 * np.exp(-0.5 * ((np.arange(SIZE[1]) - x) / 1.6) ** 2)
    return np.clip(np.rint(light + rng.normal(0.0, 1.0, SIZE)), 0, 255).astype(np.uint8)


def plain_scene() -> Scene:
    """What the plain contour was searched in: only bounds and spacing matter here."""
    row, column = np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(np.float32)
    away_px = np.hypot(column - MIDDLE[0], row - MIDDLE[1])
    bounds = (away_px < RADIUS_PX - 8).astype(np.float32), (away_px > RADIUS_PX + 8).astype(np.float32)
    return Scene(np.zeros(SIZE, np.float32), bounds, None, 0.0, 30.0)


@pytest.mark.parametrize(("std_px", "other_std_px"), [(0.3, 0.3), (0.2, 0.6), (1.0, 0.25)])
def test_contours_that_agree_are_weighted_by_their_variances(std_px: float, other_std_px: float) -> None:
    apart_px = 0.1
    one, other = Edge(circle(70.0), std_px, 0.3), Edge(circle(70.0 + apart_px), other_std_px, 0.5)
    both = weighted_mean(one, other)
    share = std_px**-2 / (std_px**-2 + other_std_px**-2)
    assert radius_of(both) == pytest.approx(70.0 + (1.0 - share) * apart_px, abs=0.002)  # px
    assert both.std_px == pytest.approx((std_px**-2 + other_std_px**-2) ** -0.5, abs=1e-12)
    assert both.scatter_px == one.scatter_px


def test_the_mean_is_the_same_whichever_comes_first() -> None:
    one, other = Edge(circle(70.0), 0.3, 0.3), Edge(circle(71.5), 0.4, 0.3)
    both, turned = weighted_mean(one, other), weighted_mean(other, one)
    assert radius_of(both) == pytest.approx(radius_of(turned), abs=0.002)  # px
    assert both.std_px == pytest.approx(turned.std_px, abs=0.002)


@pytest.mark.parametrize("apart_px", [-4.0, 4.0])
def test_contours_that_disagree_are_as_uncertain_as_they_lie_apart(apart_px: float) -> None:
    """Two values that are R times as far apart as they explain: the Birge ratio."""
    one, other = Edge(circle(70.0), 0.3, 0.3), Edge(circle(70.0 + apart_px), 0.3, 0.3)
    ratio = 4.0 / math.hypot(0.3, 0.3)
    assert weighted_mean(one, other).std_px == pytest.approx(ratio * 0.3 / math.sqrt(2.0), abs=0.01)  # px


@pytest.mark.parametrize("off_px", [-2.0, 2.0])
def test_the_laser_image_draws_a_plain_contour_to_the_edge(rng: np.random.Generator, off_px: float) -> None:
    plain = Edge(circle(RADIUS_PX + off_px), 2.0, 0.3)
    found = confirmed(plain, laser_image(rng, body=40.0, belt=20.0), plain_scene())
    left_px = radius_of(found) - RADIUS_PX
    assert abs(left_px) < 0.5 * abs(off_px)
    assert abs(left_px) < 2.0 * found.std_px
    assert found.std_px < plain.std_px


def test_a_laser_image_that_shows_no_edge_leaves_the_contour(rng: np.random.Generator) -> None:
    plain = Edge(circle(RADIUS_PX + 0.8), 0.6, 0.3)
    assert confirmed(plain, laser_image(rng, body=12.0, belt=12.0), plain_scene()) is plain


@pytest.mark.parametrize("corner", [(0, 0), (37, 52)])
def test_ambient_light_is_what_lies_beside_the_stripes(
    rng: np.random.Generator, corner: tuple[int, int]
) -> None:
    """Even light comes back where no stripe is, and is carried on where one was; in a window, too."""
    pixels = laser_image(rng, body=24.0, belt=24.0)
    light, stripes = ambient_light(pixels[corner[0] :, corner[1] :], 30.0)
    assert 0.05 < stripes.mean() < 0.4
    assert light[~stripes].mean() / 64.0 == pytest.approx(24.0, abs=0.3)  # grey levels
    assert light[stripes].mean() / 64.0 == pytest.approx(24.0, abs=0.6)
    assert np.abs(light / 64.0 - 24.0).max() < 6.0


def test_light_of_sixteen_bits_is_that_of_eight(rng: np.random.Generator) -> None:
    pixels = laser_image(rng, body=40.0, belt=20.0)
    light, stripes = ambient_light(pixels, 30.0)
    fine, same = ambient_light(pixels.astype(np.uint16) * 257, 30.0)
    np.testing.assert_array_equal(stripes, same)
    scale = float(np.median(fine)) / float(np.median(light))
    np.testing.assert_allclose(fine / scale / 64.0, light / 64.0, atol=0.2)  # grey levels


@pytest.mark.parametrize("std_px", [math.inf, 0.6])
def test_a_product_at_the_border_is_confirmed_in_what_is_there(
    rng: np.random.Generator, std_px: float
) -> None:
    """The disc's right and lower parts are cut off; a plain contour of unknown uncertainty stays as it is."""
    rows, columns = round(MIDDLE[1]) + 75, round(MIDDLE[0]) + 75
    scene = plain_scene()
    assert scene.bounds is not None
    bounds = scene.bounds[0][:rows, :columns], scene.bounds[1][:rows, :columns]
    cut = Scene(scene.level[:rows, :columns], bounds, None, 0.0, 30.0)
    plain = Edge(circle(RADIUS_PX + 0.8), std_px, 0.3)
    found = confirmed(plain, laser_image(rng, body=40.0, belt=20.0)[:rows, :columns], cut)
    if std_px == math.inf:
        assert found is plain
    else:
        assert np.isfinite(found.xy_px).all()
        assert found.std_px < std_px
