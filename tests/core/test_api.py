"""A recipe in a program: over files, over arrays, given as a dictionary."""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry import Recipe, RoemetryError, run_recipe
from roemetry.errors import DataError
from roemetry.io.yaml_source import read
from roemetry.records import Acquisition, Frame, Sensor
from roemetry.run.preprocess import prepare, prepare_plain
from roemetry.run.record import read_record

SHIPPED = Path(__file__).resolve().parents[2] / "recipes" / "herring_roe"


def test_a_program_measures_arrays_files_and_dictionaries_as_a_run_does(
    line: Callable[..., Path], tmp_path: Path
) -> None:
    path = line()
    recipe, given = Recipe.load(path), Recipe.of(read(path).data, folder=path.parent)
    assert given.sha256 == recipe.sha256 == pickle.loads(pickle.dumps(recipe)).sha256
    run_recipe(recipe, tmp_path / "out")
    rows = [row.to_json() for row in read_record(tmp_path / "out")]
    assert len(rows) == 3
    assert [row.to_json() for row in recipe.run(jobs=2)] == rows
    assert [row.to_json() for row in given.run()] == rows
    for image, expected in zip(sorted(recipe.source_path.glob("*.png")), map(json.loads, rows), strict=True):
        pixels = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
        (row,) = (json.loads(row.to_json()) for row in recipe.measure(pixels, name=image.stem))
        assert row.pop("provenance").items() <= expected.pop("provenance").items()
        assert row == expected
    trace = recipe.trace(pixels, name="first")
    assert (trace.acquisition_id, trace.peaks is None, trace.profiles is None) == ("first", False, False)


UNGUARDED = """
import operator
from roemetry.run.executors import Processes
print(list(Processes(2).in_order(operator.attrgetter, ("real",), (1, 2, 3))))
"""


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED, encoding="utf-8")
    ran = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert ran.stderr.count("Traceback") == 1
    assert (
        'what the script does, not its imports and functions, under `if __name__ == "__main__":`'
        in ran.stderr
    )


@pytest.mark.parametrize(
    ("pixels", "says"),
    [
        ([[1, 2], [3, 4]], "int64, expected uint8 or uint16"),
        ([[1, 2], [3]], "the laser image is no array"),
    ],
)
def test_what_is_no_image_is_refused(line, pixels, says: str) -> None:
    recipe = Recipe.load(line())
    with pytest.raises(DataError, match=says):
        recipe.measure(pixels)
    (row,) = recipe.measure(np.zeros((24, 32), dtype=np.uint8))
    assert (row.status, row.reasons[0].code) == ("failed", "other-camera")


def test_a_fault_of_a_dictionary_names_its_keys() -> None:
    stages = {"extractor": "no-such"}
    with pytest.raises(
        RoemetryError, match="^the recipe: stages.extractor.use: there is no extractor `no-such`"
    ):
        Recipe.of({"roemetry": 1, "product": "x", "source": {"path": "."}, "stages": stages})


EXACT = (
    "stages.extractor={use: gaussian}",
    "source.sensor={gain_grey_per_electron: 0.0255, read_noise_grey: 1.0}",
    f"calibration={SHIPPED}/calibration_with_outline.yaml",  # of a block no interval is stated
    "stages.triangulator=pinhole-plane",
    "stages.volume=slice-pchip",
)


@pytest.mark.parametrize(
    ("sets", "stated", "interval", "code"),
    [
        ((*EXACT, "draws=0"), True, False, "model-error-only"),
        ((*EXACT, "draws=40"), True, True, ""),
        # a guard band would be made of a part, and the block's scale is off by more than all parts together
        (("stages.volume=slice-pchip",), False, False, "calibration-model-not-stated"),
        (("stages.volume=zero-order-hold",), False, False, ""),
    ],
)
def test_no_part_of_an_uncertainty_stands_for_the_whole(
    sets, stated: bool, interval: bool, code: str
) -> None:
    (row,) = Recipe.load(SHIPPED, sets=[*sets, f"source.path={SHIPPED}/images/skein_01.png"]).run()
    visible, codes = row.volume.visible_mm3, {reason.code for reason in row.volume.reasons}
    assert (math.isfinite(visible.std), math.isfinite(visible.interval[0])) == (stated, interval)
    assert codes & {"model-error-only", "calibration-model-not-stated"} == {code} - {""}
    assert bool(visible.budget) or "zero-order-hold" in sets[-1]


PICTURE = np.arange(12, dtype=np.uint8).reshape(3, 4)


