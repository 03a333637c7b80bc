"""Lens, line width, light below the surface, focus, full well: each against its formula."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.config.scene import Scene
from roemetry_simulate.optics import Focus, blur_sigma_px, defocused, depths_mm, fan_through, looking_down
from roemetry_simulate.ray_caster import stripe_centres
from roemetry_simulate.render import Rig, Sensor, expose, laser_light
from roemetry_simulate.scene import RayCasterOptions, rig_of
from roemetry_simulate.solid import Block, Body, EmptyBelt
from roemetry_simulate.surface import even

HERRING_ROE = Path(__file__).parents[3] / "recipes" / "herring_roe"
LENS = (-0.21, 0.08, 0.002, -0.0015, 0.01)
CAMERA = looking_down(
    160, 30, pixel_size_mm=0.04, focal_length_mm=16.0, distance_mm=320.0, tilt_x_deg=1.0, tilt_y_deg=-0.4
)
BENT = replace(CAMERA, distortion=LENS)
PROJECTOR = (160.0, -4.0, 300.0)


def test_the_lens_distorts_as_opencv_s_does():
    points = np.array([[-40.0, 3.0, 0.0], [55.0, -8.0, 12.0], [0.0, 0.0, 5.0]])
    to_camera = np.linalg.inv(BENT.T_belt_camera)
    rotation, _ = cv2.Rodrigues(to_camera[:3, :3])
    f, (cx, cy) = BENT.focal_length_px, BENT.principal_px
    matrix = np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
    expected, _ = cv2.projectPoints(points, rotation, to_camera[:3, 3], matrix, np.array(LENS))
    np.testing.assert_allclose(BENT.project(points), expected.reshape(-1, 2), rtol=0, atol=1e-9)


def test_rays_and_stripe_truth_see_through_the_distortion():
    x, y = np.meshgrid(np.linspace(0, 159, 9), np.linspace(0, 29, 5))
    np.testing.assert_allclose(
        BENT.project(BENT.centre_mm + 250 * BENT.ray(x, y)), np.stack([x, y], -1), atol=1e-9
    )
    laser = fan_through(PROJECTOR, [-40.0, 1.0, 43.0], yaw_deg=0.6, sigma_mm=0.5, peak_grey=200.0)
    truth = stripe_centres(BENT, laser, Block(200.0, 4.0, 9.0))
    straight = stripe_centres(CAMERA, laser, Block(200.0, 4.0, 9.0))
    assert np.nanmax(np.abs(truth.x_px - straight.x_px)) > 0.25
    seen = truth.on_product >= 0
    stripe, row = np.nonzero(seen)
    points = truth.xyz_mm[seen]
    assert (truth.on_product == 1).sum() > 10
    assert np.abs(laser.distance_mm(points)[np.arange(stripe.size), stripe]).max() < 1e-6
    expected = np.column_stack([truth.x_px[seen], row])
    np.testing.assert_allclose(BENT.project(points), expected, rtol=0, atol=1e-6)
    # and the image agrees with it
    light, _ = laser_light(Rig(BENT, Sensor(), laser), EmptyBelt(), even())
    belt = stripe_centres(BENT, laser, EmptyBelt())
    near = np.arange(-7, 8)
    for i in range(3):
        middle = np.rint(belt.x_px[i]).astype(int)
        window = light[np.arange(30)[:, None], middle[:, None] + near]
        centroid = middle + window @ near / window.sum(axis=1)
        assert np.median(np.abs(centroid - belt.x_px[i])) < 0.02


def test_a_line_widens_away_from_its_waist_and_keeps_its_light():
    def profile(waist_mm, divergence_mrad):
        laser = replace(
            fan_through((0.0, 0.0, 300.0), [0.0], sigma_mm=0.6, peak_grey=200.0),
            waist_distance_mm=waist_mm,
            divergence_mrad=divergence_mrad,
        )
        camera = looking_down(200, 3, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0)
        return laser_light(Rig(camera, Sensor(), laser), EmptyBelt(), even())[0][1]

    def sigma_mm(row):
        x = 0.2 * np.arange(row.size)
        return np.sqrt(row @ (x - row @ x / row.sum()) ** 2 / row.sum())

    at_waist, beyond = profile(300.0, 10.0), profile(200.0, 10.0)
    assert sigma_mm(at_waist) == pytest.approx(0.6, rel=0.01)
    assert sigma_mm(beyond) == pytest.approx(np.hypot(0.6, 1.0), rel=0.01)
    assert beyond.sum() == pytest.approx(at_waist.sum(), rel=0.01)


def test_light_from_below_the_surface_is_shifted_away_from_the_laser():
    laser = fan_through((160.0, 0.0, 300.0), [0.0], sigma_mm=0.3, peak_grey=200.0)
    rig = Rig(
        looking_down(160, 5, pixel_size_mm=0.01, focal_length_mm=16.0, distance_mm=320.0), Sensor(), laser
    )
    block = Block(60.0, 30.0, 5.0)
    depth_mm = 0.8
    hard = laser_light(rig, block, even())[0][2]
    soft = laser_light(rig, block, replace(even(), below=(1.0, depth_mm, 0.5)))[0][2]
    x = np.arange(160.0)
    moved_px = soft @ x / soft.sum() - hard @ x / hard.sum()
    towards = laser.normals[0]
    # the plane moves down by the depth: on a level surface that is a move in X
    expected_mm = depth_mm * towards[2] / towards[0]
    assert moved_px == pytest.approx(expected_mm * 1600.0 / 315.0, abs=0.05)
    assert moved_px < 0.0  # the laser stands on the right
    assert soft.sum() == pytest.approx(hard.sum(), rel=0.02)


def test_blur_grows_away_from_the_focus_as_the_thin_lens_says():
    focus = Focus(distance_mm=320.0, f_number=2.8)
    circle_px = 16.0 / 2.8 * 16.0 / (320.0 - 16.0) * (20.0 / 300.0) / 0.01
    assert blur_sigma_px(CAMERA, focus, np.array([320.0]))[0] == 0.0
    fine = replace(CAMERA, pixel_size_mm=0.01)
    assert blur_sigma_px(fine, focus, np.array([300.0]))[0] == pytest.approx(circle_px / 4.0, rel=1e-6)
    depth = depths_mm(CAMERA, Block(60.0, 4.0, 20.0))
    assert depth.min() == pytest.approx(300.0, abs=1.5)
    light = np.zeros((30, 160))
    light[:, ::16] = 100.0
    soft = defocused(light, replace(fine, distortion=LENS), Focus(320.0, 1.4), depth)
    assert soft.sum() == pytest.approx(light.sum(), rel=0.1)
    assert soft[15, 80] < 0.8 * soft[2, 80]


def test_a_full_well_and_the_bits_end_the_range():
    bright = np.full((40, 40), 3000.0)
    sensor = Sensor(grey_per_electron=0.5, bit_depth=12, full_well_e=4000.0, black_level_grey=10.0)
    grey = expose(bright, 0 * bright, sensor, 1)
    assert grey.dtype == np.uint16
    assert np.median(grey) == 2010
    endless = replace(sensor, full_well_e=np.inf, black_level_grey=3000.0)
    assert (expose(bright, 0 * bright, endless, 1) == 4095).all()
    assert (expose(0 * bright, bright, Sensor(), 1) == 255).all()


def test_the_default_scene_is_the_herring_roe_rig():
    rig, known = rig_of(RayCasterOptions()), rig_of(Scene.load(HERRING_ROE).simulator.options)
    np.testing.assert_allclose(rig.camera.T_belt_camera, known.camera.T_belt_camera, rtol=0, atol=0)
    assert rig.sensor == known.sensor
    assert rig.laser.peak_grey.mean() == pytest.approx(370.0, rel=0.02)
    assert rig.laser.sigma_mm == known.laser.sigma_mm
    assert (rig.ambient_grey, rig.plain_grey) == pytest.approx((14.0, 210.0))
    assert isinstance(EmptyBelt().body(), Body)
