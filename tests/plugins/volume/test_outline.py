"""Outlines on drawn images whose contour is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from roemetry.errors import StageError
from roemetry.records import Dots, Frame, Reason, StripeMap
from roemetry_volume import edge_contour, edge_search
from roemetry_volume.edge_contour import EdgeContour, EdgeContourOptions
from roemetry_volume.edge_search import closed_path
from roemetry_volume.image_motion import Overlay
from roemetry_volume.outline_features import features_of

ROWS, COLUMNS = 240, 360
ELLIPSE = (180.3, 118.6, 120.0, 45.0)


def distance(xy: np.ndarray, ellipse=ELLIPSE) -> np.ndarray:
    """Roughly the distance outside an ellipse, px (first order)."""
    x, y, a, b = ellipse
    u, v = (xy[..., 0] - x) / a, (xy[..., 1] - y) / b
    f = u * u + v * v - 1.0
    return f / (2.0 * np.sqrt((u / a) ** 2 + (v / b) ** 2) + 1e-9)


def plain_image(rng: np.random.Generator, ellipses=(ELLIPSE,), *, bright: float = 110.0, shadow: bool = True):
    """A round body that darkens towards its rim and throws a soft shadow, on an uneven belt."""
    row, column = np.mgrid[0:ROWS:0.25, 0:COLUMNS:0.25] - 0.375
    image = 70.0 + 0.03 * column + 0.02 * row
    for ellipse in ellipses:
        off = distance(np.stack([column, row], axis=-1), ellipse)
        depth = np.clip(-off, 0.0, None)
        body = (0.45 + 0.55 * np.sqrt(np.clip(1.0 - (1.0 - depth / 45.0) ** 2, 0.0, 1.0))) * bright
        if shadow:
            image *= np.where(off > 0.0, 1.0 - 0.35 * np.exp(-np.clip(off, 0.0, None) / 12.0), 1.0)
        image = np.where(off <= 0.0, body, image)
    image = cv2.resize(image, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.5) + rng.normal(0.0, 1.2, (ROWS, COLUMNS))
    return Frame(np.clip(np.rint(image), 0, 255).astype(np.uint8), role="plain")


def stripes_on(ellipses=(ELLIPSE,), spacing: float = 30.0) -> StripeMap:
    """Upright stripes that show where the ellipses are, to a part of a pixel."""
    x_px = np.arange(15.0, COLUMNS - 10.0, spacing)
    grid = np.broadcast_to(x_px[:, None], (x_px.size, ROWS)).copy()
    at = np.stack([grid, np.broadcast_to(np.arange(float(ROWS)), grid.shape)], axis=-1)
    product = np.zeros(grid.shape, np.int16)
    seen = np.ones(grid.shape, np.bool_)
    for number, ellipse in enumerate(ellipses, start=1):
        off = distance(at, ellipse)
        product[off < -0.3] = number
        seen &= np.abs(off) > 0.3
    return StripeMap(
        x_px=grid,
        x_std_px=np.full(grid.shape, 0.1),
        product=product,
        seen=seen,
        margin=np.ones(grid.shape),
        ambiguous=np.zeros(grid.shape, np.bool_),
        rest_px=grid,
        peak_stripe=np.zeros(0, np.int16),
    )


LASER = Frame(np.full((ROWS, COLUMNS), 12, np.uint8))


@pytest.mark.parametrize("shadow", [True, False])
def test_a_shaded_body_is_found_to_a_part_of_a_pixel(rng: np.random.Generator, shadow: bool) -> None:
    (found,) = EdgeContour().outline(LASER, plain_image(rng, shadow=shadow), stripes_on(), None)
    off = distance(found.xy_px)
    assert abs(off.mean()) < 0.5  # px; the limb of this drawing falls as steeply as any can
    assert np.abs(off).max() < 1.5
    assert off.std() < 0.5
    assert found.features["area_px2"] == pytest.approx(np.pi * 120.0 * 45.0, rel=0.015)


@pytest.mark.parametrize("blur_px", [0.9, 1.1])
def test_an_image_out_of_focus_tells_its_blur_and_the_outline_stays(
    rng: np.random.Generator, blur_px: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A level body beside a shadow; with the blur of a sharp lens its edge is found much farther outside."""
    row, column = np.mgrid[0:ROWS:0.25, 0:COLUMNS:0.25] - 0.375
    off = distance(np.stack([column, row], axis=-1))
    belt = 70.0 * (1.0 - 0.35 * np.exp(-np.clip(off, 0.0, None) / 12.0))
    sharp = cv2.resize(np.where(off <= 0.0, 110.0, belt), (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(sharp, (0, 0), blur_px) + rng.normal(0.0, 0.5, sharp.shape)
    image = Frame(np.clip(np.rint(blurred), 0, 255).astype(np.uint8), role="plain")
    (found,) = EdgeContour().outline(LASER, image, stripes_on(), None)
    monkeypatch.setattr(edge_search, "_BLURS", ())
    (as_sharp,) = EdgeContour().outline(LASER, image, stripes_on(), None)
    off_px, as_sharp_px = (float(distance(one.xy_px).mean()) for one in (found, as_sharp))
    assert abs(off_px) < 3.0 * found.xy_std_px, (off_px, found.xy_std_px)
    assert abs(off_px) < 0.6 * abs(as_sharp_px), (off_px, as_sharp_px)


@pytest.mark.parametrize("blur_px", [2.5, 2.9])
def test_a_round_body_far_out_of_focus_keeps_its_outline(rng: np.random.Generator, blur_px: float) -> None:
    """A blur of 1 px explains its rim hardly better than that of a sharp lens; larger ones do."""
    plain = plain_image(rng, shadow=False).pixels.astype(np.float64)
    blurred = cv2.GaussianBlur(plain, (0, 0), blur_px) + rng.normal(0.0, 0.5, plain.shape)
    image = Frame(np.clip(np.rint(blurred), 0, 255).astype(np.uint8), role="plain")
    (found,) = EdgeContour().outline(LASER, image, stripes_on(), None)
    assert abs(float(distance(found.xy_px).mean())) < 0.6


def test_its_uncertainty_comes_from_the_image(rng: np.random.Generator) -> None:
    """Dark, beside a shadow, or in four times the noise without one: a figure each, which holds the truth."""
    noisy = plain_image(rng, shadow=False)
    noise = rng.normal(0.0, 5.0, noisy.pixels.shape)
    noisy = replace(noisy, pixels=np.clip(np.rint(noisy.pixels + noise), 0, 255).astype(np.uint8))
    stds = []
    for image in (plain_image(rng, bright=25.0, shadow=False), plain_image(rng), noisy):
        (found,) = EdgeContour().outline(LASER, image, stripes_on(), None)
        stds.append(found.xy_std_px)
        assert abs(distance(found.xy_px).mean()) < min(3.0 * found.xy_std_px, 0.6)  # px
    assert len({round(std, 3) for std in stds}) == 3
    assert all(0.1 < std < 0.8 for std in stds)


@pytest.mark.parametrize("noise", [2.5, 5.0, 8.0])
def test_its_uncertainty_holds_beside_a_shadow_in_noise(rng: np.random.Generator, noise: float) -> None:
    """Two to seven times the noise, and a shadow as dark as the rim: there is no step, only a kink."""
    image = plain_image(rng, shadow=True)
    pixels = image.pixels + rng.normal(0.0, noise, image.pixels.shape)
    noisy = replace(image, pixels=np.clip(np.rint(pixels), 0, 255).astype(np.uint8))
    (found,) = EdgeContour().outline(LASER, noisy, stripes_on(), None)
    assert abs(distance(found.xy_px).mean()) < 3.0 * found.xy_std_px < 3.0  # px
    raw, told = features_of(found.xy_px, noisy.pixels)["convexity"], found.features
    assert abs(told["convexity"] - 1.0) < min(2.0 * told["convexity_std"], 1.0 - raw)


def test_what_a_coder_bridged_through_the_shadow_is_no_body(rng: np.random.Generator) -> None:
    """Stripes that go on unseen, 70 px beside the body, as they do in the laser's shadow."""
    stripes = stripes_on()
    product, seen = stripes.product.copy(), stripes.seen.copy()
    beside = (stripes.x_px > 230.0) & (stripes.x_px < 345.0) & (product == 0)
    beside[:, :90] = beside[:, 150:] = False
    product[beside], seen[beside] = 1, False
    bridged = replace(stripes, product=product, seen=seen)
    (found,) = EdgeContour().outline(LASER, plain_image(rng), bridged, None)
    assert np.abs(distance(found.xy_px)).max() < 1.5  # px


def test_two_products_have_an_outline_each(rng: np.random.Generator) -> None:
    two = ((95.0, 120.0, 60.0, 40.0), (260.0, 115.0, 70.0, 45.0))
    found = EdgeContour().outline(LASER, plain_image(rng, two), stripes_on(two), None)
    assert [outline.product for outline in found] == [1, 2]
    for outline, ellipse in zip(found, two, strict=True):
        assert abs(distance(outline.xy_px, ellipse).mean()) < 0.6  # px


def dots_on(spacing: float = 16.0) -> StripeMap:
    """Dots of a matrix that leans; those that the rim cuts are none, to 2.5 px."""
    across, down = np.meshgrid(np.arange(-14.0, 15.0), np.arange(-10.0, 11.0), indexing="ij")
    x = 0.5 * COLUMNS + spacing * (across * np.cos(0.2) - down * np.sin(0.2))
    y = 0.5 * ROWS + spacing * (across * np.sin(0.2) + down * np.cos(0.2))
    inside = (x > 3.0) & (x < COLUMNS - 4.0) & (y > 3.0) & (y < ROWS - 4.0)
    off = distance(np.stack([x, y], axis=-1))
    column, line = np.nonzero(inside & (np.abs(off) > 2.5))
    x, y, off = x[column, line], y[column, line], off[column, line]
    row, shape = np.rint(y).astype(np.int64), (29, ROWS)

    def dense(value: np.ndarray, nothing: float) -> np.ndarray:
        made = np.full(shape, nothing)
        made[column, row] = value
        return made

    x_px = dense(x, np.nan)
    seen = np.isfinite(x_px)
    covariance = np.where(seen[:, :, None, None], 0.01 * np.eye(2), np.nan)
    rest = np.broadcast_to(spacing * np.arange(29.0)[:, None], shape).copy()
    return replace(
        stripes_on(),
        x_px=x_px,
        x_std_px=np.where(seen, 0.1, np.nan),
        product=np.where(seen, dense((off < 0.0).astype(float), -1.0), -1.0).astype(np.int16),
        seen=seen,
        margin=np.where(seen, 1.0, np.nan),
        ambiguous=np.zeros(shape, np.bool_),
        rest_px=rest,
        dots=Dots(dense(y, np.nan), covariance, dense(line, -1.0).astype(np.int16)),
    )


def grid_on(spacing: float = 30.0) -> StripeMap:
    """Stripes, and lines across that show the same ellipse in the image turned by 90°."""
    y_px = np.arange(10.0, ROWS - 5.0, spacing)
    grid = np.broadcast_to(y_px[:, None], (y_px.size, COLUMNS)).copy()
    at = np.stack([np.broadcast_to(COLUMNS - 1.0 - np.arange(COLUMNS), grid.shape), grid], axis=-1)
    off = distance(at)
    across = StripeMap(
        x_px=grid,
        x_std_px=np.full(grid.shape, 0.1),
        product=(off < -0.3).astype(np.int16),
        seen=np.abs(off) > 0.3,
        margin=np.ones(grid.shape),
        ambiguous=np.zeros(grid.shape, np.bool_),
        rest_px=grid,
        peak_stripe=np.zeros(0, np.int16),
    )
    return replace(stripes_on(), across=across)


def circles_on(spacing: float = 22.0) -> StripeMap:
    """Left and right halves of circles that show where the ellipse is."""
    radius = np.concatenate([-spacing * np.arange(9.0, 0.0, -1.0), spacing * np.arange(1.0, 10.0)])[:, None]
    row = np.arange(float(ROWS))
    inside = radius**2 - (row - 0.45 * ROWS) ** 2
    seen = inside > (0.2 * radius) ** 2  # at top and bottom lines run along the rows
    x_px = 170.0 + np.sign(radius) * np.sqrt(np.where(seen, inside, np.nan))
    off = distance(np.stack([x_px, np.broadcast_to(row, x_px.shape)], axis=-1))
    with np.errstate(invalid="ignore"):
        seen &= (np.abs(off) > 0.3) & (x_px > 5.0) & (x_px < COLUMNS - 6.0)
    x_px = np.where(seen, x_px, np.nan)
    return StripeMap(
        x_px=x_px,
        x_std_px=np.where(seen, 0.1, np.nan),
        product=np.where(seen, off < 0.0, -1).astype(np.int16),
        seen=seen,
        margin=np.where(seen, 1.0, np.nan),
        ambiguous=np.zeros(seen.shape, np.bool_),
        rest_px=x_px,
        peak_stripe=np.zeros(0, np.int16),
        circles=True,
    )


@pytest.mark.parametrize("light", [dots_on, grid_on, circles_on])
def test_dots_grids_and_circles_agree_with_an_outline_of_theirs_and_refuse_another_products(
    rng: np.random.Generator, light: Callable[[], StripeMap]
) -> None:
    (found,) = EdgeContour().outline(LASER, plain_image(rng), light(), None)
    assert np.abs(distance(found.xy_px)).max() < 1.5  # px
    assert found.fault is None
    assert found.xy_std_px < 1.0
    x, y, a, b = ELLIPSE
    for other in ((x, y, a - 18.0, b - 12.0), (x + 10.0, y - 12.0, a + 10.0, b - 14.0)):
        (refused,) = EdgeContour().outline(LASER, plain_image(rng, (other,)), light(), None)
        assert refused.fault is not None
        assert refused.fault.code == "images-contradict"


@pytest.mark.parametrize("scale", [0.96, 1.04])
def test_dots_widen_the_uncertainty_of_an_outline_of_another_scale(
    rng: np.random.Generator, scale: float
) -> None:
    """Its edge lies 2 to 5 px beside; the nearest dots 2.5 px and more, so none contradicts it yet."""
    x, y, a, b = ELLIPSE
    (one,) = EdgeContour().outline(LASER, plain_image(rng, ((x, y, scale * a, scale * b),)), dots_on(), None)
    off_px = abs(float(distance(one.xy_px).mean()))
    assert one.fault is not None or off_px < 2.0 * one.xy_std_px


def test_stripes_widen_the_uncertainty_of_an_outline_too_small_by_little(rng: np.random.Generator) -> None:
    """No texture tells how the images lie; the edge is 0.5 to 1 px too far inside, and few ends stick out."""
    x, y, a, b = ELLIPSE
    for scale in (1.0, 0.988):
        other = plain_image(rng, ((x, y, scale * a, scale * b),))
        (one,) = EdgeContour().outline(LASER, other, stripes_on(), None)
        off_px = abs(float(distance(one.xy_px).mean()))
        assert one.fault is None
        assert off_px < 2.0 * one.xy_std_px
        assert one.xy_std_px < 0.3 + off_px


def test_images_of_two_scenes_refuse_every_product_also_one_without_an_edge(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    two = ((95.0, 120.0, 60.0, 40.0), (260.0, 115.0, 70.0, 45.0))
    said = Reason("images-contradict", "the laser image does not show this belt")
    refused = Overlay(Frame(np.zeros((ROWS, COLUMNS), np.uint8)), math.inf, fault=said)
    monkeypatch.setattr(edge_contour, "laid_over", lambda *_, **__: refused)
    found = EdgeContour().outline(LASER, plain_image(rng, two[:1]), stripes_on(two), None)
    assert [(one.product, one.fault) for one in found] == [(1, said), (2, said)]


@pytest.mark.parametrize(("scale", "shadow"), [(0.93, True), (1.07, True), (0.93, False), (1.07, False)])
def test_an_outline_of_another_scale_refuses_its_product(
    rng: np.random.Generator, scale: float, shadow: bool
) -> None:
    """3 px smaller or larger across: stripes stick out of the edge, or go on along the belt inside of it."""
    x, y, a, b = ELLIPSE
    other = plain_image(rng, ((x, y, scale * a, scale * b),), shadow=shadow)
    (found,) = EdgeContour().outline(LASER, other, stripes_on(), None)
    assert found.fault.code == "images-contradict"


@pytest.mark.parametrize("seen", [(100.0, 118.6, 40.0, 30.0), (180.3, 118.6, 118.0, 45.0)])
def test_a_body_that_goes_on_far_beyond_its_stripes_refuses_its_product(
    rng: np.random.Generator, seen: tuple[float, float, float, float]
) -> None:
    """The laser image is of a smaller product in the same place; a rim that no stripe shows is none."""
    (found,) = EdgeContour().outline(LASER, plain_image(rng), stripes_on((seen,)), None)
    if seen[2] < 50.0:
        assert found.fault.code == "images-contradict" and "more of the product" in found.fault.text
    else:
        assert found.fault is None


def test_stripes_on_the_belt_within_the_body_refuse_it(rng: np.random.Generator) -> None:
    """A block of another frame over one corner of the product, whose other stripes reach around it."""
    sound = stripes_on()
    covered = (sound.x_px > 210.0) & (np.arange(ROWS) > 120)
    stripes = replace(sound, product=np.where(covered, 0, sound.product), seen=sound.seen | covered)
    (found,) = EdgeContour().outline(LASER, plain_image(rng), stripes, None)
    assert found.fault.code == "images-contradict" and "stripes lie on the belt" in found.fault.text


@pytest.mark.parametrize("beyond_px", [0.0, 60.0])
def test_stripes_of_a_product_far_beyond_the_body_refuse_it(
    rng: np.random.Generator, beyond_px: float
) -> None:
    """A block of another frame: three stripes show product where the plain image shows belt."""
    x, y, a, b = ELLIPSE
    (found,) = EdgeContour().outline(
        LASER, plain_image(rng, ((x - 0.5 * beyond_px, y, a - 0.5 * beyond_px, b),)), stripes_on(), None
    )
    if beyond_px:
        assert found.fault.code == "images-contradict" and "less of the product" in found.fault.text
    else:
        assert found.fault is None


def test_an_outline_that_is_shifted_is_left_out(rng: np.random.Generator) -> None:
    """The belt moved by 5 px between the images: the stripes alone are right."""
    x, y, a, b = ELLIPSE
    moved = plain_image(rng, ((x + 4.0, y - 3.0, a, b),))
    assert EdgeContour().outline(LASER, moved, stripes_on(), None) == ()


def test_without_stripes_the_cores_are_found(rng: np.random.Generator) -> None:
    none = replace(stripes_on(), product=np.zeros_like(stripes_on().product))
    (found,) = EdgeContour().outline(LASER, plain_image(rng), none, None)
    assert abs(distance(found.xy_px).mean()) < 0.6  # px


def test_what_does_not_stand_out_has_no_outline(rng: np.random.Generator) -> None:
    level = Frame(np.clip(rng.normal(70.0, 2.0, (ROWS, COLUMNS)), 0, 255).astype(np.uint8), role="plain")
    assert EdgeContour().outline(LASER, level, stripes_on(), None) == ()


def test_an_image_of_the_empty_belt_helps(rng: np.random.Generator, tmp_path) -> None:
    """A dark patch of belt that touches the product is taken for belt."""
    patch = np.ones((ROWS, COLUMNS))
    patch[40:110, 200:360] = 0.5
    belt = np.full((ROWS, COLUMNS), 72.0) * patch
    cv2.imwrite(str(tmp_path / "belt.png"), belt.astype(np.uint8))
    plain = plain_image(rng)
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    outside = distance(np.stack([column, row], axis=-1).astype(float)) > 0.0
    pixels = np.where(outside, plain.pixels * patch, plain.pixels).astype(np.uint8)
    options = EdgeContourOptions(belt=tmp_path / "belt.png")
    (found,) = EdgeContour(options).outline(LASER, replace(plain, pixels=pixels), stripes_on(), None)
    assert abs(distance(found.xy_px).mean()) < 0.8  # px


def test_colours_are_used(rng: np.random.Generator) -> None:
    """A product as bright as the belt in red and blue, and brighter in green."""
    green = plain_image(rng)
    level = np.clip(rng.normal(70.0, 1.2, (ROWS, COLUMNS)), 0, 255).astype(np.uint8)
    colour = replace(green, pixels=np.stack([level, green.pixels, level], axis=-1))
    (found,) = EdgeContour().outline(LASER, colour, stripes_on(), None)
    assert abs(distance(found.xy_px).mean()) < 0.6  # px
    assert found.features["green_mean"] > found.features["red_mean"]


def test_the_laser_image_has_an_outline_in_its_ambient_light(rng: np.random.Generator) -> None:
    row, column = np.mgrid[0:ROWS, 0:COLUMNS].astype(float)
    inside = distance(np.stack([column, row], axis=-1)) < 0.0
    light = np.where(inside, 22.0, 12.0)
    for x in np.arange(15.0, COLUMNS - 10.0, 30.0):
        light += 150.0 * np.exp(-0.5 * ((column - x) / 1.6) ** 2)
    frame = Frame(np.clip(np.rint(light + rng.normal(0.0, 1.0, light.shape)), 0, 255).astype(np.uint8))
    (found,) = EdgeContour().outline(frame, None, stripes_on(), None)
    assert abs(distance(found.xy_px).mean()) < 0.6  # px
    assert abs(distance(found.xy_px).mean()) < 3.0 * found.xy_std_px < 3.0  # px
    with pytest.raises(StageError, match="there is no plain-light image"):
        EdgeContour(EdgeContourOptions(light="plain")).outline(frame, None, stripes_on(), None)


@pytest.mark.parametrize(
    ("body", "joins", "kept"), [(22.0, True, True), (22.0, False, False), (12.0, True, False)]
)
def test_open_light_on_a_rest_line_is_belt_where_it_joins_belt_and_is_as_bright(
    body: float, joins: bool, kept: bool
) -> None:
    """Rows 60 to 99 of the last stripe are ambiguous; a level surface there would be of the body's light."""
    stripes = stripes_on()
    last = stripes.x_px.shape[0] - 1
    column = round(float(stripes.rest_px[last, 0]))
    level, on_stripes = np.full((ROWS, COLUMNS), 12.0, np.float32), np.zeros((ROWS, COLUMNS), np.bool_)
    region = np.zeros((ROWS, COLUMNS), np.bool_)
    region[100:140, 150:200] = True
    level[region], on_stripes[:, column - 3 : column + 4] = 22.0, True
    level[60:100, column - 20 :] = 34.0 - body  # as bright as the belt where the body is brighter
    seen, x_px, ambiguous = stripes.seen.copy(), stripes.x_px.copy(), stripes.ambiguous.copy()
    product = stripes.product.copy()
    open_ = np.s_[last, 60:100]
    seen[open_], x_px[open_], product[open_], ambiguous[open_] = False, math.nan, -1, True
    if not joins:  # the coder saw nothing in the rows before
        beside = np.s_[last, :60]
        seen[beside], x_px[beside], product[beside] = False, math.nan, -1
    x_std_px = np.where(np.isnan(x_px), math.nan, stripes.x_std_px)
    margin = np.where(np.isnan(x_px), math.nan, stripes.margin)
    given = replace(
        stripes, seen=seen, x_px=x_px, product=product, ambiguous=ambiguous, x_std_px=x_std_px, margin=margin
    )
    found = edge_contour._with_belt_by_light(given, level, region, on_stripes)
    assert found.seen[open_].all() == kept
    assert found.seen[open_].any() == kept
    np.testing.assert_array_equal(np.delete(found.seen, last, axis=0), np.delete(given.seen, last, axis=0))


def test_under_a_single_stripe_no_open_light_is_asked_for() -> None:
    """All of the product lies under the stripe: its own ambient light is nowhere seen."""
    stripes = stripes_on()
    on_stripes = np.zeros((ROWS, COLUMNS), np.bool_)
    on_stripes[:, 100:110] = True
    region = np.zeros_like(on_stripes)
    region[60:100, 104] = True
    level = np.zeros((ROWS, COLUMNS), np.float32)
    assert edge_contour._with_belt_by_light(stripes, level, region, on_stripes) is stripes


def test_images_that_do_not_fit_are_refused(rng: np.random.Generator, tmp_path) -> None:
    plain = plain_image(rng)
    with pytest.raises(StageError, match="the plain-light image is"):
        EdgeContour().outline(LASER, replace(plain, pixels=plain.pixels[:100]), stripes_on(), None)
    cv2.imwrite(str(tmp_path / "small.png"), plain.pixels[:100])
    (tmp_path / "text.png").write_text("no image")
    for name, says in (("small.png", "has shape"), ("text.png", "cannot be read")):
        with pytest.raises(StageError, match=says):
            EdgeContour(EdgeContourOptions(belt=tmp_path / name)).outline(LASER, plain, stripes_on(), None)


def test_features_of_known_outlines() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    ellipse = np.column_stack([180.0 + 100.0 * np.cos(angle), 120.0 + 30.0 * np.sin(angle)])
    pixels = np.full((ROWS, COLUMNS), 50, np.uint8)
    found = features_of(ellipse, pixels)
    assert found["length_px"] == pytest.approx(200.0, abs=0.5)
    assert found["width_px"] == pytest.approx(60.0, abs=0.5)
    assert found["area_px2"] == pytest.approx(np.pi * 3000.0, rel=1e-3)
    assert found["convexity"] == pytest.approx(1.0, abs=2e-3)
    assert found["bending_deg"] == pytest.approx(0.0, abs=0.5)
    assert (found["grey_mean"], found["grey_std"]) == (50.0, 0.0)
    # a band around an arc of 60 degrees
    radius, turn = 150.0, np.deg2rad(60.0)
    way = np.linspace(-turn / 2, turn / 2, 200)
    band = [np.column_stack([r * np.sin(way), -r * np.cos(way)]) for r in (radius + 20.0, radius - 20.0)]
    bent = features_of(np.vstack([band[0], band[1][::-1]]) + np.array([180.0, 260.0]), pixels)
    assert 35.0 < bent["bending_deg"] < 60.0
    assert 0.04 < bent["sagitta_share"] < np.tan(turn / 4) / 2.0
    assert bent["convexity"] < 0.9


def test_the_cheapest_closed_path_is_found(rng: np.random.Generator) -> None:
    """Against every path of a small strip."""
    cost = rng.uniform(0.0, 1.0, (6, 4))

    def price(path: np.ndarray) -> np.ndarray:
        step = path - np.roll(path, 1, axis=-1)
        paid = cost[np.arange(6), path].sum(axis=-1) + 0.3 * (step**2).sum(axis=-1)
        return np.where(np.abs(step).max(axis=-1) <= 1, paid, np.inf)

    every = np.stack(np.meshgrid(*[np.arange(4)] * 6), axis=-1).reshape(-1, 6)
    assert price(closed_path(cost, 0.3, 1)) == pytest.approx(price(every).min(), abs=1e-9)


@pytest.mark.parametrize(("radius_px", "from_middle_px"), [(70.0, 0.0), (97.0, 27.0)])
def test_an_outline_that_light_does_not_tell_is_as_uncertain_as_it_may_be_off(
    radius_px: float, from_middle_px: float, rng: np.random.Generator
) -> None:
    """A disc of 40 px that stripes show, belt from 100 px on, and nothing but noise between."""
    row, column = np.mgrid[0:260, 0:260].astype(np.float32)
    away_px = np.hypot(row - 130.0, column - 130.0)
    scene = edge_search.Scene(
        level=rng.normal(1.0, 0.01, away_px.shape).astype(np.float32),
        bounds=((away_px < 40.0).astype(np.float32), (away_px > 100.0).astype(np.float32)),
        stripes=np.zeros_like(away_px),
        blur_px=1.0,
        spacing_px=20.0,
    )
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    ring = 130.0 + radius_px * np.column_stack([np.cos(angle), np.sin(angle)])
    clear, open_px = edge_search._seen(scene, ring)
    assert clear < 0.2
    assert open_px == pytest.approx(np.hypot(60.0 / np.sqrt(12.0), from_middle_px), abs=3.0)
