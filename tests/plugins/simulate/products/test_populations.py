"""Foods: within their documented ranges, repeatable, and parted from their references by the defect alone."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.family import Drawn
from roemetry_simulate.products.herring import FURTHER_KINDS, KINDS, build, dents, draw

SEEDS = range(50)

RANGES = {
    # length, width, thickness as measured on the body, underside's share of the visible volume
    "herring-roe": ((70.0, 105.0), (20.0, 34.0), (10.0, 20.0), (0.05, 0.25)),
    "potato": ((50.0, 113.5), (31.0, 75.6), (19.0, 56.0), (0.10, 0.22)),
    "fillet": ((74.5, 110.0), (20.0, 60.0), (4.0, 22.5), (0.01, 0.08)),
    "bread-roll": ((59.5, 95.0), (49.5, 75.0), (25.0, 51.0), (0.02, 0.09)),
    "egg": ((49.5, 64.0), (37.5, 47.0), (34.0, 47.0), (0.19, 0.21)),
}
KNOWN = {
    "herring-roe": {"none", *KINDS, *FURTHER_KINDS} - {"healthy"},
    "potato": {"none", "dented"},
    "fillet": {"none", "gaping"},
    "bread-roll": {"none", "sunken", "split"},
    "egg": {"none", "dented"},
}


def draws(name, seeds=SEEDS, **options) -> list[Drawn]:
    family = PRODUCTS[name]
    chosen = family.Options(grid_step_mm=0.5, **options)
    return [family.draw(seed, chosen) for seed in seeds]


@pytest.fixture(scope="module", params=list(RANGES))
def population(request):
    return request.param, draws(request.param)


def test_sizes_and_places_lie_within_the_documented_ranges(population):
    name, products = population
    keys = ("length_mm", "width_mm", "thickness_mm", "underside_share")
    for key, (low, high) in zip(keys, RANGES[name], strict=True):
        sizes = np.array([drawn.truth.figures[key] for drawn in products])
        assert (low <= sizes.min(), sizes.max() <= high) == (True, True), (key, sizes.min(), sizes.max())
        if key != "underside_share":
            assert np.ptp(sizes) > 0.4 * (high - low), f"{key} is drawn from a part of its range only"
    yaw = np.array([drawn.truth.figures["yaw_deg"] for drawn in products])
    assert np.abs(yaw).max() <= 15.0
    assert yaw.min() < -5.0
    assert yaw.max() > 5.0
    middles = [np.reshape(drawn.solid.footprint_extent_mm(), (2, 2)).mean(axis=1) for drawn in products]
    assert np.ptp(middles, axis=0).min() > 5.0


def test_every_kind_is_drawn_and_labelled(population):
    name, products = population
    assert {drawn.truth.defect for drawn in products} == KNOWN[name]
    for drawn in products:
        assert drawn.truth.label == ("good" if drawn.truth.defect == "none" else "henkei")
        assert drawn.truth.mass_g == pytest.approx(
            drawn.truth.true_mm3 * 1e-3 * PRODUCTS[name].Options().density_g_per_cm3
        )
        same = drawn.solid.visible_volume_mm3 == drawn.reference.visible_volume_mm3
        assert same == (drawn.truth.defect == "none"), "only a defect parts a product from its reference"


def test_the_bottom_is_never_over_the_top_nor_under_the_belt(population):
    _, products = population
    for drawn in products[::5]:
        x_min, x_max, y_min, y_max = drawn.solid.footprint_extent_mm()
        x, y = np.meshgrid(np.linspace(x_min, x_max, 120), np.linspace(y_min, y_max, 120))
        top, bottom = drawn.solid.heights_mm(x, y)
        known = np.isfinite(top)
        assert (bottom[known] <= top[known]).all()
        assert bottom[known].min() >= -1e-9
        cell = (x_max - x_min) * (y_max - y_min) / 119**2
        assert top[known].sum() * cell == pytest.approx(drawn.truth.visible_mm3, rel=0.03)


def test_a_seed_is_a_product(population):
    name, products = population
    again = draws(name, range(2))
    assert [drawn.truth for drawn in again] == [drawn.truth for drawn in products[:2]]
    np.testing.assert_array_equal(again[1].solid.grid, products[1].solid.grid)
    assert again[0].truth != again[1].truth


@pytest.mark.parametrize("name", list(RANGES))
def test_volumes_do_not_depend_on_the_place(name):
    family = PRODUCTS[name]
    straight = family.Options(turn_range_deg=0.0, offset_range_x_mm=0.0, offset_range_y_mm=0.0)
    one, moved = family.draw(6, straight).truth, family.draw(6).truth
    # a skein's relief is drawn on the belt's grid and not on its own
    rel = 3e-3 if name == "herring-roe" else 3e-4
    assert moved.visible_mm3 == pytest.approx(one.visible_mm3, rel=rel)
    assert moved.true_mm3 == pytest.approx(one.true_mm3, rel=rel)


def test_shares_say_what_is_drawn():
    some = draws("herring-roe", range(20), kinds={"s-bent": 1, "several-dents": 3})
    counts = Counter(drawn.truth.defect for drawn in some)
    assert set(counts) == {"s-bent", "several-dents"}
    assert counts["several-dents"] > counts["s-bent"]
    assert all(2 <= d.truth.figures["dent_count"] <= 4 for d in some if d.truth.defect == "several-dents")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kinds": {"wavy": 1.0}}, r"'wavy'; there are healthy"),
        ({"kinds": {"dented": -1.0}}, "0 or more"),
        ({"kinds": {"dented": 0.0}}, "above 0"),
        ({"length_range_mm": (60.0, 50.0)}, "not smaller"),
        ({"grid_step_mm": 0.0}, "grid_step_mm"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValidationError, match=message):
        PRODUCTS["potato"].Options(**options)
    with pytest.raises(ValueError, match=r"'wavy'.*healthy"):
        draw(1, "wavy")


def test_a_healthy_egg_is_the_formula_of_its_revolution():
    family = PRODUCTS["egg"]
    for seed in range(4):
        truth = family.draw(seed, family.Options(kinds={"healthy": 1.0})).truth
        radius, length = truth.figures["shape_radius_mm"], truth.figures["nominal_length_mm"]
        assert truth.true_mm3 == pytest.approx(2 / 3 * math.pi * radius**2 * length, rel=1e-4)


@pytest.mark.parametrize("kind", FURTHER_KINDS)
def test_further_kinds_of_skein_keep_the_documented_ranges(kind):
    for seed in range(12):
        record = draw(seed, kind)
        assert record == draw(seed, kind)
        assert 2.0 <= record.defect_depth_mm <= 6.0
        assert (25.0 <= abs(record.bend_deg) <= 45.0) == (kind == "s-bent")
        if kind == "several-dents":
            found = dents(record)
            assert 2 <= len(found) <= 4
            assert all(2.0 <= one.defect_depth_mm <= 6.0 for one in found)
            assert all(5.0 <= one.defect_width_mm <= 20.0 for one in found)


def test_an_s_is_its_own_image_turned_by_half_a_turn_but_for_its_thick_end():
    record = replace(
        draw(5, "s-bent"), thick_end=0.0, relief_mm=0.0, centre_x_mm=0.0, centre_y_mm=0.0, yaw_deg=0.0
    )
    solid = build(record, 0.5).reference
    x, y = np.meshgrid(np.linspace(-50, 50, 101), np.linspace(-25, 25, 51))
    top, turned = solid.heights_mm(x, y)[0], solid.heights_mm(-x, -y)[0]
    np.testing.assert_allclose(top, turned, atol=1e-6)
    x_min, x_max, _, _ = solid.footprint_extent_mm()
    assert 0.8 * record.length_mm < x_max - x_min < record.length_mm + record.width_mm
    ends = [np.nanmax(np.where(np.isfinite(top[:, k]), y[:, k], np.nan)) for k in (20, 80)]
    assert abs(ends[0] - ends[1]) > 3.0


def test_a_healthy_skein_is_about_the_formula_of_its_shape():
    """Without taper, thick end, relief and bend, blunt ends of power 2: half an ellipsoid on a rim."""
    record = replace(
        draw(3, "healthy"), thick_end=0.0, taper=0.0, bluntness=2.0, fullness=0.0, relief_mm=0.0, bend_deg=0.0
    )
    skein = build(record)
    a, b = 0.5 * record.length_mm, 0.5 * record.width_mm
    dome = record.thickness_mm - record.rim_height_mm
    # the rim falls towards the ends as 1 - 0.3 a², whose mean over an ellipse is 1 - 0.3 / 4
    formula = np.pi * a * b * (2.0 / 3.0 * dome + record.rim_height_mm * (1.0 - 0.3 / 4.0))
    assert skein.solid.visible_volume_mm3 == pytest.approx(formula, rel=2e-4)
