"""Light below the surface: lifted points stay on their planes, the fit finds what was drawn."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.calibrating import fit_penetration_in_one
from roemetry.config.recipe import Recipe
from roemetry.errors import CalibrationError, ConfigurationError, DataError
from roemetry.records import Block
from roemetry.records.penetration import Penetration, raise_surface
from roemetry.run.batch import run_recipe
from roemetry.testing.scenes import LinearRig
from roemetry_paper.block_linear import BlockLinear
from tests.command import typed

RIG = LinearRig()
LIGHT = Penetration("roe", 0.4, 0.05, "c" * 64, "block", "2026-05-01T00:00:00+00:00")


def test_points_of_products_are_lifted_and_stay_on_their_planes() -> None:
    before = BlockLinear().triangulate(RIG.stripe_map(RIG.dome()), RIG.calibration())
    after = raise_surface(before, 0.4)
    risen = after.xyz_mm[:, :, 2] - before.xyz_mm[:, :, 2]
    np.testing.assert_allclose(risen[before.product > 0], 0.4, atol=1e-12)  # mm
    np.testing.assert_array_equal(risen[before.product == 0], 0.0)
    off = np.einsum("spk,sk->sp", after.xyz_mm, after.plane[:, :3]) - after.plane[:, 3:]
    np.testing.assert_allclose(off, 0.0, atol=1e-9)  # mm


def test_a_file_comes_back(tmp_path: Path) -> None:
    LIGHT.save(tmp_path / "p.yaml")
    assert Penetration.load(tmp_path / "p.yaml") == LIGHT
    text = (tmp_path / "p.yaml").read_text("utf-8")
    (tmp_path / "p.yaml").write_text(text.replace("0.4", "deep"), "utf-8")
    with pytest.raises(CalibrationError, match=r"p.yaml: the file is damaged: could not convert"):
        Penetration.load(tmp_path / "p.yaml")
    (tmp_path / "p.yaml").write_text("a: 1\n", "utf-8")
    with pytest.raises(CalibrationError, match="not a penetration file"):
        Penetration.load(tmp_path / "p.yaml")
    with pytest.raises(CalibrationError, match="std_mm is -1"):
        replace(LIGHT, std_mm=-1.0)


def block_of(rig, height_mm: float, film_mm: float = 0.0, covered: slice = slice(70, 120)) -> np.ndarray:
    """An image of a block, a film on some of its rows."""
    found = np.zeros((rig.stripes, rig.rows))
    found[1:6, 70:170] = height_mm
    found[1:6, covered] += film_mm
    return rig.image(rig.x_px(found), lens_px=0.5)


@pytest.fixture
def line(tmp_path: Path, rig) -> Path:
    """A recipe, and images of a block of 12 mm: bare, and under 2 mm of something light enters by 0.6 mm."""
    for name, height in (("bare", 12.0), ("covered", 12.0 + 2.0 - 0.6)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "block.png"), block_of(rig, height))
    rig.calibration().save(tmp_path / "calibration.yaml")
    (tmp_path / "block.yaml").write_text(
        "kind: block\nname: b\nlength_mm: 50\nwidth_mm: 25\nheight_mm: 12\ntolerance_mm: 0.02\n", "utf-8"
    )
    (tmp_path / "recipe.yaml").write_text(
        "roemetry: 1\nproduct: roe\nsource: {path: covered}\ncalibration: calibration.yaml\n"
        "penetration: penetration.yaml\nstages:\n  extractor: centre-of-gravity\n  coder: window-tracking\n"
        "  triangulator: block-linear\n  volume: zero-order-hold\nsinks: []\n",
        "utf-8",
    )
    return tmp_path


def row_of(recipe: Recipe, folder: Path) -> dict:
    run_recipe(recipe, folder)
    return json.loads((folder / "measurements.jsonl").read_text("utf-8"))


def words(line: Path, film: str = "2.0") -> list[str]:
    images = [str(line / name / "block.png") for name in ("bare", "covered")]
    target = ["--target", str(line / "block.yaml")]
    return ["fit-penetration", str(line), *images, "--film", film, "--film-std", "0.03", *target]


def test_what_was_drawn_is_found_and_used(line: Path) -> None:
    typed(*words(line))
    light = Penetration.load(line / "penetration.yaml")
    assert light.offset_mm == pytest.approx(0.6, abs=0.03)  # mm
    assert 0.03 <= light.std_mm < 0.05
    assert light.product == "roe"
    raised, plain = (
        row_of(Recipe.load(line, sets=sets), line / f"out{len(sets)}")["height_max_mm"]["value"]
        for sets in ([], ["penetration="])
    )
    assert raised - plain == pytest.approx(light.offset_mm, abs=1e-9)  # mm
    assert Recipe.load(line).sha256 != Recipe.load(line, sets=["penetration="]).sha256


@pytest.mark.parametrize(("half", "film"), [("top", 2.0), ("bottom", 0.0)])
def test_two_colours_in_one_image(line: Path, rig, half: str, film: float) -> None:
    """Half of a block under 2 mm of something light enters by 0.6 mm; or painted, entered by as much."""
    covered = slice(70, 120) if half == "top" else slice(120, 170)
    cv2.imwrite(str(line / "both.png"), block_of(rig, 12.0, film - 0.6, covered))
    common = ["--film", str(film), "--film-std", "0.03", "--target", str(line / "block.yaml")]
    typed("fit-penetration", line, line / "both.png", "--half", half, *common)
    light = Penetration.load(line / "penetration.yaml")
    assert light.offset_mm == pytest.approx(0.6, abs=0.03)  # mm
    assert 0.03 <= light.std_mm < 0.05


def test_what_cannot_be_told_from_the_images_is_refused(line: Path, rig) -> None:
    """Without a second image the half must be named; too little of a top is said, as is a film too thick."""
    with pytest.raises(ConfigurationError, match=r"recipe.yaml:5:1: penetration: .*No such file"):
        Recipe.load(line)
    LIGHT.save(line / "penetration.yaml")
    thick = typed(*words(line, film="14"), code=1)
    assert isinstance(thick.exception, DataError)
    assert "14 mm thick" in str(thick.exception)
    row = row_of(Recipe.load(line), line / "run")
    assert "penetration-other-calibration" in {reason["code"] for reason in row["reasons"]}
    target = ["--film", "0", "--target", str(line / "block.yaml")]
    bare = str(line / "bare" / "block.png")
    neither = typed("fit-penetration", line, bare, *target, code=1)
    assert isinstance(neither.exception, ConfigurationError)
    assert "expected a second image or --half" in str(neither.exception)
    short = np.zeros((rig.stripes, rig.rows))
    short[1:6, 100:115] = 12.0
    cv2.imwrite(str(line / "short.png"), rig.image(rig.x_px(short), lens_px=0.5))
    small = typed("fit-penetration", line, line / "short.png", "--half", "top", *target, code=1)
    assert isinstance(small.exception, DataError)
    assert "does not show two level halves on 3 stripes" in str(small.exception)


def test_the_calibration_counts_where_halves_lie_apart(line: Path, rig) -> None:
    """A calibration whose stripes are uncertain one by one by 1 %: the step's own 1 % by √5 stripes stays."""
    cv2.imwrite(str(line / "both.png"), block_of(rig, 12.0, 2.0))
    calibration = rig.calibration()
    omega = calibration.parameters["omega_mm_per_px"]
    covariance = np.zeros(calibration.covariance.shape)
    covariance[: omega.size, : omega.size] = np.diag((0.01 * omega) ** 2)
    replace(calibration, covariance=covariance).save(line / "calibration.yaml")
    recipe = Recipe.load(line, sets=["penetration="])
    block = Block("b", 50.0, 25.0, 12.0, 0.02)
    light = fit_penetration_in_one(recipe, line / "both.png", block, "top", film_mm=2.0, film_std_mm=0.0)
    assert light.std_mm == pytest.approx(0.01 * 2.0 / np.sqrt(5.0), rel=0.3)


def test_the_offset_stands_in_the_budget(line: Path) -> None:
    """An offset known to 5 % of a mm on a flat top: the volume's part is area × 0.05 mm."""
    recipe = Recipe.load(line, sets=["penetration="])
    light = replace(LIGHT, calibration_sha256=recipe.calibration.sha256)
    light.save(line / "penetration.yaml")
    volume = row_of(Recipe.load(line, sets=["draws=400"]), line / "run")["volume"]
    plain = row_of(recipe, line / "plain")["volume"]
    per_mm = (volume["visible_mm3"]["value"] - plain["visible_mm3"]["value"]) / LIGHT.offset_mm
    part = volume["visible_mm3"]["budget"]["penetration"]
    assert part == pytest.approx(LIGHT.std_mm * per_mm, rel=0.3)  # 100 draws: 7 %, four of those
