"""Pixels to rays and rays to points: lenses, planes, views; and dots on rays of light."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.errors import DataError, RecordError
from roemetry.records import Dots, Outline, Rays
from roemetry.records.light import at_height, meet
from roemetry.records.view import View, distort, distortion_jacobian, undistort
from roemetry.testing.scenes import LinearRig
from roemetry_kernels.lens import distort_places, sight_lines, undistort_places

LENSES = {
    "none": [],
    "gentle": [-0.08, 0.02, 0.0005, -0.0003],
    "strong": [-0.35, 0.15, 0.001, -0.002, -0.03],
    "rational": [0.2, -0.1, 0.0, 0.001, 0.01, 0.4, -0.05, 0.01],
    "tilted": [-0.1, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.001, 0.0, -0.001, 0.0, 0.05, -0.03],
}


def camera(lens: list[float]) -> View:
    turn, _ = cv2.Rodrigues(np.array([3.0, 0.05, -0.08]))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, (4.0, -7.0, 310.0)
    return View(
        image_size=(480, 640),
        camera_matrix=np.array([[900.0, 0, 330.0], [0, 910.0, 230.0], [0, 0, 1.0]]),
        T_belt_camera=pose,
        planes=np.array([[0.8, 0.0, -0.6, 3.0], [0.6, 0.0, -0.8, -10.0]]),
        distortion=np.array(lens),
    )


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_points_appear_where_opencv_says(lens: list[float], rng: np.random.Generator) -> None:
    view = camera(lens)
    xyz = rng.uniform([-60, -50, 0], [60, 50, 30], (200, 3))
    to_camera = np.linalg.inv(view.T_belt_camera)
    turn, _ = cv2.Rodrigues(to_camera[:3, :3])
    seen, _ = cv2.projectPoints(
        xyz, turn, to_camera[:3, 3], view.camera_matrix, np.array(lens) if lens else None
    )
    np.testing.assert_allclose(view.project(xyz), seen[:, 0], atol=1e-8)  # px


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
@pytest.mark.parametrize("telecentric", [False, True])
def test_slopes_of_places_are_differences(
    lens: list[float], telecentric: bool, rng: np.random.Generator
) -> None:
    view = replace(camera([] if telecentric else lens), telecentric=telecentric)
    xyz = rng.uniform([-60, -50, 0], [60, 50, 30], (20, 3))
    at, slopes = view.project_slopes(xyz)
    np.testing.assert_allclose(at, view.project(xyz), atol=1e-9)  # px
    step = 1e-4  # mm
    for axis in range(3):
        ahead, behind = (view.project(xyz + sign * step * np.eye(3)[axis]) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, axis].T, (ahead - behind) / (2.0 * step), atol=1e-5)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_rays_lead_back_to_the_points(lens: list[float], rng: np.random.Generator) -> None:
    view = camera(lens)
    xyz = rng.uniform([-60, -50, 0], [60, 50, 30], (50, 3))
    xy = view.project(xyz)
    np.testing.assert_allclose(view.at_height(xy, xyz[:, 2]), xyz, atol=1e-8)  # mm
    start, way = view.rays(xy)
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), 1.0, atol=1e-12)
    off = np.cross(xyz - start, way)
    np.testing.assert_allclose(off, 0.0, atol=1e-7)  # mm


def test_lifted_points_lie_on_their_planes_and_on_their_rays(rng: np.random.Generator) -> None:
    view = camera(LENSES["strong"])
    xy = rng.uniform([100, 100], [500, 400], (2, 40, 2))
    stripe = np.array([[0], [1]])
    xyz = view.lift(xy, np.broadcast_to(stripe, (2, 40)))
    planes = view.planes[:, None, :]
    np.testing.assert_allclose(
        (xyz * planes[..., :3]).sum(axis=-1), planes[..., 3] + 0 * xyz[..., 0], atol=1e-9
    )
    np.testing.assert_allclose(view.project(xyz), xy, atol=1e-8)  # px
    np.testing.assert_allclose(view.lift(xy[0], 0), xyz[0], atol=1e-12)


def test_a_telecentric_view_measures_as_the_linear_rig() -> None:
    rig = LinearRig()
    height = rig.dome()
    x_px = rig.x_px(height)
    row = np.broadcast_to(np.arange(rig.rows, dtype=float), x_px.shape)
    stripe = np.broadcast_to(np.arange(rig.stripes)[:, None], x_px.shape)
    xyz = rig.view().lift(np.stack([x_px, row], axis=-1), stripe)
    np.testing.assert_allclose(xyz, rig.xyz_mm(height), atol=1e-9)  # mm
    np.testing.assert_allclose(rig.view().project(xyz), np.stack([x_px, row], axis=-1), atol=1e-9)  # px


def test_nothing_stays_nothing() -> None:
    view = camera(LENSES["gentle"])
    start, way = view.rays(np.array([[np.nan, 10.0], [5.0, 10.0]]))
    assert np.isnan(way[0]).all()
    assert np.isnan(start[0]).all()
    assert np.isfinite(way[1]).all()
    behind = view.camera_mm + 10.0 * view.T_belt_camera[:3, 2] * -1
    assert np.isnan(view.project(behind)).all()


def test_a_view_is_stored_and_read(tmp_path) -> None:
    view = camera(LENSES["strong"])
    again = View.from_dict(view.to_dict(), view.image_size)
    for name in ("camera_matrix", "distortion", "T_belt_camera", "planes", "projector_mm"):
        np.testing.assert_array_equal(getattr(again, name), getattr(view, name))
    assert (again.telecentric, again.exact) == (False, True)


def test_nonsense_is_named() -> None:
    view = camera([])
    mirrored = view.T_belt_camera @ np.diag([-1.0, 1, 1, 1])
    with pytest.raises(DataError, match="not a rotation"):
        replace(view, T_belt_camera=mirrored)
    with pytest.raises(DataError, match="distortion has 3 numbers"):
        replace(view, distortion=np.zeros(3))
    with pytest.raises(DataError, match="not of length 1"):
        replace(view, planes=np.ones((2, 4)))


small = st.floats(-0.05, 0.05)
COEFFICIENTS = st.tuples(
    *[st.floats(-0.3, 0.3)] * 2,
    *[st.floats(-0.01, 0.01)] * 2,
    *[small] * 4,
    *[st.floats(-0.01, 0.01)] * 4,
    small,
    small,
)
STEP = 1e-6


@given(COEFFICIENTS, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_slopes_are_the_lenss_own_differences(lens: tuple[float, ...], x: float, y: float) -> None:
    coefficients, at = np.array(lens), np.array([[x, y]])
    found = np.array(distortion_jacobian(at, coefficients)).reshape(2, 2)
    for axis, step in enumerate(np.eye(2) * STEP):
        ahead, behind = distort(at + step, coefficients), distort(at - step, coefficients)
        assert found[:, axis] == pytest.approx((ahead - behind)[0] / (2 * STEP), abs=1e-8)


@given(COEFFICIENTS, st.integers(1, 40))
def test_there_and_back_again(lens: tuple[float, ...], points: int) -> None:
    at = np.random.default_rng(points).uniform(-0.3, 0.3, (points, 2))
    back = undistort(distort(at, np.array(lens)), np.array(lens))
    assert np.abs(back - at).max() < 1e-9


def test_beyond_the_fold_nothing_is_found_and_the_others_are() -> None:
    strong = np.array([-0.9, 0.0, 0.0, 0.0])
    farthest = distort(np.array([[0.608, 0.0]]), strong)[0, 0]  # 1 − 2.7 r² = 0
    back = undistort(np.array([[farthest + 0.01, 0.0], [0.1, 0.05]]), strong)
    assert np.isnan(back[0]).all()
    assert distort(back[1:], strong)[0] == pytest.approx([0.1, 0.05], abs=1e-9)


@pytest.mark.parametrize("lens", [*LENSES.values(), [-0.9, 0.0, 0.0, 0.0]], ids=[*LENSES, "folding"])
def test_compiled_lines_of_sight_are_the_views(lens: list[float], rng: np.random.Generator) -> None:
    """Of an outline, whichever way its lens is undone; none beyond a fold."""
    view, xy_px = camera(lens), rng.uniform([-200.0, -200.0], [840.0, 680.0], (200, 2))
    for ours, exact in zip(sight_lines(view, Outline(1, xy_px)), view.rays(xy_px), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-12)
    assert np.isnan(exact).any() == (lens[:1] == [-0.9])


def test_the_compiled_lens_is_the_same(rng: np.random.Generator) -> None:
    """Places, their inverse, and derivatives by place and coefficients of `roemetry_kernels.lens`."""
    lens = np.array([-0.28, 0.11, 0.001, -0.001, -0.02, 0.01, 0.02, 0.003])
    xy = rng.uniform(-0.5, 0.5, (200, 2))
    seen, by_place, by_lens = distort_places(xy, lens)
    np.testing.assert_allclose(seen, distort(xy, lens), rtol=0, atol=1e-15)
    np.testing.assert_allclose(undistort_places(seen, lens, seen), xy, rtol=0, atol=1e-14)
    exact = np.stack(distortion_jacobian(xy, lens), axis=1).reshape(-1, 2, 2)
    np.testing.assert_allclose(by_place, exact, rtol=0, atol=1e-14)
    for number in range(8):
        step = 1e-6 * (np.arange(8) == number)
        slope = (distort(xy, lens + step) - distort(xy, lens - step)) / 2e-6
        np.testing.assert_allclose(by_lens[:, :, number], slope, rtol=0, atol=1e-9)


def camera_above(k1: float = 0.05) -> View:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 320.0
    matrix = np.array([[1600.0, 0.0, 319.5], [0.0, 1600.0, 239.5], [0.0, 0.0, 1.0]])
    return View((480, 640), matrix, pose, np.empty((0, 4)), distortion=np.array([k1, -0.1, 0.0, 0.0]))


@given(
    st.floats(-45.0, 45.0), st.floats(-35.0, 35.0), st.floats(0.2, 0.9), st.floats(-0.4, 0.4),
    st.floats(-2.0, 40.0), st.floats(-0.2, 0.2),
)  # fmt: skip
def test_a_dot_of_a_ray_has_its_height(x: float, y: float, sx: float, sy: float, z: float, k1: float) -> None:
    lines, view = np.array([[x, y, sx, sy]]), camera_above(k1)
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
    seen = camera_above().project(at_height(lines, 12.0)) + rng.multivariate_normal([0, 0], covariance, 4000)
    met = meet(camera_above(), lines, seen, np.tile(covariance, (4000, 1, 1)))
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