def acquisition(**frames: np.ndarray) -> Acquisition:
    return Acquisition("a", tuple(Frame(pixels, role=role) for role, pixels in frames.items()))


def ready(given: Acquisition, channel: str = "grey", turn_deg: int = 0, subtract: str = "none") -> Frame:
    return prepare(given, channel=channel, turn_deg=turn_deg, subtract=subtract)


def test_contrast_takes_off_lamp_light_of_any_brightness_and_keeps_clipped_light(rng) -> None:
    x = np.arange(120)
    lamp = np.where(x // 20 % 2, 150.0, 30.0) * rng.uniform(0.8, 1.0, (80, 1))  # print in uneven light
    line = np.exp(-0.5 * ((x - 60.0) / 2.0) ** 2)[None]
    colours = np.stack([0.7 * lamp + 20.0 * line, 0.9 * lamp + 60.0 * line, 0.8 * lamp], axis=2)
    colours[40:, :, 1] += 400.0 * line  # overexposed
    colours = np.clip(np.rint(colours + rng.normal(0.0, 1.0, colours.shape)), 0, 255).astype(np.uint8)
    seen = prepare(acquisition(laser=colours), contrast="green", turn_deg=0, subtract="none").pixels
    beside = np.abs(x - 60) > 10
    assert seen[:, beside].max() < 16
    assert np.median(np.abs(seen[:40].argmax(axis=1) - 60)) <= 1
    assert (seen[colours[:, :, 1] == 255] == 255).all()


@pytest.mark.parametrize("turn_deg", [0, 90])
def test_contrast_tells_an_overexposed_core_from_a_lamp_by_what_is_beside_it(turn_deg, rng) -> None:
    """Both are white in all channels; the core has the laser's red on both sides, the lamp has not."""
    red = np.full((80, 200), 1.0) * np.linspace(60.0, 170.0, 80)[:, None]
    others = red.copy()
    away = np.abs(np.arange(200) - 60.0)
    red += 200.0 * np.exp(-0.5 * (away / 8.0) ** 2)
    others += 150.0 * np.exp(-0.5 * (away / 3.0) ** 2)
    red[10:70, 140:170] = others[10:70, 140:170] = 260.0
    picture = np.stack([others, others, red], axis=2) + rng.normal(0.0, 1.0, (80, 200, 3))
    picture = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    turned = np.ascontiguousarray(np.rot90(picture, -turn_deg // 90))
    frame = prepare(acquisition(laser=turned), contrast="red", turn_deg=turn_deg, subtract="none")
    assert frame.pixels[40:, 56:65].min() > 200
    assert frame.pixels[:, 141:169].max() < 80


def test_a_spot_of_glare_does_not_change_the_contrast_of_lines(rng) -> None:
    picture = np.full((400, 400, 3), 40.0) + rng.normal(0.0, 1.0, (400, 400, 3))
    picture[:, 50::100, 2] += 45.0  # four lines, far from clipped
    plain = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    glare = plain.copy()
    glare[200:204, 300:306] = (200, 200, 255)
    seen, spoilt = (
        prepare(acquisition(laser=one), contrast="red", turn_deg=0, subtract="none").pixels
        for one in (plain, glare)
    )
    lines = np.s_[:, 50::100]
    assert np.median(spoilt[lines]) == pytest.approx(np.median(seen[lines]), abs=1.0), "grey levels"
    assert np.median(seen[lines]) > 40


@pytest.mark.parametrize("black_right", [False, True])
def test_contrast_finds_a_core_whose_halo_is_cut_by_dark_print(black_right, rng) -> None:
    """The halo clips red on white print and not on black: the middle of what is clipped is not the core's."""
    away = np.arange(200) - 100.0
    halo, core = np.exp(-0.5 * (away / 12.0) ** 2), np.exp(-0.5 * (away / 3.0) ** 2)
    black = (away > 5.0) & black_right  # print that is black to the eye reflects some red
    red = np.where(black, 0.3, 1.0) * (150.0 + 400.0 * halo + 2000.0 * core)
    others = np.where(black, 0.03, 1.0) * (140.0 + 20.0 * halo + 250.0 * core)
    picture = np.stack([others, others, red], axis=1)[None] + rng.normal(0.0, 1.0, (60, 200, 3))
    picture[:, 150:180] = rng.uniform(30.0, 200.0, (60, 30, 1))  # so that lamp light is seen in all strengths
    picture = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    pixels = prepare(acquisition(laser=picture), contrast="red", turn_deg=0, subtract="none").pixels
    clipped = np.flatnonzero(picture[30, :, 2] == 255)
    assert abs(clipped.mean() - 100.0) > 3.0 or not black_right
    high = [np.flatnonzero(row > 0.75 * row.max()) for row in pixels.astype(float)]
    middles = np.array([0.5 * (one[0] + one[-1]) for one in high])
    assert np.abs(middles - 100.0).max() <= 2.0


def test_contrast_keeps_its_grey_levels_where_cores_are_found(rng) -> None:
    """A red mark is in both; an overexposed core is in the laser image alone."""
    dark = np.full((60, 200, 3), 40.0) * rng.uniform(1.0, 4.0, (60, 1, 1))
    dark[:, 20:50, :2] = 40.0
    dark[:, 20:50, 2] = 200.0
    away = np.arange(200) - 120.0
    halo, core = np.exp(-0.5 * (away / 12.0) ** 2), np.exp(-0.5 * (away / 3.0) ** 2)
    light = np.stack([200.0 * core, 200.0 * core, 300.0 * halo + 1500.0 * core], axis=1)[None]
    light[:, 34:37, 2] += 40.0  # a faint line on the mark
    laser, off = (
        np.clip(np.rint(one + rng.normal(0.0, 1.0, dark.shape)), 0, 255).astype(np.uint8)
        for one in (dark + light, dark)
    )
    alone, less = (
        prepare(acquisition(laser=laser, dark=off), contrast="red", turn_deg=0, subtract=how).pixels
        for how in ("none", "dark")
    )
    assert 120 < np.median(alone[:, 25:45]) < 200, "the mark's contrast, as without a core"
    assert np.delete(less[:, 25:45], [9, 10, 11], axis=1).max() < 15
    assert less[:, 34:37].min() > 8
    assert less.max() > 400, "a core is above white"
    assert less[:, 119:122].min() > 200


def test_a_turn_is_a_rotation_counter_clockwise_and_no_mirror() -> None:
    turned = ready(acquisition(laser=PICTURE), turn_deg=90)
    assert turned.pixels.tolist() == [[3, 7, 11], [2, 6, 10], [1, 5, 9], [0, 4, 8]]
    assert turned.turn_deg == 90
    again = ready(Acquisition("a", (turned,)), turn_deg=270)
    assert again.pixels.tolist() == PICTURE.tolist()
    assert again.turn_deg == 0


def test_channels_and_dark_which_never_wraps() -> None:
    colour = np.zeros((1, 2, 3), np.uint8)
    colour[0, 0] = (10, 20, 200)
    given = acquisition(laser=colour)
    grey = round(0.299 * 200 + 0.587 * 20 + 0.114 * 10)
    for channel, expected in {"red": 200, "blue": 10, "max": 200, "grey": grey}.items():
        assert ready(given, channel).pixels[0, 0] == expected
    frame = ready(acquisition(laser=PICTURE, dark=np.full((3, 4), 5, np.uint8)), subtract="dark")
    assert frame.pixels.tolist() == np.maximum(PICTURE.astype(int) - 5, 0).tolist()
    for wrong, says in (
        (acquisition(plain=PICTURE), "no laser image"),
        (acquisition(laser=PICTURE), "no dark image"),
        (acquisition(laser=PICTURE, dark=PICTURE.T.copy()), "the dark image is"),
    ):
        with pytest.raises(DataError, match=says):
            ready(wrong, subtract="dark")


def test_the_plain_image_is_turned_alike_and_keeps_its_colours() -> None:
    colour = np.zeros((3, 4, 3), np.uint8)
    colour[0, 3] = (1, 2, 3)
    plain = prepare_plain(acquisition(laser=PICTURE, plain=colour), turn_deg=90)
    assert (plain.pixels[0, 0].tolist(), plain.turn_deg) == ([1, 2, 3], 90)
    assert prepare_plain(acquisition(laser=PICTURE), turn_deg=90) is None


def test_a_stated_sensor_goes_before_the_sources() -> None:
    stated = Sensor(0.02, 1.5)
    frame = Frame(PICTURE, sensor=Sensor(0.5, 0.5))
    given = Acquisition("a", (frame,))
    assert prepare(given, channel="grey", turn_deg=0, subtract="none", sensor=stated).sensor == stated
    assert ready(given).sensor == frame.sensor
    with pytest.raises(DataError, match="gain_grey_per_electron is 0"):
        Sensor(0.0, 1.0)
