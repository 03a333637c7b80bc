"""The shipped recipe for volume: stripes and outline, uncertainties by cause, in record, table and report."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from roemetry import Recipe
from roemetry.records import Measurement
from roemetry.run.batch import run_recipe

HOME = Path(__file__).parents[2] / "recipes" / "herring_roe"
CAUSES = {"peak noise", "calibration", "outline", "between slices", "settings", "rim", "gaps", "ends"}
CAUSES |= {"common height"}


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


def truth(name: str = "skein_09") -> Mapping[str, Any]:
    lines = (HOME / "items.jsonl").read_text("utf-8").splitlines()
    (item,) = (item for item in map(json.loads, lines) if item["id"] == name)
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


@pytest.fixture(scope="module")
def all_ten() -> Mapping[str, Measurement]:
    recipe = Recipe.load(HOME / "with_outline.yaml", sets=["draws=0"])
    return {row.acquisition: row for row in recipe.run()}


def test_its_volumes_are_right_at_every_height(all_ten: Mapping[str, Measurement]) -> None:
    off = []
    for name, row in all_ten.items():
        assert row.volume is not None, name
        off.append(row.volume.visible_mm3.value / truth(name)["visible_mm3"] - 1.0)
    assert len(off) == 10
    assert max(map(abs, off)) < 0.015
    assert sum(map(abs, off)) / len(off) < 0.006


def test_it_names_what_a_stripe_shows_of_a_defect(all_ten: Mapping[str, Measurement]) -> None:
    wanted = {"none": "good", "dented": "dent", "bent": "bend", "twisted": "twist", "folded": "fold"}
    for name, row in all_ten.items():
        known = truth(name)
        assert row.grade is not None, name
        shown = known["defect"] in ("bent", "none") or known["figures"]["defect_seen_mm"] >= 1.0
        assert row.grade.label == (wanted[known["defect"]] if shown else "good"), name


def test_the_reports_panels_stand_in_the_order_of_their_letters(folder: Path) -> None:
    letters = re.findall(r"<b>\((\w)\)</b>", (folder / "report.html").read_text("utf-8"))
    assert {"a", "h", "i", "j"} <= set(letters)
    assert letters == sorted(letters)
