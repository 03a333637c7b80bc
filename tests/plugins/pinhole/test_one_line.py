"""One line before a board in the hand, from image files through a recipe to points, mm: no belt anywhere."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.spoil import TURNTABLE
from roemetry import Recipe
from roemetry.calibrating import calibrate
from roemetry.config.rig import Rig
from roemetry.io.yaml_source import dump, read
from roemetry.records.calibration import ON_BOARD
from tests.plugins.pinhole.board_set import FOCAL_PX, lit, load, pose, save, written

TURNTABLE_SET = Path(os.environ.get("ROEMETRY_REAL_DATA", "../shared/real")).resolve() / "turntable_green"
RECIPE = """
roemetry: 1
product: one line
source: {path: scan}
calibration: calibration.yaml
stages:
  extractor: centre-of-gravity
  coder: single
  triangulator: pinhole-plane
"""


def test_a_tilted_board_is_measured_from_the_plane_of_another_pose(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    rig_file = written(tmp_path, poses=6, count=3)
    data = dict(read(rig_file).data)
    del data["images"]["belt"]
    data["calibrator"]["options"]["reference_pose"] = "0"
    rig_file.write_text(dump(data | {"stripes": 1}), encoding="utf-8")
    for number in range(6):  # of the three lines only the middle one
        rotation, shift = pose(number)
        off = cv2.imread(str(tmp_path / f"off_{number}.png"), cv2.IMREAD_GRAYSCALE).astype(np.float64)
        save(tmp_path / f"on_{number}.png", lit(off, 0.5, rotation, shift, range(1, 2), 3), rng)
    calibration = calibrate(Rig.load(rig_file))
    assert calibration.reference == ON_BOARD
    calibration.save(tmp_path / "calibration.yaml")
    rotation, shift = pose(3)
    (tmp_path / "scan").mkdir()
    # a grey sheet where the fourth board was
    sheet = lit(np.full((300, 400), 20.0), 0.5, rotation, shift, range(1, 2), 3)
    save(tmp_path / "scan" / "sheet.png", sheet, rng)
    (tmp_path / "recipe.yaml").write_text(RECIPE, encoding="utf-8")
    recipe = Recipe.load(tmp_path / "recipe.yaml")
    trace = recipe.trace(load(tmp_path / "scan" / "sheet.png").astype(np.uint8), name="sheet")
    assert trace.stripes is not None
    assert trace.profiles is not None
    assert np.isnan(trace.stripes.rest_px).all(), "without a belt there is no rest line"
    seen = np.isfinite(trace.profiles.xyz_mm).all(axis=-1)
    ray = np.column_stack([trace.profiles.x_px[seen] - 199.5, trace.profiles.row_px[seen] - 149.5])
    ray = np.column_stack([ray / FOCAL_PX, np.ones(len(ray))])
    on_sheet = ray * (rotation[:, 2] @ shift) / (ray @ rotation[:, 2:])
    reference, at = pose(0)
    height_mm = (at - on_sheet) @ reference[:, 2]
    assert np.ptp(height_mm) > 5.0, "the sheet is tilted against the first board"
    assert trace.profiles.xyz_mm[seen][:, 2] == pytest.approx(height_mm, abs=0.1)


@pytest.mark.skipif(not TURNTABLE_SET.is_dir(), reason=f"{TURNTABLE_SET} is absent: set ROEMETRY_REAL_DATA")
def test_the_turntable_is_measured_by_a_recipe(tmp_path: Path) -> None:
    images = {
        shows: [f"{TURNTABLE_SET}/{one}" for one in paths] for shows, paths in TURNTABLE["images"].items()
    }
    (tmp_path / "rig.yaml").write_text(dump(TURNTABLE | {"images": images}), encoding="utf-8")
    calibrate(Rig.load(tmp_path / "rig.yaml")).save(tmp_path / "calibration.yaml")
    recipe = RECIPE.replace("path: scan", f"path: {TURNTABLE_SET}/scan/*4.jpg, contrast: green")
    recipe = recipe.replace("centre-of-gravity", "maximum-likelihood")
    (tmp_path / "recipe.yaml").write_text(recipe, encoding="utf-8")
    rows = list(Recipe.load(tmp_path / "recipe.yaml").run())
    assert len(rows) == 5
    assert {row.status for row in rows} == {"measured"}
