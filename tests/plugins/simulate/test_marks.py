"""What a scene puts on belt and product: dirt, patches, wet places, pictures, dead planes, many products."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError
from roemetry.io.yaml_source import dump
from roemetry.records import Simulated

SMALL = {"width_px": 160, "height_px": 120, "pixel_size_um": 40, "read_noise_e": 0.0, "blur_sigma_px": 0.0}
QUIET = {"speckle_contrast": 0.0}
CUBE = "\n".join(
    [
        *(f"v {x} {y} {z}" for z in (0, 10) for y in (-12, 12) for x in (-20, 20)),
        "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n",
    ]
)


def scene(folder: Path, **options: Any) -> Scene:
    told = {
        "roemetry_scene": 1,
        "name": "trial",
        "licence": "CC0-1.0",
        "simulator": {"use": "ray-caster", "options": {"camera": SMALL, "laser": QUIET, **options}},
    }
    (folder / "scene.yaml").write_text(dump(told), encoding="utf-8")
    return Scene.load(folder)


def made(folder: Path, **options: Any) -> Simulated:
    return scene(folder, **options).make().simulate(0, 3)


def image(simulated: Simulated, role: str) -> np.ndarray:
    return next(frame.pixels for frame in simulated.frames if frame.role == role).astype(float)


def faults(folder: Path, **options: Any) -> str:
    with pytest.raises(ConfigurationError) as caught:
        scene(folder, **options).make()
    return str(caught.value)


def test_dirt_and_patches_darken_the_belt_and_leave_the_truth(tmp_path: Path) -> None:
    clean = made(tmp_path, product={"family": "none"}, light={"images": ["laser", "plain"]})
    patch = {"x_mm": [-70, 0], "y_mm": [5, 60], "albedo": 0.0}
    dirty = made(
        tmp_path,
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


def test_calibration_images_show_a_clean_whole_belt(tmp_path: Path) -> None:
    spoiled = {"dirt": {"count": 50}, "patches": [{"x_mm": [-70, 70], "y_mm": [-60, 60]}]}
    clean = scene(tmp_path).make().calibration_frames(1)["belt"]["belt"].pixels
    np.testing.assert_array_equal(
        scene(tmp_path, belt=spoiled).make().calibration_frames(1)["belt"]["belt"].pixels, clean
    )


def test_a_dead_plane_lights_nothing_and_has_no_truth(tmp_path: Path) -> None:
    power = [1.0] * 11
    whole = made(tmp_path, product={"family": "none"})
    power[4] = 0.0
    dead = made(tmp_path, product={"family": "none"}, laser={**QUIET, "power": power})
    x_px, known = dead.truth.stripes.x_px, whole.truth.stripes.x_px
    assert np.isnan(x_px[4]).all()
    np.testing.assert_array_equal(np.delete(x_px, 4, axis=0), np.delete(known, 4, axis=0))
    at = np.rint(known[4]).astype(int)
    assert image(whole, "laser")[np.arange(120), at].min() > 80.0
    assert image(dead, "laser")[np.arange(120), at].max() < 25.0


def test_wet_places_mirror_a_stray_lamp(tmp_path: Path) -> None:
    light = {"images": ["dark"], "stray": {"position_mm": [-120, 60, 250], "e_per_ms": 300}}
    surface = {"gloss": 0.0, "gloss_exponent": 60}
    dull = image(made(tmp_path, light=light, surface=surface), "dark")
    wet = image(made(tmp_path, light=light, surface={**surface, "wet": {"count": 40}}), "dark")
    assert (wet - dull).max() > 20.0
    assert np.mean(wet - dull > 5.0) < 0.1
    # the lamp itself is there with and without
    assert dull.mean() > 2.0 * image(made(tmp_path, light={"images": ["dark"]}), "dark").mean()


@pytest.mark.parametrize("yaw", [False, True])
def test_a_picture_lies_on_a_mesh_and_turns_with_it(tmp_path: Path, yaw: bool) -> None:
    (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
    picture = np.full((40, 80), 255, np.uint8)
    picture[:, :40] = 0
    picture[:20, 60:] = 128
    cv2.imwrite(str(tmp_path / "map.png"), picture)
    options = {"file": "cube.obj", "turn_range_deg": 60.0 if yaw else 0.0}
    simulated = made(
        tmp_path,
        product={"family": "mesh", "options": options},
        light={"images": ["plain"]},
        surface={"texture": 0.0, "gloss": 0.0, "albedo_map": {"file": "map.png", "black": 0.1, "white": 1.0}},
        camera={**SMALL, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0},
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


def test_of_a_colour_picture_the_laser_sees_its_own_channel(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
    cv2.imwrite(str(tmp_path / "red.png"), np.full((4, 4, 3), (0, 0, 255), np.uint8))
    on_it = {}
    for wavelength in (660.0, 532.0):
        simulated = made(
            tmp_path,
            product={"family": "mesh", "options": {"file": "cube.obj"}},
            surface={"gloss": 0.0, "albedo_map": {"file": "red.png"}},
            laser={**QUIET, "wavelength_nm": wavelength},
        )
        on_it[wavelength] = image(simulated, "laser")[50:70, 65:95].max()
    assert on_it[660.0] > 80.0
    assert on_it[532.0] < 8.0


def test_faults_name_the_key_that_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no image", encoding="utf-8")
    said = faults(tmp_path, surface={"albedo_map": {"file": "gone.png"}})
    assert "scene.yaml:" in said
    assert "surface.albedo_map.file: there is no such file" in said
    said = faults(tmp_path, surface={"albedo_map": {"file": "text.png"}})
    assert "surface.albedo_map.file: not an image" in said
    said = faults(tmp_path, laser={"power": [1.0], "belt_x_mm": [3.0, 1.0], "projector_mm": [0, 0, -5]})
    for word in ("laser.power: has 1 entries for 2", "laser.belt_x_mm: must", "laser.projector_mm: the"):
        assert word in said
    assert "laser.power: every plane is dead" in faults(tmp_path, laser={"planes": 2, "power": [0, 0]})
    assert "laser.belt_x_mm: the laser misses" in faults(tmp_path, laser={"belt_x_mm": [900.0, 910.0]})
    said = faults(tmp_path, camera={"focus": {"distance_mm": 10, "f_number": 4}})
    assert "camera.focus.distance_mm: is not beyond" in said
    assert "camera.distortion: it folds" in faults(tmp_path, camera={**SMALL, "distortion": {"k1": -4}})
    assert "camera.tilt_y_deg: a part" in faults(tmp_path, camera={"tilt_y_deg": 79})
    assert "belt.patches.0.x_mm: goes from" in faults(
        tmp_path, belt={"patches": [{"x_mm": [3, 1], "y_mm": [0, 1]}]}
    )
    assert "targets.board.marker_mm: must be less" in faults(
        tmp_path, targets={"board": {"marker_mm": 9, "square_mm": 8}}
    )
    said = faults(tmp_path, product={"items": [{"seed": 1, "options": {"density_g_per_cm3": -1}}]})
    assert "product.items.0.options.density_g_per_cm3: input should be greater" in said
    assert "product.family: there is no product family `eg`" in faults(tmp_path, product={"family": "eg"})
    assert "product: item 1" in faults(tmp_path, camera={**SMALL, "pixel_size_um": 10})
    (tmp_path / "open.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\nf 1 2 4\n", "utf-8")
    said = faults(tmp_path, product={"family": "mesh", "options": {"file": "open.obj"}})
    assert "product.options.file" in said
    assert "product.in_frame: item 1" in faults(tmp_path, product={"family": "egg", "in_frame": 30})


def test_the_hash_of_a_scene_is_of_what_it_says(tmp_path: Path) -> None:
    plain = scene(tmp_path).sha256
    assert scene(tmp_path, samples=4, belt={"dirt": {"count": 0}}).sha256 == plain
    assert scene(tmp_path, samples=5).sha256 != plain
    cv2.imwrite(str(tmp_path / "map.png"), np.full((4, 4), 9, np.uint8))
    one = scene(tmp_path, surface={"albedo_map": {"file": "map.png"}}).sha256
    cv2.imwrite(str(tmp_path / "map.png"), np.full((4, 4), 8, np.uint8))
    assert scene(tmp_path, surface={"albedo_map": {"file": "map.png"}}).sha256 != one


def test_a_data_set_keeps_the_files_its_scene_names(tmp_path: Path) -> None:
    from roemetry.run.simulate import simulate

    (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
    loaded = scene(tmp_path, product={"family": "mesh", "options": {"file": "cube.obj"}})
    simulate(loaded, tmp_path / "set", count=1, calibration="none")
    again = Scene.load(tmp_path / "set")
    assert (tmp_path / "set" / "scene_files" / "cube.obj").read_text("utf-8") == CUBE
    assert again.sha256 == loaded.sha256
    again.make()


def test_images_of_stripes_across_are_stored_turned(tmp_path: Path) -> None:
    upright, turned = scene(tmp_path).make(), scene(tmp_path, turn_deg=90).make()
    assert (upright.turn_deg(), turned.turn_deg()) == (0, 90)
    one, other = upright.simulate(0, 3), turned.simulate(0, 3)
    # a counter-clockwise quarter turn rights it
    np.testing.assert_array_equal(np.rot90(other.frames[0].pixels), one.frames[0].pixels)
    np.testing.assert_array_equal(one.truth.stripes.x_px, other.truth.stripes.x_px)
    block = turned.calibration_frames(1)["block"]["block"].pixels
    assert block.shape == (160, 120)
