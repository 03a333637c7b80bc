"""The command line: exit codes, one message a fault, no traceback; and the table of a run."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from rich.console import Console

from roemetry import Recipe
from roemetry.cli.run import problems_of, table_of
from roemetry.config.overrides import Implied
from roemetry.errors import ConfigurationError
from roemetry.records import Estimate, Measurement, Reason, Weight
from roemetry.testing.runs import measured
from tests.command import exit_code

Line = Callable[..., Path]


class Done(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def roemetry(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Run the command line in this process."""

    def run(*words: object) -> Done:
        capsys.readouterr()
        return Done(exit_code(monkeypatch, *words), *capsys.readouterr())

    return run


def test_run_writes_and_says_in_a_process_of_its_own(line: Line, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "roemetry", "run", line(2), "--out", tmp_path / "out", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["counts"] == {"measured": 2, "empty": 0, "failed": 0}
    assert {Path(file).name for file in said["files"]} == {"results.csv"}
    words = [sys.executable, "-m", "roemetry", "run", "nowhere.yaml", "--debug"]
    assert "Traceback" in subprocess.run(words, capture_output=True, text=True, check=False).stderr


def test_results_are_numbered_where_no_folder_is_named(line: Line, tmp_path: Path, roemetry, monkeypatch):
    folder = line(1).parent
    monkeypatch.chdir(tmp_path)
    for number in (1, 2):
        assert roemetry("run", folder).code == 0
        assert (tmp_path / "results" / f"line-{number}" / "measurements.jsonl").exists()
    assert roemetry("report", tmp_path / "results" / "line-1").code == 0


def test_a_failed_product_is_exit_code_1(line: Line, tmp_path: Path, roemetry) -> None:
    path = line(1)
    cv2.imwrite(str(path.parent / "images" / "p02.png"), np.zeros((240, 320), np.uint8))
    done = roemetry("run", path, "--out", tmp_path / "out")
    assert done.code == 1
    assert "no stripe was found" in done.out


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ("run {line} --set stages.extractor.use=x", 2, "there is no extractor `x`"),
        ("run nowhere.yaml", 2, "cannot be read"),
        ("run {line} --resume", 2, "--resume needs --out"),
        ("lint {image}", 2, "not a text file"),
        ("calibrate {line}", 2, "roemetry_rig"),
        ("run {line} --out {image}/out", 1, "cannot be written: a file stands where a folder is needed"),
        ("run {line} --set source.path={line}/*.tif --out {out}", 1, "there is no image here"),
        (
            "run {line} --set source.path=no --out {out}",
            1,
            "no: there is no image here: no such file or folder",
        ),
        (
            "lint {line} --set source.subtract=dark",
            2,
            "source.subtract: `dark`, but 1 of 1 acquisitions have no",
        ),
        (
            "lint {line} --set stages.coder={{use:\twindow-tracking,\toptions:\t{{stripe_count:\t9}}}}",
            2,
            "stages.coder.options.stripe_count: 9, but the calibration has 7 stripes",
        ),
    ],
)
def test_what_is_wrong_has_an_exit_code_and_one_message(
    line: Line, tmp_path: Path, roemetry, words: str, code: int, says: str
) -> None:
    path = line(1)
    places = {"line": path, "image": path.parent / "images" / "p01.png", "out": tmp_path / "out"}
    done = roemetry(*(word.format(**places).replace("\t", " ") for word in words.split(" ")))
    assert done.code == code
    assert says in done.err
    assert "Traceback" not in done.err
    assert "free some space" not in done.err


def test_lint_says_what_a_file_is(line: Line, roemetry) -> None:
    path = line(1)
    said = roemetry("lint", path).out
    assert "a recipe for test dome: sound" in said
    assert "aligner belt-lines" in said
    assert "There is no aligner" not in said
    assert "There is no aligner" in roemetry("lint", path, "--set", "stages.aligner=null").out
    said = roemetry("lint", path.parent / "calibration.yaml").out
    assert "a calibration by block-linear of 7 stripes" in said
    listed = json.loads(roemetry("plugins", "--json").out)
    assert listed["broken"] == []
    assert ("extractor", "dominant-peak") in {(stage["kind"], stage["name"]) for stage in listed["stages"]}


NO_LIGHT = Reason("source-refused", "the image is black")
FAILED = Measurement("p2#0", "p2", 0, "failed", reasons=(NO_LIGHT,))


def shown(*rows: Measurement) -> str:
    console = Console(width=80)
    with console.capture() as said:
        console.print(table_of("skeins", rows, len(rows)))
    return said.get()


def test_eighty_columns_hold_grade_and_all_figures_with_their_uncertainties() -> None:
    height = Estimate(17.389, 0.041)
    row = replace(measured("skein_01"), weight=Weight(Estimate(120.37, 11.2)), height_max_mm=height)
    text = shown(row)
    for words in ("skein_01#1", "good", "120.4 ± 11.2", "17.39 ± 0.04", "7/7"):
        assert words in text
    assert max(map(len, text.splitlines())) <= 80
    assert "not graded" in shown(row, replace(row, grade=None)), "measured is no grade"
    bare = shown(replace(measured(), weight=Weight(Estimate(20.37, math.nan))))
    assert "20.4" in bare
    assert "±" not in bare, "what is not stated"


def test_a_fault_of_many_images_is_told_once() -> None:
    black = [replace(FAILED, id=f"p{n}#0") for n in range(30)]
    other = Measurement("q#0", "q", 0, "empty")
    row = measured()
    bare = replace(row, volume=replace(row.volume, reasons=(Reason("peak-noise-not-stated", "no noise"),)))
    assert problems_of([bare, *black, other]) == [
        f"{row.id}: no uncertainty: no noise",
        "p0#0, p1#0, p2#0 and 27 more: the image is black",
        "q#0: empty",
    ]


def test_without_a_calibration_the_displacement_stands_there() -> None:
    row = replace(measured(), weight=None, volume=None, height_max_mm=Estimate(math.nan))
    row = replace(row, coding=replace(row.coding, displacement_max_px=18.04))
    text = shown(row, FAILED)
    assert "px displaced" in text
    assert "18.0" in text
    assert "cm³" not in text
    assert "cm³" in shown(measured(), row), "one row in millimetres is enough"


def test_a_fault_names_what_was_typed_and_not_what_follows_from_it(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(
        "roemetry: 1\nproduct: p\nsource: {path: .}\nstages: {extractor: dominant-peak}\nsinks: [csv]\n",
        "utf-8",
    )
    with pytest.raises(ConfigurationError, match=r"^export csv --set a=1: sinks\.0\.options\.a: unknown key"):
        Recipe.load(path, sets=[Implied("sinks=[{use: csv, options: {a: 1}}]", "export csv --set a=1")])
