"""The lens's slopes against differences of the lens itself, and its inverse against a round trip."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.records.camera_model import distorted, slopes, undistorted
from roemetry_kernels.lens import distort_places, undistort_places

small = st.floats(-0.05, 0.05)
LENSES = st.tuples(
    *[st.floats(-0.3, 0.3)] * 2,
    *[st.floats(-0.01, 0.01)] * 2,
    *[small] * 4,
    *[st.floats(-0.01, 0.01)] * 4,
    small,
    small,
)
STEP = 1e-6


@given(LENSES, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_slopes_are_the_lenss_own_differences(lens: tuple[float, ...], x: float, y: float) -> None:
    coefficients, at = np.array(lens), np.array([[x, y]])
    found = np.array(slopes(at, coefficients)).reshape(2, 2)
    for axis, step in enumerate(np.eye(2) * STEP):
        ahead, behind = distorted(at + step, coefficients), distorted(at - step, coefficients)
        assert found[:, axis] == pytest.approx((ahead - behind)[0] / (2 * STEP), abs=1e-8)


@given(LENSES, st.integers(1, 40))
def test_there_and_back_again(lens: tuple[float, ...], points: int) -> None:
    at = np.random.default_rng(points).uniform(-0.3, 0.3, (points, 2))
    back = undistorted(distorted(at, np.array(lens)), np.array(lens))
    assert np.abs(back - at).max() < 1e-9


def test_beyond_the_fold_nothing_is_found_and_the_others_are() -> None:
    strong = np.array([-0.9, 0.0, 0.0, 0.0])
    farthest = distorted(np.array([[0.608, 0.0]]), strong)[0, 0]  # 1 − 2.7 r² = 0
    back = undistorted(np.array([[farthest + 0.01, 0.0], [0.1, 0.05]]), strong)
    assert np.isnan(back[0]).all()
    assert distorted(back[1:], strong)[0] == pytest.approx([0.1, 0.05], abs=1e-9)


def test_the_compiled_model_is_the_same(rng) -> None:
    """Places, their inverse, and derivatives by place and coefficients of `roemetry_kernels.lens`."""
    lens = np.array([-0.28, 0.11, 0.001, -0.001, -0.02, 0.01, 0.02, 0.003])
    xy = rng.uniform(-0.5, 0.5, (200, 2))
    seen, by_place, by_lens = distort_places(xy, lens)
    np.testing.assert_allclose(seen, distorted(xy, lens), rtol=0, atol=1e-15)
    np.testing.assert_allclose(undistort_places(seen, lens, seen), xy, rtol=0, atol=1e-14)
    exact = np.stack(slopes(xy, lens), axis=1).reshape(-1, 2, 2)
    np.testing.assert_allclose(by_place, exact, rtol=0, atol=1e-14)
    for number in range(8):
        step = 1e-6 * (np.arange(8) == number)
        slope = (distorted(xy, lens + step) - distorted(xy, lens - step)) / 2e-6
        np.testing.assert_allclose(by_lens[:, :, number], slope, rtol=0, atol=1e-9)
