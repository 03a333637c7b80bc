"""Rendered images against geometry: where light falls, where shadows end, the same seed twice."""

import numpy as np
import pytest

from roemetry_simulate.optics import blurred, fan_through, looking_down
from roemetry_simulate.ray_caster import stripe_centres
from roemetry_simulate.render import Rig, Sensor, expose, laser_light, plain_light, render
from roemetry_simulate.solid import Block, EmptyBelt
from roemetry_simulate.surface import even, textured
from tests.plugins.simulate.gridded import on_grid

PROJECTOR = np.array([160.0, 0.0, 300.0])


def rig(width_px=160, height_px=24, *, pixel_size_mm=0.01, belt_x_mm=(-8.8, 0.0, 8.7), sigma_mm=0.31):
    laser = fan_through(PROJECTOR, belt_x_mm, yaw_deg=0.6, sigma_mm=sigma_mm, peak_grey=300.0)
    optics = {
        "pixel_size_mm": pixel_size_mm,
        "focal_length_mm": 16.0,
        "distance_mm": 320.0,
        "tilt_x_deg": 1.0,
    }
    return Rig(looking_down(width_px, height_px, **optics), Sensor(), laser)


def test_the_stripe_s_brightness_follows_plane_angle_and_albedo():
    a_rig = rig(belt_x_mm=(0.0,))
    white, _ = laser_light(a_rig, EmptyBelt(), even(1.0))
    grey, _ = laser_light(a_rig, EmptyBelt(), even(0.5))
    np.testing.assert_allclose(grey, 0.5 * white, rtol=1e-12)
    cosine = PROJECTOR[2] / np.linalg.norm(PROJECTOR)
    fine = rig(width_px=160, pixel_size_mm=0.002, belt_x_mm=(0.0,))
    peak = laser_light(fine, EmptyBelt(), even(1.0))[0].max()
    assert peak == pytest.approx(300.0 * cosine, rel=2e-3)


def test_the_shadow_behind_a_block_has_the_right_length():
    block = Block(12.0, 30.0, 8.0, centre_x_mm=6.0)
    flooded = rig(640, 5, pixel_size_mm=0.005, sigma_mm=1e4, belt_x_mm=(0.0,))
    light, _ = laser_light(flooded, block, even())
    row = light[2]
    far = -PROJECTOR[0] * block.height_mm / (PROJECTOR[2] - block.height_mm)
    begin, end = flooded.camera.project([[far, 0.0, 0.0], [0.0, 0.0, block.height_mm]])[:, 0]
    dark = np.flatnonzero(row < 0.5 * np.median(row))
    assert dark[0] == pytest.approx(begin, abs=1.0)
    assert dark[-1] == pytest.approx(end, abs=1.0)
    assert dark.size == pytest.approx(end - begin, abs=2.0)


def test_the_camera_does_not_see_behind_a_body_with_an_overhang():
    def ball(x, y):
        return 36.0 * np.maximum(1.0 - (x**2 + (y - 3.0) ** 2) / 36.0, -0.5)

    body = on_grid((-9, 9, -6, 12), 0.125, lambda x, y: 0 * x + 6.0, ball, ball)
    a_rig = rig(160, 60)
    truth = stripe_centres(a_rig.camera, a_rig.laser, body)
    on_body = truth.xyz_mm[truth.on_product == 1]
    radius = np.linalg.norm(on_body - [0.0, 3.0, 6.0], axis=1)
    np.testing.assert_allclose(radius, 6.0, atol=2e-3)
    # the ball's own shadow and its overhang hide belt points near its foot
    foot = np.linalg.norm(truth.xyz_mm[truth.on_product == 0][:, :2] - [0.0, 3.0], axis=1)
    assert foot.min() > 3.0


def test_the_same_seed_gives_the_same_bytes():
    a_rig, block = rig(), Block(20.0, 3.0, 5.0)
    surface = textured(5, laser_albedo=(0.7, 0.5), plain_albedo=(0.3, 0.6))
    first = render(a_rig, block, surface, seed=4)
    assert first.dtype == np.uint8
    assert first.tobytes() == render(a_rig, block, surface, seed=4).tobytes()
    assert first.tobytes() != render(a_rig, block, surface, seed=5).tobytes()
    plain = render(a_rig, block, surface, seed=4, plain=True, samples=2)
    assert plain.tobytes() == render(a_rig, block, surface, seed=4, plain=True, samples=2).tobytes()


def test_plain_light_is_even_and_darker_at_the_foot_of_a_block():
    surface = even()
    a_rig = rig(160, 60)
    bare = plain_light(a_rig, EmptyBelt(), surface, samples=2)
    assert bare.std() < 0.03 * bare.mean()
    with_block = plain_light(a_rig, Block(20.0, 6.0, 5.0), surface, samples=2)
    assert with_block[30, 80] == pytest.approx(bare[30, 80], rel=0.02)
    _, y = a_rig.camera.project([0.0, 3.6, 0.0])
    assert with_block[round(y), 80] < 0.95 * bare[round(y), 80]


def test_noise_has_the_sensor_s_variance():
    sensor = Sensor(psf_sigma_px=0.0, speckle_contrast=0.0)
    level = np.full((200, 200), 100.0)
    grey = expose(0 * level, level, sensor, seed=1).astype(float)
    assert grey.mean() == pytest.approx(104.0, abs=0.1)
    assert grey.var() == pytest.approx(100.0 * 0.0255 + 1.0 + 1.0 / 12.0, rel=0.05)
    speckled = expose(level, 0 * level, Sensor(psf_sigma_px=0.0, speckle_contrast=0.2), seed=1).astype(float)
    assert speckled.std() == pytest.approx(20.0, rel=0.05)


@pytest.mark.parametrize("plain", [False, True])
def test_a_draft_is_right_to_a_fraction_of_a_grey_level(plain):
    """Within the mean, everywhere but at the pixels of an edge; noise is 1 grey level and more."""
    a_rig, block = rig(240, 120), EmptyBelt() if plain else Block(20.0, 6.0, 5.0)
    take = plain_light if plain else lambda *given, **more: sum(laser_light(*given, **more))
    exact, quick = take(a_rig, block, even()), take(a_rig, block, even(), draft=True)
    off = np.abs(quick - exact)
    assert off.mean() < 0.15
    assert np.quantile(off, 0.97) < 1.0


def test_a_draft_keeps_edges_of_bodies_and_of_their_shadows():
    """As a lens of 1 px shows them: what alternates between neighbouring pixels is the lamps' own noise."""
    a_rig, block = rig(240, 120), Block(20.0, 12.0, 5.0)
    exact, quick = (plain_light(a_rig, block, even(), draft=draft) for draft in (False, True))
    off = np.abs(blurred(quick - exact, 1.0))
    assert off.mean() < 0.7
    assert off.max() < 13.0
