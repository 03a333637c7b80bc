"""The plan of a rig over a moving belt: line spacing and belt speed by closed forms."""

import numpy as np
import pytest

from roemetry_simulate.belt_planner import BeltPlanner, enough_mm
from roemetry_simulate.moving_belt import MovingBeltOptions
from roemetry_simulate.plan_tables import ellipsoid

SCENE = {
    "camera": {"width_px": 200, "height_px": 230, "pixel_size_um": 10, "focal_length_mm": 12,
               "distance_mm": 300, "tilt_x_deg": 0, "tilt_y_deg": 35, "exposure_ms": 4},
    "laser": {"projector_mm": [0, 0, 400], "planes": 1, "centre_x_mm": 0},
    "scan": {"mm_per_count": [0.02, 0.0], "counts_per_line": 40},
}  # fmt: skip


def test_of_an_ellipsoid_the_spacing_is_that_of_the_closed_form():
    """It errs by 1 / (√5 N²): 0.1 % at N = 21.1 slices."""
    assert enough_mm(ellipsoid(80.0)) == pytest.approx(80.0 / 21.15, rel=0.03)


def test_the_plan_says_which_spacing_and_speed_are_enough():
    rolls = {"family": "bread-roll", "options": {"length_range_mm": [45, 55], "width_range_mm": [34, 40]}}
    plan = BeltPlanner(MovingBeltOptions.model_validate(SCENE | {"product": rolls})).plan(simulate=False)
    assert plan.value("line-spacing") == pytest.approx(0.8)
    assert plan.value("belt-speed") == pytest.approx(0.8 / 4e-3)
    enough = plan.value("spacing-enough")
    assert plan.value("speed-enough") == pytest.approx(enough / 4e-3)
    spacing, error = plan.column("line-spacing", "spacing"), plan.column("line-spacing", "error")
    assert (np.diff(error[spacing >= enough]) > 0).all()
    assert (error[spacing > 2 * enough] > 0.1).all()
    assert plan.answer is not None
    assert plan.answer.fits
    assert f"a line every {enough:g} mm is enough" in plan.answer.text


def test_a_product_higher_than_the_line_is_seen_is_told():
    high = {"family": "truncated-pyramid", "options": {"height_mm": 60, "length_mm": 40, "width_mm": 40}}
    plan = BeltPlanner(MovingBeltOptions.model_validate(SCENE | {"product": high})).plan(simulate=False)
    assert plan.answer is not None
    assert not plan.answer.fits
    assert "leaves the view" in plan.answer.limiting


def test_an_empty_belt_has_spacing_and_speed_and_no_answer():
    plan = BeltPlanner(MovingBeltOptions.model_validate(SCENE)).plan(simulate=False)
    assert plan.answer is None or plan.answer.fits
    assert plan.value("belt-speed") == pytest.approx(200.0)
