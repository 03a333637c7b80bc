"""Skeins: repeatable, within their documented ranges, and with truth that says what the stripes show."""

from dataclasses import replace

import numpy as np
import pytest

from roemetry_simulate.products.herring import KINDS, build, draw


def coarse(seed, kind):
    return build(draw(seed, kind), step_mm=0.5)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_keeps_the_documented_ranges(kind):
    for seed in range(40, 52):
        skein = coarse(seed, kind)
        record, solid = skein.record, skein.solid
        lost = 1.0 - solid.true_volume_mm3 / solid.visible_volume_mm3
        assert 0.045 < lost < 0.26
        assert 70.0 <= record.length_mm <= 105.0
        assert 20.0 <= record.width_mm <= 34.0
        assert 10.0 <= record.thickness_mm <= 20.0
        assert abs(record.yaw_deg) <= 15.0
        assert (record.defect_depth_mm == 0.0) == (kind == "healthy")


def test_a_seed_is_a_skein():
    assert draw(9) == draw(9)
    assert draw(9, "dented") == draw(9, "dented")
    assert draw(9, "dented") != draw(10, "dented")
    np.testing.assert_array_equal(coarse(9, "twisted").solid.grid, coarse(9, "twisted").solid.grid)


def test_all_kinds_are_drawn():
    assert {draw(seed).kind for seed in range(80)} == set(KINDS)


def test_an_unknown_kind_is_refused_by_name():
    with pytest.raises(ValueError, match=r"'wavy'.*healthy"):
        draw(1, "wavy")


@pytest.mark.parametrize("kind", KINDS)
def test_only_a_defect_parts_a_skein_from_its_reference(kind):
    skein = coarse(43, kind)
    same = np.array_equal(skein.solid.grid, skein.reference.grid)
    assert same == (kind == "healthy")
    if kind in ("dented", "bent", "twisted", "broken"):
        assert skein.solid.visible_volume_mm3 < skein.reference.visible_volume_mm3


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
