"""A calibration of dots or of a grid whose camera has moved shows belt and heights where that camera does."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry import Recipe
from roemetry.records.calibration import Alignment
from roemetry.records.light import at_height
from roemetry_pinhole.dot_rays import PinholeDots
from roemetry_pinhole.grid import PinholeGrid
from roemetry_pinhole.pinhole_plane import PinholePlane

NOTHING = np.zeros((4, 4))
MOTIONS = {
    "shift": np.array([0.8, 0.0, 0.0, 0.0]),
    "roll": np.array([0.0, 4e-3, 0.0, 0.0]),
    "zoom": np.array([0.0, 0.0, 3e-3, 0.0]),
    "tilt": np.array([0.0, 0.0, 0.0, 6e-4]),
}


def expected(xy_px: np.ndarray, motion: np.ndarray, focal_px: float, middle_px: np.ndarray) -> np.ndarray:
    """Where a camera that has turned and zoomed shows what was seen at xy (n, 2), to first order."""
    pan_px, roll, zoom, tilt = motion
    x, y = ((xy_px - middle_px) / focal_px).T
    right = pan_px / focal_px * (1.0 + x * x) - tilt * x * y - roll * y + zoom * x
    down = pan_px / focal_px * x * y - tilt * (1.0 + y * y) + roll * x + zoom * y
    return xy_px + focal_px * np.column_stack([right, down])


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("height_mm", [0.0, 25.0])
def test_dots_are_shown_where_the_moved_camera_sees_them(name: str, height_mm: float) -> None:
    calibration = Recipe.load("recipes/potato_dots").calibration
    assert calibration is not None and calibration.rays is not None and calibration.view is not None
    moved = PinholeDots().moved(calibration, Alignment(MOTIONS[name], NOTHING))
    view = PinholeDots().view(moved)
    assert view is not None and moved.rays is not None
    points = at_height(moved.rays.moved(moved.parameters).reshape(-1, 4), height_mm)
    known = np.isfinite(points).all(axis=1)
    camera = calibration.view.camera_matrix
    before = calibration.view.project(points[known])
    after = expected(before, MOTIONS[name], camera[0, 0], camera[:2, 2])
    assert np.abs(view.project(points[known]) - after).max() < 0.02  # px; the lens is not in the expectation


@pytest.mark.parametrize("name", MOTIONS)
def test_both_families_are_shown_where_the_moved_camera_sees_them(name: str) -> None:
    calibration = Recipe.load("recipes/potato_grid").calibration
    assert calibration is not None and calibration.across is not None and calibration.view is not None
    alignment = Alignment(MOTIONS[name], 1e-8 * np.eye(4))
    moved = PinholeGrid().moved(calibration, alignment)
    # the stripes alone are what pinhole-plane makes of them
    alone = PinholePlane().moved(calibration, alignment)
    assert np.allclose(moved.rest_px, alone.rest_px, atol=1e-9)
    assert np.allclose(moved.covariance, alone.covariance, rtol=1e-12)
    assert np.trace(moved.covariance) > np.trace(calibration.covariance)
    assert moved.across is not None
    camera, columns = calibration.view.camera_matrix, calibration.image_size[1]
    rows = np.arange(40.0, columns - 40.0, 20.0)
    for line, rest in enumerate(calibration.across.rest_line_px(rows)):
        before = np.column_stack([columns - 1.0 - rows, rest])
        after = expected(before, MOTIONS[name], camera[0, 0], camera[:2, 2])
        inside = (after[:, 1] > 0.0) & (after[:, 1] < calibration.image_size[0])
        shown = np.array(
            [moved.across.rest_line_px(np.array([columns - 1.0 - x]))[line, 0] for x in after[:, 0]]
        )
        assert np.abs(shown - after[:, 1])[inside].max(initial=0.0) < 0.02  # px


def test_single_lines_of_both_families_are_shifted() -> None:
    calibration = Recipe.load("recipes/potato_grid").calibration
    assert calibration is not None and calibration.across is not None
    stripes, lines = calibration.stripe_count, calibration.across.stripe_count
    planes_px = np.zeros(stripes + lines)
    planes_px[2], planes_px[stripes + 3] = 0.5, -0.4
    moved = PinholeGrid().moved(
        calibration, Alignment(np.zeros(4), NOTHING, planes_px=planes_px, planes_std_px=0.05)
    )
    assert moved.across is not None
    for one, other, shift in (
        (calibration, moved, planes_px[:stripes]),
        (calibration.across, moved.across, planes_px[stripes:]),
    ):
        middle = np.array([0.5 * (one.image_size[0] - 1)])
        off = (other.rest_line_px(middle) - one.rest_line_px(middle))[:, 0]
        assert np.abs(off - shift).max() < 0.01  # px
    assert np.trace(moved.covariance) > np.trace(calibration.covariance)
