"""What a scene puts on belt and product: dirt, patches, wet places, pictures, dead planes, many products."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError
from roemetry.records import Simulated

QUIET_CAMERA = {"read_noise_e": 0.0, "blur_sigma_px": 0.0}
QUIET = {"speckle_contrast": 0.0}
CUBE = "\n".join(
    [
        *(f"v {x} {y} {z}" for z in (0, 10) for y in (-12, 12) for x in (-20, 20)),
        "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n",
    ]
)


@pytest.fixture
def quiet(scene) -> Callable[..., Scene]:
    """A scene without noise."""
    return lambda camera=(), **told: scene(
        camera={**QUIET_CAMERA, **dict(camera)}, **{"laser": QUIET, **told}
    )


@pytest.fixture
def made(quiet) -> Callable[..., Simulated]:
    return lambda **options: quiet(**options).make().simulate(0, 3)


def image(simulated: Simulated, role: str) -> np.ndarray:
    return next(frame.pixels for frame in simulated.frames if frame.role == role).astype(float)


def test_dirt_and_patches_darken_the_belt_and_leave_the_truth(made) -> None:
    clean = made(product={"family": "none"}, light={"images": ["laser", "plain"]})
    patch = {"x_mm": [-70, 0], "y_mm": [5, 60], "albedo": 0.0}
    dirty = made(
        product={"family": "none"},
        light={"images": ["laser", "plain"]},
        belt={"dirt": {"count": 20, "diameter_mm": [5, 8], "albedo": 0.2}, "patches": [patch]},
    )
    np.testing.assert_array_equal(clean.truth.stripes.x_px, dirty.truth.stripes.x_px)
    # the patch: upper left quarter, black in both lights (black level 4)
    assert image(dirty, "plain")[:40, :70].max() <= 4.0
    assert image(dirty, "laser")[:40, :70].max() <= 4.0
    rest = image(dirty, "plain")[60:] / image(clean, "plain")[60:]
    assert 0.03 < np.mean(rest < 0.35) < 0.2
    assert np.mean(np.abs(rest - 1.0) < 0.15) > 0.75


def test_a_dead_plane_lights_nothing_and_has_no_truth(made) -> None:
    power = [1.0] * 11
    whole = made(product={"family": "none"})
    power[4] = 0.0
    dead = made(product={"family": "none"}, laser={**QUIET, "power": power})
    x_px, known = dead.truth.stripes.x_px, whole.truth.stripes.x_px
    assert np.isnan(x_px[4]).all()
    np.testing.assert_array_equal(np.delete(x_px, 4, axis=0), np.delete(known, 4, axis=0))
    at = np.rint(known[4]).astype(int)
    assert image(whole, "laser")[np.arange(120), at].min() > 80.0
    assert image(dead, "laser")[np.arange(120), at].max() < 25.0


def test_wet_places_mirror_a_stray_lamp(made) -> None:
    light = {"images": ["dark"], "stray": {"position_mm": [-120, 60, 250], "e_per_ms": 300}}
    surface = {"gloss": 0.0, "gloss_exponent": 60}
    dull = image(made(light=light, surface=surface), "dark")
    wet = image(made(light=light, surface={**surface, "wet": {"count": 40}}), "dark")
    assert (wet - dull).max() > 20.0
    assert np.mean(wet - dull > 5.0) < 0.1
    # the lamp itself is there with and without
    assert dull.mean() > 2.0 * image(made(light={"images": ["dark"]}), "dark").mean()


@pytest.mark.parametrize("yaw", [False, True])
def test_a_picture_lies_on_a_mesh_and_turns_with_it(made, tmp_path: Path, yaw: bool) -> None:
    (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
    picture = np.full((40, 80), 255, np.uint8)
    picture[:, :40] = 0
    picture[:20, 60:] = 128
    cv2.imwrite(str(tmp_path / "map.png"), picture)
    options = {"file": "cube.obj", "turn_range_deg": 60.0 if yaw else 0.0}
    simulated = made(
        product={"family": "mesh", "options": options},
        light={"images": ["plain"]},
        surface={"texture": 0.0, "gloss": 0.0, "albedo_map": {"file": "map.png", "black": 0.1, "white": 1.0}},
        camera={"tilt_x_deg": 0.0, "tilt_y_deg": 0.0},
    )
    turn = np.deg2rad(simulated.truth.products[0].figures["yaw_deg"])
    assert (abs(turn) > 0.1) == yaw
    shown = image(simulated, "plain") - 4.0

    def grey(along: float, across: float) -> float:
        x = along * np.cos(turn) - across * np.sin(turn)
        y = along * np.sin(turn) + across * np.cos(turn)
        # 400 px focal length, top of the cube 310 mm below the camera
        return float(shown[round(59.5 - 400.0 * y / 310.0), round(79.5 + 400.0 * x / 310.0)])

    white = grey(5.0, -6.0)
    assert grey(-10.0, 0.0) / white == pytest.approx(0.1, abs=0.03)
    assert grey(15.0, -6.0) / white == pytest.approx(1.0, abs=0.08)
    assert grey(15.0, 6.0) / white == pytest.approx(0.1 + 0.9 * 128 / 255, abs=0.06)


def test_of_a_colour_picture_the_laser_sees_its_own_channel(made, tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
    cv2.imwrite(str(tmp_path / "red.png"), np.full((4, 4, 3), (0, 0, 255), np.uint8))
    on_it = {}
    for wavelength in (660.0, 532.0):
        simulated = made(
            product={"family": "mesh", "options": {"file": "cube.obj"}},
            surface={"gloss": 0.0, "albedo_map": {"file": "red.png"}},
            laser={**QUIET, "wavelength_nm": wavelength},
        )
        on_it[wavelength] = image(simulated, "laser")[50:70, 65:95].max()
    assert on_it[660.0] > 80.0
    assert on_it[532.0] < 8.0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"surface": {"albedo_map": {"file": "gone.png"}}}, "surface.albedo_map.file: there is no such file"),
        ({"surface": {"albedo_map": {"file": "text.png"}}}, "surface.albedo_map.file: not an image"),
        ({"laser": {"power": [1.0], "belt_x_mm": [3.0, 1.0], "projector_mm": [0, 0, -5]}},
         "laser.power: has 1 entries for 2|laser.belt_x_mm: must|laser.projector_mm: the"),
        ({"laser": {"planes": 2, "power": [0, 0]}}, "laser.power: every plane is dead"),
        ({"laser": {"belt_x_mm": [900.0, 910.0]}}, "laser.belt_x_mm: the laser misses"),
        ({"camera": {"focus": {"distance_mm": 10, "f_number": 4}}}, "focus.distance_mm: is not beyond"),
        ({"camera": {"distortion": {"k1": -4}}}, "camera.distortion: it folds"),
        ({"camera": {"tilt_y_deg": 79}}, "camera.tilt_y_deg: a part"),
        ({"camera": {"pixel_size_um": 10}}, "product: item 1"),
        ({"belt": {"patches": [{"x_mm": [3, 1], "y_mm": [0, 1]}]}}, "belt.patches.0.x_mm: goes from"),
        ({"targets": {"board": {"marker_mm": 9, "square_mm": 8}}}, "targets.board.marker_mm: must be less"),
        ({"product": {"items": [{"seed": 1, "options": {"density_g_per_cm3": -1}}]}},
         "product.items.0.options.density_g_per_cm3: input should be greater"),
        ({"product": {"family": "eg"}}, "product.family: there is no product family `eg`|egg"),
        ({"product": {"family": "egg", "options": {"grid_step": 0.5}}},
         "product.options.grid_step: unknown key|grid_step_mm"),
        ({"camera": {"widht_px": 64}}, "scene.yaml:|unknown key `widht_px`|width_px"),
        ({"laser": {"line_width_mm": 0}}, "laser.line_width_mm|greater than 0"),
        ({"product": {"family": "mesh", "options": {"file": "open.obj"}}}, "product.options.file"),
        ({"product": {"family": "egg", "in_frame": 30}}, "product.in_frame: item 1"),
    ],
)  # fmt: skip
def test_faults_name_the_key_that_is_wrong(quiet, tmp_path: Path, options: dict[str, Any], says: str) -> None:
    (tmp_path / "text.png").write_text("no image", encoding="utf-8")
    (tmp_path / "open.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\nf 1 2 4\n", "utf-8")
    with pytest.raises(ConfigurationError) as caught:
        quiet(**options).make()
    assert "scene.yaml:" in str(caught.value)
    for words in says.split("|"):
        assert words in str(caught.value)


def test_the_hash_of_a_scene_is_of_what_it_says(quiet, tmp_path: Path) -> None:
    plain = quiet().sha256
    assert quiet(samples=4, belt={"dirt": {"count": 0}}).sha256 == plain
    assert quiet(samples=5).sha256 != plain
    cv2.imwrite(str(tmp_path / "map.png"), np.full((4, 4), 9, np.uint8))
    one = quiet(surface={"albedo_map": {"file": "map.png"}}).sha256
    cv2.imwrite(str(tmp_path / "map.png"), np.full((4, 4), 8, np.uint8))
    assert quiet(surface={"albedo_map": {"file": "map.png"}}).sha256 != one


def test_a_data_set_keeps_the_files_its_scene_names(quiet, tmp_path: Path) -> None:
    from roemetry.run.simulate import simulate

    (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
    loaded = quiet(product={"family": "mesh", "options": {"file": "cube.obj"}})
    simulate(loaded, tmp_path / "set", count=1, calibration="none")
    again = Scene.load(tmp_path / "set")
    assert (tmp_path / "set" / "scene_files" / "cube.obj").read_text("utf-8") == CUBE
    assert again.sha256 == loaded.sha256
    again.make()


def test_stripes_across_are_stored_turned_and_calibration_images_show_a_clean_belt(quiet) -> None:
    spoiled = {"dirt": {"count": 50}, "patches": [{"x_mm": [-70, 70], "y_mm": [-60, 60]}]}
    upright, turned, dirty = quiet().make(), quiet(turn_deg=90).make(), quiet(belt=spoiled).make()
    assert (upright.turn_deg(), turned.turn_deg()) == (0, 90)
    one, other = upright.simulate(0, 3), turned.simulate(0, 3)
    # a counter-clockwise quarter turn rights it
    np.testing.assert_array_equal(np.rot90(other.frames[0].pixels), one.frames[0].pixels)
    np.testing.assert_array_equal(one.truth.stripes.x_px, other.truth.stripes.x_px)
    clean, across, shown = (stage.calibration_frames(1) for stage in (upright, turned, dirty))
    assert across["block"]["block"].pixels.shape == (160, 120)
    np.testing.assert_array_equal(shown["belt"]["belt"].pixels, clean["belt"]["belt"].pixels)
