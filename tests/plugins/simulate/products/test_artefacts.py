"""Reference artefacts: volumes, heights, hits and normals against closed forms; what is refused."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from roemetry_simulate.products import PRODUCTS
from roemetry_simulate.products.artefacts import ARTEFACTS
from roemetry_simulate.products.parts import PartsSolid, hit_parts, parts_normal

NAMES = [family.name for family in ARTEFACTS]
ANYWHERE = {"turn_range_deg": 180.0, "offset_range_x_mm": 30.0, "offset_range_y_mm": 20.0}


def draw(name, seed=1, **options):
    family = PRODUCTS[name]
    return family.draw(seed, family.Options(**options))


def columns(solid, count=900):
    """Heights over the middles of cells that cover the footprint's bounds, and a cell's area."""
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    share = (np.arange(count) + 0.5) / count
    x, y = np.meshgrid(x_min + share * (x_max - x_min), y_min + share * (y_max - y_min))
    top, bottom = solid.heights_mm(x, y)
    return x, y, top, bottom, (x_max - x_min) * (y_max - y_min) / count**2


@pytest.mark.parametrize(
    ("name", "options", "visible", "true"),
    [
        ("block", {"length_mm": 80, "width_mm": 40, "height_mm": 15}, 48000.0, 48000.0),
        ("staircase", {"steps": 3, "tread_mm": 10, "riser_mm": 2, "width_mm": 30}, 3600.0, 3600.0),
        ("wedge", {"length_mm": 60, "width_mm": 30, "low_height_mm": 5, "high_height_mm": 15}, 18e3, 18e3),
        ("sphere", {"radius_mm": 15}, 5 / 3 * math.pi * 15**3, 4 / 3 * math.pi * 15**3),
        ("sphere", {"radius_mm": 40, "height_mm": 10}, math.pi * 100 * 110 / 3, math.pi * 100 * 110 / 3),
        ("sphere", {"radius_mm": 10, "height_mm": 15}, math.pi * (2000 / 3 + 500), math.pi * 225 * 15 / 3),
        ("cylinder", {"length_mm": 80, "radius_mm": 12}, math.pi * 144 * 40, math.pi * 144 * 40),
        (
            "cylinder",
            {"length_mm": 80, "radius_mm": 12, "half": False},
            80 * (24 * 12 + math.pi * 72),
            math.pi * 144 * 80,
        ),
        ("truncated-pyramid", {"length_mm": 70, "width_mm": 50, "top_share": 0.4}, 32760.0, 32760.0),
    ],
)  # fmt: skip
def test_volumes_are_those_of_the_formulas(name, options, visible, true):
    truth = draw(name, **options, **ANYWHERE).truth
    assert truth.visible_mm3 == pytest.approx(visible, rel=1e-12)
    assert truth.true_mm3 == pytest.approx(true, rel=1e-12)
    assert truth.mass_g == pytest.approx(true * 7.85e-3, rel=1e-12)
    assert (truth.label, truth.defect) == ("good", "none")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("turned", [False, True])
def test_stated_volumes_and_areas_are_what_the_heights_sum_to(name, turned):
    """Straight ones to 0.01 %; turned ones as well as cells across a slanted border can tell."""
    options = {"cylinder": {"half": False}, "sphere": {"height_mm": 11.0}}.get(name, {}) if turned else {}
    solid = draw(name, seed=5, **options, **(ANYWHERE if turned else {})).solid
    rel = 1e-3 if turned else 1e-4
    _, _, top, bottom, cell = columns(solid)
    assert np.nansum(top) * cell == pytest.approx(solid.visible_volume_mm3, rel=rel)
    assert np.isfinite(top).sum() * cell == pytest.approx(solid.footprint_mm2, rel=rel)
    known = np.isfinite(top)
    assert (bottom[known] >= 0.0).all()
    assert (bottom[known] <= top[known]).all()
    assert np.nansum(top - bottom) * cell == pytest.approx(solid.true_volume_mm3, rel=rel)


def test_a_ball_bar_s_rod_hangs_over_the_belt():
    top, bottom = draw("ball-bar").solid.heights_mm([0.0, 0.0, 35.0, 0.0], [0.0, 3.9, 0.0, 4.1])
    np.testing.assert_allclose(top[:3], [16.0, 12.0 + math.sqrt(16 - 3.9**2), 24.0], atol=1e-9)
    np.testing.assert_allclose(bottom[:3], [8.0, 12.0 - math.sqrt(16 - 3.9**2), 0.0], atol=1e-9)
    assert np.isnan(top[3])


@pytest.mark.parametrize("name", [name for name in NAMES if name != "block"])
def test_hits_lie_on_the_body_and_normals_point_out_of_it(name):
    solid = draw(name, seed=2, **({"half": False} if name == "cylinder" else {}), **ANYWHERE).solid
    assert isinstance(solid, PartsSolid)
    body = solid.body()
    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    rng = np.random.default_rng(4)
    camera = np.array([0.5 * (x_min + x_max) + 60.0, 0.5 * (y_min + y_max) - 20.0, 300.0])
    hits = 0
    for _ in range(150):
        aim = np.array([rng.uniform(x_min, x_max), rng.uniform(y_min, y_max), 0.0])
        d = (aim - camera) / np.linalg.norm(aim - camera)
        t = hit_parts(body.surfaces, body.boxes[0], camera, d, 1e9)
        if t < 0.0:
            continue
        hits += 1
        point, normal = camera + t * d, np.zeros(3)
        parts_normal(body.surfaces, point, normal)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        assert normal @ d < 1e-6
        x, y, z = point - 1e-5 * normal
        top, bottom = solid.heights_mm(x, y)
        assert bottom <= z <= top
        x, y, z = point + 1e-5 * normal
        top, bottom = solid.heights_mm(x, y)
        assert not (bottom <= z <= top)
    assert hits > 20


@pytest.mark.parametrize("name", NAMES)
def test_an_artefact_lies_straight_in_the_middle_unless_told_otherwise(name):
    x_min, x_max, y_min, y_max = draw(name).solid.footprint_extent_mm()
    assert (x_min + x_max, y_min + y_max) == pytest.approx((0.0, 0.0), abs=1e-9)
    one, again, other = (draw(name, seed, **ANYWHERE) for seed in (7, 7, 8))
    assert one.truth == again.truth
    assert one.truth != other.truth
    assert abs(one.truth.figures["yaw_deg"]) <= 180.0


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("block", {"height_mm": 0.0}, "greater than 0"),
        ("block", {"hight_mm": 3.0}, "hight_mm"),
        ("wedge", {"low_height_mm": 30.0}, "at most high_height_mm"),
        ("sphere", {"radius_mm": 5.0, "height_mm": 11.0}, "twice radius_mm"),
        ("ball-bar", {"rod_radius_mm": 12.0}, "below ball_radius_mm"),
        ("ball-bar", {"centre_distance_mm": 20.0}, "twice ball_radius_mm"),
        ("cylinder", {"radius_mm": math.nan}, "radius_mm"),
    ],
)
def test_options_that_are_no_artefact_are_refused(name, options, message):
    with pytest.raises(ValidationError, match=message):
        PRODUCTS[name].Options(**options)


def test_another_family_s_options_and_a_negative_seed_are_refused():
    with pytest.raises(TypeError, match="wedge takes WedgeOptions, not BlockOptions"):
        PRODUCTS["wedge"].draw(1, PRODUCTS["block"].Options())
    with pytest.raises(ValueError, match="-1"):
        PRODUCTS["wedge"].draw(-1)
