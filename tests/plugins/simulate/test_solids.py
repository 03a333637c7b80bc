"""Volumes and heights of solids against formulas; what is refused."""

import numpy as np
import pytest

from roemetry_simulate.solid import Block, GriddedSolid
from tests.plugins.simulate.gridded import on_grid

A, B, C = 17.0, 11.0, 7.0


def cap(x, y):
    return C**2 * np.maximum(1.0 - (x / A) ** 2 - (y / B) ** 2, -0.4)


def level(z_mm):
    return lambda x, y: np.full_like(x, z_mm)


def half_ellipsoid(step_mm=0.125):
    return on_grid((-19, 19, -13, 13), step_mm, level(0.0), cap, lambda x, y: np.minimum(cap(x, y), 0.0))


def test_a_half_ellipsoid_has_the_formula_s_volume():
    dome = half_ellipsoid()
    formula = 2.0 / 3.0 * np.pi * A * B * C
    assert dome.visible_volume_mm3 == pytest.approx(formula, rel=1e-4)
    assert dome.true_volume_mm3 == pytest.approx(formula, rel=1e-4)
    assert dome.footprint_mm2 == pytest.approx(np.pi * A * B, rel=1e-4)


def test_an_ellipsoid_on_the_belt_loses_what_lies_below_its_widest_line():
    body = on_grid((-19, 19, -13, 13), 0.125, level(C), cap, cap)
    half = 2.0 / 3.0 * np.pi * A * B * C
    assert body.true_volume_mm3 == pytest.approx(2.0 * half, rel=1e-4)
    assert body.visible_volume_mm3 == pytest.approx(half + np.pi * A * B * C, rel=1e-4)


def test_a_flat_slab_with_straight_sides_is_exact():
    # u falls linearly through zero at x = 5, so the footprint ends there to the last digit
    def ramp(x, y):
        return np.minimum(np.minimum(5.0 - np.abs(x), 4.0 - np.abs(y)), 0.5)

    slab = on_grid((-6, 6, -5, 5), 0.5, level(3.0), ramp, lambda x, y: ramp(x, y))
    assert slab.footprint_mm2 == pytest.approx(80.0, rel=1e-9)


def test_heights_between_nodes_and_outside():
    top, bottom = half_ellipsoid().heights_mm([0.03, 6.01, 18.0, 500.0], [0.0, -3.02, 0.0, 0.0])
    expected = C * np.sqrt(1.0 - (6.01 / A) ** 2 - (3.02 / B) ** 2)
    assert top[:2] == pytest.approx([C, expected], abs=1e-3)
    assert bottom[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert np.isnan(top[2:]).all()
    assert np.isnan(bottom[2:]).all()


@pytest.mark.parametrize(
    ("grid", "message"),
    [(np.zeros((4, 4)), "shape"), (np.full((4, 4, 3), np.nan), "NaN"), (np.ones((4, 4, 3)), "border")],
)
def test_what_is_no_body_is_refused(grid, message):
    with pytest.raises(ValueError, match=message):
        GriddedSolid(0.0, 0.0, 0.1, grid)
    with pytest.raises(ValueError, match="positive"):
        Block(10.0, 10.0, 0.0)
