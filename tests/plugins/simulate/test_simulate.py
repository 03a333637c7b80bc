"""`roemetry simulate`: the same bytes however it runs, and nothing half when it stops."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from roemetry.cli.main import app
from roemetry.config.dataset import ITEMS, Dataset
from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError, OutputError
from roemetry.run.simulate import simulate
from roemetry_files.dataset_source import DatasetSource

SCENE = """\
roemetry_scene: 1
name: small
licence: CC0-1.0
item: roe_{number:03d}
simulator:
  use: ray-caster
  options:
    camera: {width_px: 64, height_px: 48, pixel_size_um: 100, bit_depth: 12, gain_dn_per_e: 0.4}
    light: {images: [laser, dark]}
    belt: {speed_mm_per_s: 300, encoder_step_mm: 0.5, pitch_mm: 150}
    product: {family: herring-roe, options: {grid_step_mm: 0.5}}
    targets: {board: {poses: 2}}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "dataset.yaml"
    }


def test_two_processes_make_the_bytes_of_one(scene: Path, tmp_path: Path) -> None:
    loaded = Scene.load(scene)
    seen: list[tuple[int, int]] = []
    left: list[float] = []

    def on_progress(done: int, of: int, left_s: float) -> None:
        seen.append((done, of))
        left.append(left_s)

    one = simulate(loaded, tmp_path / "one", count=3, seed=5, on_progress=on_progress)
    simulate(loaded, tmp_path / "two", count=3, seed=5, jobs=2)
    assert (one.items, one.kept, one.views) == (3, 0, 2)
    assert seen == [(k, 5) for k in range(6)]
    assert math.isnan(left[0])
    assert min(left[1:-1]) > 0.0
    assert left[-1] == 0.0
    assert bytes_of(tmp_path / "one") == bytes_of(tmp_path / "two")
    assert list(Dataset(tmp_path / "one").faults()) == []


def test_a_set_can_be_made_longer_and_the_kept_scene_makes_it_again(scene: Path, tmp_path: Path) -> None:
    loaded = Scene.load(scene)
    simulate(loaded, tmp_path / "grown", count=1, seed=5, calibration="none")
    with pytest.raises(OutputError, match="already"):
        simulate(loaded, tmp_path / "grown", count=2, seed=5, calibration="none")
    with pytest.raises(OutputError, match="another data set"):
        simulate(loaded, tmp_path / "grown", count=2, seed=6, calibration="none", resume=True)
    made = simulate(loaded, tmp_path / "grown", count=2, seed=5, calibration="none", resume=True)
    assert made.kept == 1
    again = Scene.load(tmp_path / "grown" / "scene.yaml")
    assert again.sha256 == loaded.sha256
    simulate(again, tmp_path / "again", count=2, seed=5, calibration="none")
    assert bytes_of(tmp_path / "grown") == bytes_of(tmp_path / "again")


def test_a_killed_run_holds_whole_items_and_goes_on(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    words = ["simulate", str(scene), "--out", str(out), "--count", "400", "--seed", "5", "--jobs", "1"]
    process = subprocess.Popen([sys.executable, "-m", "roemetry", *words], stderr=subprocess.DEVNULL)
    end = time.monotonic() + 60
    while not ((out / ITEMS).exists() and (out / ITEMS).read_bytes().count(b"\n") >= 2):
        assert time.monotonic() < end
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    # what may be left in the middle of a file: it does not count
    (out / "images" / "roe_004.png").write_bytes(b"half")
    (out / ITEMS).write_bytes((out / ITEMS).read_bytes() + b'{"id": "roe_0')
    loaded = Scene.load(scene)
    count = sum(1 for line in (out / ITEMS).read_bytes().splitlines()) + 1
    simulate(loaded, out, count=count, seed=5, resume=True)
    simulate(loaded, tmp_path / "whole", count=count, seed=5)
    kept = {name: data for name, data in bytes_of(out).items() if ".part" not in name}
    whole = bytes_of(tmp_path / "whole")
    assert {name: kept[name] for name in whole} == whole
    assert list(Dataset(out).faults()) == []


def test_a_recipe_reads_a_data_set_with_its_bits_and_times(scene: Path, tmp_path: Path) -> None:
    simulate(Scene.load(scene), tmp_path / "data", count=2, seed=5, calibration="none")
    source = DatasetSource()
    references = source.references(tmp_path / "data")
    assert [reference.id for reference in references] == ["roe_001", "roe_002"]
    acquisition = source.read(references[1])
    laser, dark = acquisition.frame("laser"), acquisition.frame("dark")
    assert laser.bit_depth == dark.bit_depth == 12
    assert laser.pixels.dtype == np.uint16
    assert 255 < laser.pixels.max() <= 4095
    assert dark.pixels.max() < laser.pixels.max() / 2
    assert (laser.time_s, laser.encoder_count) == (0.5, 300.0)


def test_the_command_line_makes_lints_and_says(scene: Path, tmp_path: Path) -> None:
    run = CliRunner().invoke
    out = str(tmp_path / "set")
    made = run(app, ["simulate", str(scene), "--out", out, "-n", "1", "-j", "1", "--product", "none"])
    assert made.exit_code == 0, made.output
    assert "1 item, 2 calibration images" in made.output
    assert "a data set of 1 item, " in run(app, ["lint", out]).output
    assert "sound" in run(app, ["lint", str(scene)]).output
    truth = Dataset(Path(out)).truth(next(iter(Dataset(Path(out)).items())))
    assert truth.products == ()
    assert not truth.stripes.on_product.any()
    scene.write_text(SCENE.replace("roe_{number:03d}", "roe"), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"item.*\{number\}"):
        Scene.load(scene)
