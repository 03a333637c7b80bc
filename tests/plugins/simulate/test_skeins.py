"""Skeins: repeatable, within their documented ranges, and with truth that says what the stripes show."""

from dataclasses import replace

import numpy as np
import pytest

from roemetry_simulate import herring_roe
from roemetry_simulate.herring_dataset import SHIPPED, truth_row
from roemetry_simulate.parameters import KINDS, draw
from roemetry_simulate.shown import shown
from roemetry_simulate.skein import build


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
        herring_roe.scene(1, "wavy")


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


@pytest.fixture(scope="module")
def dents():
    """Rows of truth of the two shipped dents, by number."""
    rows = {}
    for number in (2, 3):
        seed, kind = SHIPPED[number]
        one = herring_roe.scene(seed, kind)
        rows[number] = truth_row(f"{number}.png", one, herring_roe.stripe_truth(one))
    return rows


def test_one_shipped_dent_lies_under_a_stripe_and_one_between(dents):
    assert float(dents[2]["defect_seen_mm"]) > 0.8 * float(dents[2]["defect_depth_mm"])
    assert float(dents[3]["defect_depth_mm"]) >= 2.0
    assert float(dents[3]["defect_seen_mm"]) < 0.5
    assert {row["class"] for row in dents.values()} == {"henkei"}


def test_weight_is_true_volume_times_density(dents):
    for row in dents.values():
        assert float(row["weight_g"]) == pytest.approx(float(row["true_volume_mm3"]) * 1.1e-3, abs=1e-3)
        assert float(row["true_volume_mm3"]) < float(row["visible_volume_mm3"])


def test_all_eleven_stripes_lie_on_the_calibration_block():
    one = herring_roe.block_scene()
    truth = herring_roe.stripe_truth(one)
    on_top = (truth.on_product == 1).sum(axis=1)
    assert truth.x_px.shape == (11, 480)
    assert on_top.min() > 180
    assert ((truth.on_product == 0).sum(axis=1) > 180).all()
    np.testing.assert_allclose(truth.xyz_mm[truth.on_product == 1][:, 2], 16.5, atol=1e-6)
    belt = herring_roe.stripe_truth(herring_roe.belt_scene())
    assert np.isfinite(belt.x_px).all()
    spacing_px = np.diff(belt.x_px, axis=0).mean()
    shift_px = np.nanmean(np.where(truth.on_product == 1, truth.x_px - belt.x_px, np.nan))
    assert 1.0 <= shift_px / spacing_px <= 1.15


def test_what_is_shown_of_a_healthy_skein_has_no_defect():
    one = herring_roe.scene(11, "healthy")
    seen = shown(one.skein, herring_roe.stripe_truth(one))
    assert (seen.left_stripe, seen.right_stripe) == (1, 11)
    assert seen.defect_depth_mm == 0.0
    assert seen.defect_seen_mm == pytest.approx(0.0, abs=1e-9)
    assert seen.hollow_seen_mm < 0.1
    assert 0.0 < seen.overhang_left_mm < 1.5 * herring_roe.SPACING_MM
    assert 0.0 < seen.overhang_right_mm < 1.5 * herring_roe.SPACING_MM
