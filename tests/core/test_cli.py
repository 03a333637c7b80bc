"""The command line: exit codes, one message a fault, no traceback; and the table of a run."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from roemetry import Recipe
from roemetry.cli.progress import time_left_s
from roemetry.cli.table import problems_of, table_of
from roemetry.config.overrides import Implied
from roemetry.errors import ConfigurationError
from roemetry.records import Estimate, Measurement, Reason, Weight
from roemetry.testing.runs import measured


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
    aligned = roemetry("lint", path).stdout
    assert "aligner belt-lines" in aligned
    assert "There is no aligner" not in aligned
    assert "There is no aligner" in roemetry("lint", path, "--set", "stages.aligner=null").stdout
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


NO_LIGHT = Reason("source-refused", "the image is black")


def shown(*rows: Measurement) -> str:
    console = Console(width=80)
    with console.capture() as said:
        console.print(table_of("skeins", rows, len(rows)))
    return said.get()


def test_a_stated_uncertainty_stands_beside_its_value() -> None:
    row = replace(measured(), weight=Weight(Estimate(20.37, 1.21)), height_max_mm=Estimate(17.389, 0.041))
    text = shown(row)
    assert "20.4 ± 1.2" in text
    assert "17.39 ± 0.04" in text


def test_what_is_not_stated_stands_alone() -> None:
    text = shown(replace(measured(), weight=Weight(Estimate(20.37, math.nan))))
    assert "20.4" in text
    assert "±" not in text


def test_eighty_columns_hold_grade_and_all_figures() -> None:
    row = replace(
        measured("skein_01"), weight=Weight(Estimate(120.37, 11.2)), height_max_mm=Estimate(17.389, 0.041)
    )
    text = shown(row)
    for words in ("skein_01#1", "good", "120.4 ± 11.2", "17.39 ± 0.04", "7/7"):
        assert words in text
    assert max(map(len, text.splitlines())) <= 80


def test_a_fault_of_many_images_is_told_once() -> None:
    black = [Measurement(f"p{n}#0", f"p{n}", 0, "failed", reasons=(NO_LIGHT,)) for n in range(30)]
    other = Measurement("q#0", "q", 0, "empty")
    assert problems_of([measured(), *black, other]) == [
        "p0#0, p1#0, p2#0 and 27 more: the image is black",
        "q#0: empty",
    ]


def test_without_a_calibration_the_displacement_stands_there() -> None:
    nothing = Estimate(math.nan)
    row = replace(measured(), weight=None, volume=None, height_max_mm=nothing)
    assert row.coding is not None
    row = replace(row, coding=replace(row.coding, displacement_max_px=18.04))
    text = shown(row, Measurement("p2#0", "p2", 0, "failed", reasons=(NO_LIGHT,)))
    assert "px displaced" in text
    assert "18.0" in text
    assert "cm³" not in text
    assert "cm³" in shown(measured(), row), "one row in millimetres is enough"


@pytest.mark.parametrize(
    ("elapsed_s", "done", "left", "expected_s"), [(10.0, 2.0, 6.0, 30.0), (0.0, 0.0, 5.0, math.nan)]
)
def test_the_time_left_is_as_long_as_what_was_done_took(
    elapsed_s: float, done: float, left: float, expected_s: float
) -> None:
    assert time_left_s(elapsed_s, done, left) == pytest.approx(expected_s, nan_ok=True)


def test_a_fault_names_what_was_typed_and_not_what_follows_from_it(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(
        "roemetry: 1\nproduct: p\nsource: {path: .}\nstages: {extractor: dominant-peak}\nsinks: [csv]\n",
        "utf-8",
    )
    with pytest.raises(ConfigurationError, match=r"^export csv --set a=1: sinks\.0\.options\.a: unknown key"):
        Recipe.load(path, sets=[Implied("sinks=[{use: csv, options: {a: 1}}]", "export csv --set a=1")])
