"""Rays meet sight rays: exact places give exact heights, derivatives are those of differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.errors import RecordError
from roemetry.records import Dots, Rays
from roemetry.records.light import at_height, meet
from roemetry.records.view import View
from roemetry.testing.scenes import LinearRig


def camera(k1: float = 0.05) -> View:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 320.0
    matrix = np.array([[1600.0, 0.0, 319.5], [0.0, 1600.0, 239.5], [0.0, 0.0, 1.0]])
    return View((480, 640), matrix, pose, np.empty((0, 4)), distortion=np.array([k1, -0.1, 0.0, 0.0]))


@given(
    st.floats(-45.0, 45.0), st.floats(-35.0, 35.0), st.floats(0.2, 0.9), st.floats(-0.4, 0.4),
    st.floats(-2.0, 40.0), st.floats(-0.2, 0.2),
)  # fmt: skip
def test_a_dot_of_a_ray_has_its_height(x: float, y: float, sx: float, sy: float, z: float, k1: float) -> None:
    lines, view = np.array([[x, y, sx, sy]]), camera(k1)
    noise = np.array([[[0.02, 0.005], [0.005, 0.01]]])
    seen = view.project(at_height(lines, z))
    met = meet(view, lines, seen, noise)
    assert met.z_mm[0] == pytest.approx(z, abs=1e-6)  # mm
    assert met.misfit[0] < 1e-4
    for axis in (0, 1):
        step = np.zeros((1, 2))
        step[0, axis] = 0.01
        difference = (meet(view, lines, seen + step, noise).z_mm - met.z_mm) / 0.01
        assert met.z_by_px[0, axis] == pytest.approx(difference[0], rel=1e-2, abs=1e-4)


def test_the_stated_height_error_is_that_of_noisy_dots(rng: np.random.Generator) -> None:
    lines = np.tile([10.0, -5.0, 0.5, 0.1], (4000, 1))
    covariance = np.array([[0.02, 0.006], [0.006, 0.01]])
    seen = camera().project(at_height(lines, 12.0)) + rng.multivariate_normal([0, 0], covariance, 4000)
    met = meet(camera(), lines, seen, np.tile(covariance, (4000, 1, 1)))
    assert met.z_mm.std() == pytest.approx(met.z_std_mm.mean(), rel=0.05)
    assert np.sqrt((met.misfit**2).mean()) == pytest.approx(1.0, abs=0.05)  # one number is left over


def test_rays_follow_the_parameters_and_come_back_from_a_file() -> None:
    lines = np.arange(8.0).reshape(1, 2, 4)
    rays = Rays(lines, np.zeros((1, 2, 4, 4)), np.full((1, 2, 4, 3), 0.5), np.array([1.0, 2.0, 3.0]))
    moved = rays.moved({"one": np.array([1.0, 2.0]), "other": np.array([5.0])})
    np.testing.assert_allclose(moved, lines + 1.0)
    again = Rays.from_dict(rays.to_dict())
    np.testing.assert_array_equal(again.by_parameter, rays.by_parameter)


def test_records_of_dots_are_checked() -> None:
    with pytest.raises(RecordError, match="covariance_px2"):
        Dots(np.zeros(3), np.zeros((3, 2)), np.zeros(3, np.int16))
    with pytest.raises(RecordError, match="lines has shape"):
        Rays(np.zeros((2, 4)), np.zeros((2, 4, 4)), np.zeros((2, 4, 1)), np.zeros(1))
    assert LinearRig().calibration().rays is None
