"""Flanks that are followed: what a conic must never do beyond the last point that is seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from roemetry_scan.flanks import conic

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
