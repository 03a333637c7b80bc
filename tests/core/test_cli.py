"""The command line: exit codes, one message a fault, no traceback."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest


def roemetry(*words: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "roemetry", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


def test_run_writes_and_says(line: Callable[..., Path], tmp_path: Path) -> None:
    done = roemetry("run", line(2), "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["counts"] == {"measured": 2, "empty": 0, "failed": 0}
    assert {Path(file).name for file in said["files"]} == {"results.csv"}
    again = roemetry("report", tmp_path / "out")
    assert again.returncode == 0, again.stderr


def test_results_are_numbered_where_no_folder_is_named(line: Callable[..., Path], tmp_path: Path) -> None:
    path = line(1)
    for number in (1, 2):
        assert roemetry("run", path.parent, cwd=tmp_path).returncode == 0
        assert (tmp_path / "results" / f"line-{number}" / "measurements.jsonl").exists()


def test_a_failed_product_is_exit_code_1(line: Callable[..., Path], tmp_path: Path) -> None:
    path = line(1)
    cv2.imwrite(str(path.parent / "images" / "p02.png"), np.zeros((240, 320), np.uint8))
    done = roemetry("run", path, "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "no stripe was found" in done.stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run", "nowhere.yaml"], "cannot be read"),
        (["run", "{line}", "--set", "stages.extractor.use=x"], "there is no extractor `x`"),
        (["run", "{line}", "--resume"], "--resume needs --out"),
        (["lint", "{image}"], "not a text file"),
        (["calibrate", "{line}"], "roemetry_rig"),
    ],
)
def test_a_wrong_file_or_command_line_is_exit_code_2(
    line: Callable[..., Path], words: list[str], says: str
) -> None:
    path = line(1)
    image = path.parent / "images" / "p01.png"
    done = roemetry(*(word.format(line=path, image=image) for word in words))
    assert done.returncode == 2
    assert says in done.stderr
    assert "Traceback" not in done.stderr


def test_a_folder_that_cannot_be_written(line: Callable[..., Path], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x", encoding="utf-8")
    done = roemetry("run", line(1), "--out", tmp_path / "file" / "out")
    assert done.returncode == 1
    assert "cannot be written: a file stands where a folder is needed" in done.stderr
    assert "free some space" not in done.stderr
    assert "Traceback" not in done.stderr


def test_no_images(line: Callable[..., Path], tmp_path: Path) -> None:
    recipe = line(1)
    done = roemetry("run", recipe, "--set", f"source.path={tmp_path}/*.tif", "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "there is no image here\n" in done.stderr
    done = roemetry("run", recipe, "--set", "source.path=nowhere", "--out", tmp_path / "out")
    assert "nowhere: there is no image here: no such file or folder" in done.stderr


def test_lint_says_what_a_file_is(line: Callable[..., Path]) -> None:
    path = line(1)
    assert "a recipe for test dome: sound" in roemetry("lint", path).stdout
    assert (
        "a calibration by block-linear of 7 stripes"
        in roemetry("lint", path.parent / "calibration.yaml").stdout
    )


def test_lint_notices_what_does_not_go_together(line: Callable[..., Path]) -> None:
    path = line(2)
    done = roemetry("lint", path, "--set", "source.subtract=dark")
    assert done.returncode == 2
    assert "source.subtract: `dark`, but 2 of 2 acquisitions have no dark image" in done.stderr
    done = roemetry("lint", path, "--set", "stages.coder={use: window-tracking, options: {stripe_count: 9}}")
    assert done.returncode == 2
    assert "stages.coder.options.stripe_count: 9, but the calibration has 7 stripes" in done.stderr


def test_plugins_lists_every_stage_with_its_provider() -> None:
    listed = json.loads(roemetry("plugins", "--json").stdout)
    assert listed["broken"] == []
    names = {(stage["kind"], stage["name"]) for stage in listed["stages"]}
    assert ("extractor", "dominant-peak") in names
    assert all(stage["summary"] and stage["reference"] for stage in listed["stages"])


def test_debug_shows_the_traceback() -> None:
    assert "Traceback" in roemetry("run", "nowhere.yaml", "--debug").stderr
