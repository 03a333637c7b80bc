"""Small forms of the benchmarks faults, fuzz, spoil and golden."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import fuzz, golden, spoil
from benchmarks.disturbances import DISTURBANCES, OF_PLAIN, Scene, of_frames
from benchmarks.faults import (
    Case,
    against,
    draw,
    harmless,
    judged,
    main,
    measured,
    recipe_of,
    scenes_of,
    summary,
    verdicts,
)
from benchmarks.fuzz import Target, damaged, fault_of, fuzzed
from benchmarks.kills import killed
from roemetry import Recipe
from roemetry.records import Frame, ScanLines
from roemetry.testing import LinearRig
from roemetry_pinhole.conformance import calibration_of

SKEINS = "recipes/herring_roe/with_outline.yaml"


def test_no_disturbed_skein_is_measured_far_outside_its_interval(tmp_path: Path) -> None:
    asked = argparse.Namespace(recipes=[SKEINS], images=3, cases=36, seed=4700, only=(), moved=0)
    asked.jobs, asked.cluster = 1, None
    found = list(measured(asked, done=0))
    assert [case for case in found if case.verdict == "gross"] == []
    assert sum(case.lies for case in found) <= 1, verdicts(found)
    assert [case for case in found if harmless(case) and case.verdict == "refused"] == []
    assert "36 disturbed cases" in summary(found)
    draw(tmp_path / "curves.svg", found)
    assert (tmp_path / "curves.svg").read_text("utf-8").startswith("<svg xmlns")
    again = list(measured(asked, done=34))
    assert [(case.disturbance, case.size) for case in again] == [
        (case.disturbance, case.size) for case in found[34:]
    ]


@pytest.mark.parametrize(
    ("verdict", "error", "base", "base_error", "lies"),
    [
        ("held", 0.004, "held", 0.001, False),
        ("outside", 0.02, "held", 0.001, True),
        ("outside", 0.02, "refused", np.nan, True),
        ("outside", 0.02, "outside", 0.019, False),
        ("gross", 0.05, "outside", 0.019, True),
        ("refused", np.nan, "held", 0.001, False),
    ],
)
def test_a_lie_is_what_the_disturbance_is_to_blame_for(
    verdict: str, error: float, base: str, base_error: float, lies: bool
) -> None:
    case = Case("r", "s", "noise", 1.0, verdict, error, 0.01, base_verdict=base, base_error=base_error)
    assert case.lies == lies


Skeins = tuple[Recipe, list[Scene], list[Case]]
"""Recipe, scenes, and their cases undisturbed."""


@pytest.fixture(scope="module")
def skeins() -> Skeins:
    """Four skeins, two of them good and two with a dent, each with the one before."""
    recipe = recipe_of(SKEINS, Path.cwd())
    taken = list(scenes_of(recipe, 4))
    scenes = [scene._replace(other=taken[k - 1]) for k, scene in enumerate(taken)]
    return recipe, scenes, [judged(recipe, scene, scene.laser, scene.plain) for scene in scenes]


def disturbed(skeins: Skeins, name: str, size: float) -> list[Case]:
    """Measure each skein disturbed, its undisturbed case beside it."""
    recipe, scenes, bases = skeins
    return [
        against(
            judged(recipe, scene, *DISTURBANCES[name].make(scene, size, np.random.default_rng([0, k]))),
            base, SKEINS, name, size,
        )
        for k, (scene, base) in enumerate(zip(scenes, bases, strict=True))
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("plain image of another scale", 1.5),
        ("plain image of another scale", 4.0),
        ("plain image shifted", 3.0),
        ("plain image shifted", 12.0),
        ("plain image turned", 2.0),
    ],
)
def test_a_plain_image_that_contradicts_the_stripes_is_laid_over_them(
    skeins: Skeins, name: str, size: float
) -> None:
    for case in disturbed(skeins, name, size):
        assert case.verdict == "held", case
        assert abs(case.error - case.base_error) < 0.005, case


def test_the_plain_image_of_another_product_is_refused(skeins: Skeins) -> None:
    for case in disturbed(skeins, "plain image of another product", 1.0):
        assert (case.verdict, case.base_verdict) == ("refused", "held"), case


@pytest.mark.parametrize(
    ("name", "size"), [("gamma", float(np.log(2.0))), ("JPEG", 80.0), ("specks", 0.001), ("noise", 3.0)]
)
def test_a_degraded_image_holds_its_volume_and_turns_no_grade_into_another(
    skeins: Skeins, name: str, size: float
) -> None:
    for case in disturbed(skeins, name, size):
        assert case.grade in (case.base_grade, "unknown"), case
        assert case.verdict == "held", case


def test_every_disturbance_gives_images_and_the_smallest_hardly_changes_them(
    rng: np.random.Generator,
) -> None:
    image = np.clip(rng.normal(40.0, 10.0, (96, 128)), 0, 255).astype(np.uint8)
    other = Scene("b", image[::-1].copy(), image[::-1].copy(), 1.0)
    scene = Scene("a", image, image.copy(), 1.0, other)
    for name, kind in DISTURBANCES.items():
        for size in (kind.low, kind.high):
            laser, plain = kind.make(scene, size, np.random.default_rng(1))
            assert laser.shape == image.shape and plain is not None and plain.shape == image.shape, name
        if kind.harmless:
            laser, _ = kind.make(scene, kind.low, np.random.default_rng(1))
            assert np.abs(laser.astype(float) - image).mean() < 3.0, name


def test_frames_of_a_scan_are_disturbed_alike_and_by_transport_some_of_them(rng: np.random.Generator) -> None:
    frames = np.clip(rng.normal(40.0, 10.0, (40, 48, 64)), 0, 255).astype(np.uint8)
    lines = ScanLines(lambda line: Frame(frames[line]), np.arange(40.0), np.arange(40), (0, 40))
    scene = Scene("a", frames, None, 1.0, lines=lines)
    scene = scene._replace(other=scene)
    for name in DISTURBANCES.keys() - OF_PLAIN:
        disturbed, plain = of_frames(scene, name, DISTURBANCES[name].high, [1, 2])
        assert disturbed.shape == frames.shape and plain is None, name
        changed = np.array([(one != other).any() for one, other in zip(disturbed, frames, strict=True)])
        some = "frame" in name or name.startswith(("rows", "columns"))
        assert (0 < changed.sum() < 12) if some else changed.all(), name
    noise = of_frames(scene, "noise", 10.0, [1, 2])[0].astype(float) - frames
    assert abs(np.corrcoef(noise[3].ravel(), noise[4].ravel())[0, 1]) < 0.1
    shifted = of_frames(scene, "camera shifted along x", 5.0, [1, 2])[0]
    (way,) = {
        np.sign(5.0) * k for k in (-5, 5) if (shifted[:, :, 20:40] == frames[:, :, 20 - k : 40 - k]).all()
    }
    assert abs(way) == 5


def test_what_states_no_volume_is_said_in_words(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["faults", "recipes/weld_groove", "recipes/egg", "--cases", "2"])
    with pytest.raises(SystemExit, match="egg.recipe.yaml: no volume is stated of any of its scenes"):
        main()
    assert "recipes/weld_groove: it states no volume" in capsys.readouterr().err


def test_killed_runs_that_contend_for_a_folder_lose_no_row_and_double_none(tmp_path: Path) -> None:
    recipe = Recipe.load("recipes/herring_roe/recipe.yaml", sets=["sinks=[csv]", "draws=0"])
    assert killed(recipe, tmp_path, kills=6, seed=3)[0] == []


def test_five_hundred_damaged_files_neither_crash_nor_hang() -> None:
    assert fuzzed(500, seed=1) == []


def test_the_fuzzer_sees_what_it_looks_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "any"
    path.write_bytes(b"")

    def crash(_: object) -> object:
        raise KeyError("lost")

    assert fault_of(Target("sound", path, lambda _: None), path) == ""
    assert "KeyError" in fault_of(Target("crash", path, crash), path)
    monkeypatch.setattr(fuzz, "HANG_S", 0.01)
    assert "processor time" in fault_of(Target("slow", path, lambda _: sum(range(10_000_000))), path)
    monkeypatch.setattr(fuzz, "HANG_S", 60.0)
    monkeypatch.setattr(fuzz, "_peak_mb", iter((100.0, 700.0)).__next__)
    assert fault_of(Target("flood", path, lambda _: None), path) == "600 MB more memory"


def test_a_seed_makes_the_same_damage_again() -> None:
    content = bytes(range(256)) * 8
    one, other = (damaged(content, np.random.default_rng(seed)) for seed in (3, 3))
    assert one == other != content


SWAPPED = spoil.SPOILED[0]


def shots() -> spoil.Shots:
    rng = np.random.default_rng(1)
    images = {
        shows: {str(n): rng.integers(0, 255, (40, 60), np.uint8) for n in range(8)}
        for shows in ("board", "board_laser")
    }
    rig = {"stripes": 5, "board": {"name": "b", "pitch_mm": 8.0, "marker_mm": 6.0}, "images": {}}
    return spoil.Shots(rig, images)


@pytest.mark.parametrize("kind", spoil.SPOILED, ids=lambda kind: kind.name)
def test_each_kind_changes_the_rig_or_images_and_never_the_first_pose(kind: spoil.Kind) -> None:
    before, after = shots(), shots()
    kind.spoil(after, np.random.default_rng(2))
    changed = before.rig != after.rig
    for shows, images in before.images.items():
        for pose, image in images.items():
            changed |= not np.array_equal(image, after.images[shows].get(pose, np.empty(0)))
    assert changed
    if kind.name != "five poses of one plane":
        assert all(np.array_equal(before.images[one]["0"], after.images[one]["0"]) for one in before.images)


def test_a_refusal_counts_by_its_words() -> None:
    sound = calibration_of(LinearRig())
    assert spoil.judged(SWAPPED, "the poses contradict each other", sound, ["3"]).word == "refused"
    assert spoil.judged(SWAPPED, "it is too dark", sound, ["3"]).word == "other words"
    assert spoil.judged(spoil.SOUND[0], "it is too dark", sound, []).word == "refused"


def test_what_is_accepted_counts_by_what_is_told_and_by_its_heights() -> None:
    sound = calibration_of(LinearRig())
    wrong = replace(sound, parameters=sound.parameters | {"focal_px": 1.1 * sound.parameters["focal_px"]})
    assert spoil.judged(SWAPPED, (sound, ""), sound, ["3"]).word == "harmless"
    assert spoil.judged(SWAPPED, (wrong, ""), sound, ["3"]).word == "missed"
    assert spoil.judged(spoil.SOUND[0], (wrong, ""), sound, []).word == "missed"
    told = replace(wrong, notes=("not used: on_3.png: too dark", "not used: on_5.png: too dark"))
    assert spoil.judged(SWAPPED, (told, ""), sound, ["3", "5"]).word == "reported"
    assert spoil.judged(SWAPPED, (told, ""), sound, ["3", "6"]).word == "missed"
    # what is told of the sound set as well tells nobody anything
    always = replace(sound, notes=("stripes and board corners contradict each other",))
    assert spoil.judged(SWAPPED, (replace(wrong, notes=always.notes), ""), always, ["3"]).word == "missed"


def test_two_boards_are_written_with_their_own_images(tmp_path: Path) -> None:
    two = shots()
    kind = next(kind for kind in spoil.SPOILED if kind.name == "second board's pitch 2 % wrong")
    kind.spoil(two, np.random.default_rng(1))
    text = spoil._written(two, tmp_path).read_text("utf-8")
    assert "more_boards" in text
    assert len(list((tmp_path / "second_board").iterdir())) == 3
    assert len(list((tmp_path / "board").iterdir())) == 5


@pytest.mark.parametrize("name", golden.RECIPES)
def test_a_shipped_recipe_says_what_it_said(name: str) -> None:
    """`python -m benchmarks golden --write` writes them anew, where numbers are meant to change."""
    expected = json.loads(golden.file_of(name).read_text("utf-8"))
    found = json.loads(json.dumps(golden.records(name)))
    assert list(golden.differences(expected, found, name)) == []


def test_every_shipped_recipe_has_golden_records() -> None:
    """A new recipe is frozen, too."""
    paths = (golden.ROOT / "recipes").glob("*/*.yaml")
    recipes = {f"{p.parent.name}/{p.stem}" for p in paths if "\nstages:" in p.read_text("utf-8")}
    assert recipes == set(golden.RECIPES)


@pytest.mark.parametrize(
    ("expected", "found", "many"),
    [
        ({"a": 1.0}, {"a": 1.0 + 1e-9}, 0),
        ({"a": 1.0}, {"a": 1.0 + 1e-5}, 1),
        ({"a": None}, {"a": 1.0}, 1),
        ({"a": 1.0}, {"b": 1.0}, 2),
        (["good"], ["dent"], 1),
        ([1.0, 2.0], [1.0], 1),
    ],
)
def test_differences_are_seen(expected: object, found: object, many: int) -> None:
    """The comparison itself."""
    assert len(list(golden.differences(expected, found, "x"))) == many
