"""Flanks that are followed: what a conic must never do beyond the last point that is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from roemetry_scan.flanks import conic, rims_of

INWARDS_MM = np.linspace(0.0, 6.0, 20)


@pytest.mark.parametrize("rim_mm", [0.0, 6.0, math.nan])
def test_a_flank_never_rises_again_where_its_curve_is_hollow(rim_mm: float) -> None:
    """An egg's outermost rows were followed 50 mm beyond it, upwards: 3 % of its volume too much."""
    square = 64.0 + 4.0 * INWARDS_MM + 1.5 * INWARDS_MM**2  # (z − 6)²: a hyperbola without a root
    height_mm = 6.0 + np.sqrt(square)
    r, a, b, c, length = conic(INWARDS_MM, height_mm, INWARDS_MM.size, 50.0, rim_mm)
    out = np.linspace(0.0, length, 50)
    followed = r + np.sqrt(np.maximum(a + b * out + c * out**2, 0.0))
    assert 0.0 < length < 50.0
    assert (np.diff(followed) < 0.0).all()


def test_an_ellipse_is_followed_to_where_it_ends() -> None:
    """Of the half-axes 20 and 10 mm over a rim at 3 mm, seen up to 15 mm from its middle."""
    height_mm = 3.0 + 10.0 * np.sqrt(1.0 - ((15.0 - INWARDS_MM) / 20.0) ** 2)
    length = conic(INWARDS_MM, height_mm, INWARDS_MM.size, 50.0, 3.0)[4]
    assert length == pytest.approx(5.0, abs=1e-3)


def test_a_rim_is_found_beside_points_that_are_too_dim_and_one_that_is_lifted(
    rng: np.random.Generator,
) -> None:
    """Light grazes a ball beside its rim: each row loses one or two points, and the last is too high."""
    rim_mm, radius_mm, step_mm, dim_mm = 19.0, 20.0, 0.65, 0.9
    lines, rows = 110, 400
    x_mm = step_mm * np.arange(lines)[:, None] + rng.uniform(0.0, step_mm, rows)
    off_mm = np.abs(x_mm - 0.5 * step_mm * lines)
    on = off_mm < radius_mm
    height_mm = np.where(on, rim_mm + np.sqrt(np.maximum(radius_mm**2 - off_mm**2, 0.0)), 0.0)
    label = np.where(on, 1, 0).astype(np.int16)
    label[on & (radius_mm - off_mm < dim_mm)] = -1
    last = (label == 1) & (np.roll(label, -1, axis=0) == -1)
    height_mm[last] += 0.3
    label[:30] = -1  # in the shadow
    xyz_mm = np.stack([x_mm, np.zeros_like(x_mm), np.where(label < 0, np.nan, height_mm)], axis=-1)
    none = np.zeros(label.shape, np.bool_)
    rims, _ = rims_of(xyz_mm, label, none, 1)
    assert rims[1] == pytest.approx(rim_mm, abs=0.15)
    # what lifts the last point says how far off the rim may be
    outer, _ = rims_of(xyz_mm, label, none, 1, 0)
    assert 0.5 < outer[1] - rims[1] < 2.0
