"""Peaks of the belt at a slice's end, beside the product's shadow, are no part of the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.records import Product
from roemetry_volume.surface_fit import fuse, points_of
from tests.plugins.volume.test_surface import dome


@pytest.mark.parametrize("beyond", [1, 3])
def test_belt_peaks_behind_unseen_rows_do_not_pull_the_rim_down(beyond: int) -> None:
    made, true_mm3 = dome(wall=8.0)
    spoilt = with_belt_peaks(made, beyond)
    assert points_of(spoilt).xyz_mm[:, 2].min() == pytest.approx(points_of(made).xyz_mm[:, 2].min())
    fused = fuse(spoilt, spoilt.view, spoilt.outline.xy_px)
    assert fused.volume_mm3 == pytest.approx(true_mm3, rel=0.01)


def test_points_as_high_as_the_rest_stay() -> None:
    made = dome(wall=8.0)[0]
    spoilt = with_belt_peaks(made, 2, z_mm=7.0)
    assert points_of(spoilt).xyz_mm.shape[0] > points_of(made).xyz_mm.shape[0]


def with_belt_peaks(made: Product, count: int, z_mm: float = 1.5) -> Product:
    """Add seen points at a height behind three unseen ones, at the last row's end of the last slice."""
    profiles = made.profiles
    number = int(np.flatnonzero((profiles.product == 1).any(axis=1))[-1])
    last = int(np.flatnonzero(profiles.product[number] == 1)[-1])
    rows = last + np.arange(1, 4 + count)
    xyz, product, seen = profiles.xyz_mm.copy(), profiles.product.copy(), profiles.seen.copy()
    row_px, x_px = profiles.row_px.copy(), profiles.x_px.copy()
    product[number, rows], seen[number, rows[3:]] = 1, True
    row_px[number, rows], x_px[number, rows] = rows, 0.0
    xyz[number, rows] = xyz[number, last] + np.outer(np.arange(1, 4 + count), [0.0, -0.2, 0.0])
    xyz[number, rows[3:], 2] = z_mm
    return replace(
        made, profiles=replace(profiles, xyz_mm=xyz, product=product, seen=seen, row_px=row_px, x_px=x_px)
    )
