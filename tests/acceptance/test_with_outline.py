"""The shipped recipe for volume: stripes and outline, uncertainties by cause, in record, table and report."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from roemetry.recipe import Recipe
from roemetry.runner import run_recipe

HOME = Path(__file__).parents[2] / "recipes" / "herring_roe"
CAUSES = {"peak noise", "calibration", "outline", "between slices", "settings", "rim"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("with-outline") / "out"
    recipe = Recipe.load(
        HOME / "with_outline.yaml", sets=[f"source.path={HOME}/images/skein_09.png", "draws=20"]
    )
    outcome = run_recipe(recipe, out)
    assert outcome.sink_faults == ()
    return out


@pytest.fixture(scope="module")
def row(folder: Path) -> Mapping[str, Any]:
    (line,) = (folder / "measurements.jsonl").read_text("utf-8").splitlines()
    return json.loads(line)


def truth() -> Mapping[str, Any]:
    lines = (HOME / "items.jsonl").read_text("utf-8").splitlines()
    (item,) = (item for item in map(json.loads, lines) if item["id"] == "skein_09")
    return item["products"][0]


def test_its_volumes_have_a_budget_by_cause_and_shares(row: Mapping[str, Any]) -> None:
    volume = row["volume"]
    assert set(volume["visible_mm3"]["budget"]) == CAUSES
    assert set(volume["true_mm3"]["budget"]) == CAUSES | {"underside"}
    assert sum(volume["shares"].values()) == pytest.approx(1.0)
    assert volume["visible_mm3"]["value"] == pytest.approx(truth()["visible_mm3"], rel=0.03)
    low, high = volume["true_mm3"]["interval"]
    assert low < truth()["true_mm3"] < high


def test_the_table_and_the_report_say_the_same(folder: Path, row: Mapping[str, Any]) -> None:
    with (folder / "results.csv").open(encoding="utf-8") as file:
        (cells,) = csv.DictReader(file)
    budget = row["volume"]["true_mm3"]["budget"]
    told = dict(part.rsplit(" ", 1) for part in cells["true volume by cause (cm³)"].split("; "))
    assert list(told) == sorted(budget, key=lambda cause: -budget[cause])
    assert float(told["underside"]) == pytest.approx(1e-3 * budget["underside"], rel=1e-3)
    assert float(cells["true volume (cm³)"]) == pytest.approx(
        1e-3 * row["volume"]["true_mm3"]["value"], abs=1e-4
    )
    assert cells["true volume 95 % low (cm³)"]
    report = (folder / "report.html").read_text("utf-8")
    for words in (*CAUSES, "underside", "true volume", "interpolated", "assumed"):
        assert words in report


def test_its_calibration_is_its_extractors(row: Mapping[str, Any]) -> None:
    assert "other-extractor" not in {reason["code"] for reason in row["reasons"]}
