"""Upright walls under an outline: seen ones are no part of the rim, and corners are in the footprint."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from roemetry_volume.footprint import area_of
from roemetry_volume.rim import StripePoints, ends_of
from roemetry_volume.surface_fit import fuse
from tests.plugins.volume.test_surface import box, dome, half_cylinder


@pytest.mark.parametrize("rows", [0, 1, 4])
def test_rows_down_a_wall_that_the_camera_sees_are_no_end_of_the_top(rows: int) -> None:
    y = np.concatenate([np.full(rows, 20.0) + 0.02 * np.arange(rows)[::-1], 20.0 - 0.2 * np.arange(1, 60)])
    z = np.concatenate([16.0 * (np.arange(rows) + 0.25) / max(rows, 1), np.full(59, 16.0)])
    points = StripePoints(
        np.column_stack([np.zeros_like(y), y, z]), np.zeros(y.size, int), np.array([0, y.size])
    )
    index, first, _ = ends_of(points, y)
    assert index[first].tolist() == [rows, y.size - 1]


def test_a_dome_keeps_its_outermost_row() -> None:
    d = 0.1 + 0.19 * np.arange(40)
    z = 3.0 + np.sqrt(20.0 * d)
    points = StripePoints(
        np.column_stack([np.zeros_like(d), -d, z]), np.zeros(d.size, int), np.array([0, d.size])
    )
    index, first, _ = ends_of(points, points.xyz_mm[:, 1])
    assert index[first].tolist() == [0, d.size - 1]


@pytest.mark.parametrize("made", [box, dome, half_cylinder])
def test_the_nodes_stand_for_all_of_the_footprint(made) -> None:
    product = made()[0]
    fused = fuse(product, product.view, product.outline.xy_px)
    assert fused.weight_mm2.sum() == pytest.approx(abs(area_of(fused.contour)), rel=1e-9)


@pytest.mark.parametrize("lowest_mm", [0.0, 16.5])
def test_a_wall_that_faces_the_camera_is_in_the_outline_or_too_dark_to_show(lowest_mm: float) -> None:
    """With the wall the outline is its foot, without it the upper edge: the footprint is the same."""
    made, true_mm3 = box(y0=17.0)
    corners = [[i, 17.0 + j, z] for i in (-30.0, 30.0) for j in (-13.0, 13.0) for z in (lowest_mm, 16.5)]
    hull = cv2.convexHull(made.view.project(np.array(corners)).astype(np.float32))[:, 0].astype(float)
    assert fuse(made, made.view, hull).volume_mm3 == pytest.approx(true_mm3, rel=0.01)
