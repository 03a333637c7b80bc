"""The doctor sees what is wrong, and says what to do; on a sound machine it finds nothing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from roemetry.stages.hookspecs import Finding
from roemetry.stages.registry import Broken, Provider, Registry, discover
from roemetry_tools import doctor
from roemetry_tools.doctor import REFERENCE_VALUES, examine
from tests.command import typed


@pytest.fixture
def copied(tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shipped recipe where a test may spoil it."""
    home = root / "recipes" / "herring_roe"
    folder = tmp_path / "herring_roe"
    (folder / "images").mkdir(parents=True)
    for name in (
        "recipe.yaml",
        "calibration.yaml",
        REFERENCE_VALUES,
        *(f"images/skein_0{n}.png" for n in (1, 2, 3)),
    ):
        shutil.copy(home / name, folder / name)
    monkeypatch.setattr(doctor, "shipped", lambda *_: folder)
    return folder


def found(registry: Registry | None = None) -> dict[str, Finding]:
    return {finding.what: finding for finding in examine(registry)}


def test_nothing_is_wrong_here() -> None:
    findings = found()
    assert [finding for finding in findings.values() if finding.verdict == "wrong"] == []
    assert findings["shipped recipe"].verdict == "ok"
    assert findings["kernels"].verdict == "ok"
    assert "numba" in findings["libraries"].found


def spoil(folder: Path, column: str, to: str) -> None:
    """Write something else for the first product's known number; a `to` of ``*1.0002`` multiplies it."""
    file = folder / REFERENCE_VALUES
    head, first, *others = file.read_text("utf-8").splitlines(keepends=True)
    place = head.strip().split(",").index(column)
    cells = first.strip().split(",")
    cells[place] = f"{float(cells[place]) * float(to[1:]):.6f}" if to.startswith("*") else to
    file.write_text("".join([head, ",".join(cells) + "\n", *others]), "utf-8")


@pytest.mark.parametrize(
    ("column", "to", "says"),
    [
        ("weight (g)", "*1.0002", "off by up to 0.02%"),
        ("grade", "henkei", "skein_01#1 is good, expected henkei"),
    ],
)
def test_another_number_is_wrong(copied: Path, column: str, to: str, says: str) -> None:
    spoil(copied, column, to)
    finding = found()["shipped recipe"]
    assert finding.verdict == "wrong"
    assert says in finding.found, finding
    assert finding.remedy


def test_a_recipe_that_cannot_run_is_told_with_its_reason(copied: Path) -> None:
    (copied / "calibration.yaml").unlink()
    findings = found()
    assert findings["shipped recipe"].verdict == "wrong"
    assert "calibration.yaml" in findings["shipped recipe"].found
    assert "kernels" not in findings


def test_a_broken_plugin_is_told(copied: Path) -> None:
    registry = discover()
    broken = Broken(Provider("their-plugin", "0.1", "theirs"), "ImportError: no module x")
    findings = found(Registry(registry.stages, (broken,)))
    assert findings["plugin their-plugin 0.1 (theirs)"].verdict == "wrong"


def test_two_packages_of_opencv_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    two = {"cv2": ["opencv-python", "opencv-contrib-python-headless"]}
    monkeypatch.setattr(doctor, "packages_distributions", lambda: two)
    finding = found()["OpenCV"]
    assert finding.verdict == "wrong"
    assert "pip uninstall" in finding.remedy


def test_the_verb_ends_with_2_where_something_is_wrong(copied: Path) -> None:
    spoil(copied, "weight (g)", "30")
    outcome = typed("doctor", code=2)
    assert "1 wrong" in outcome.output
    as_json = typed("doctor", "--json", code=2)
    assert {"what", "verdict", "found", "remedy"} == set(json.loads(as_json.output)[0])
