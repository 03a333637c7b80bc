"""Disturbed images are held or refused; the nightly form is `python -m benchmarks faults`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

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
from benchmarks.kills import killed
from roemetry import Recipe
from roemetry.records import Frame, ScanLines

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
