"""Results, reasons and records: no field, column or code is missing or made up."""

from __future__ import annotations

import ast
import dataclasses
import json
import re
from pathlib import Path
from typing import get_args

import pytest

from roemetry import records
from roemetry.config.recipe import Recipe
from roemetry.records import Status
from roemetry.run.batch import run_recipe
from roemetry.run.record import PROVENANCE, RECORD
from roemetry.stages.hookspecs import KINDS
from tests.docs.reading import ROOT, coded, firsts, page, section, table, without_blocks


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run of a shipped skein with every table."""
    folder = tmp_path_factory.mktemp("run")
    home = ROOT / "recipes" / "herring_roe"
    sets = [f"source.path={home / 'images' / 'skein_04.png'}", "sinks=[csv, points]"]
    run_recipe(Recipe.load(home, sets=sets), folder)
    return folder


def test_the_fields_of_the_record_are_those_that_are_written(results: Path) -> None:
    text = section(page("results.md"), "## measurements.jsonl")
    row = json.loads((results / RECORD).read_text("utf-8").splitlines()[0])
    assert firsts(section(text, "### Top level")) == list(row)
    assert set(firsts(section(text, "### `grade`"))) == set(row["grade"])
    assert set(firsts(section(text, "### `weight`"))) == set(row["weight"])
    assert firsts(section(text, "### `volume`")) == list(row["volume"])
    assert firsts(section(text, "### Estimates")) == list(row["weight"]["mass_g"])
    assert firsts(section(text, "### `coding`")) == list(row["coding"])
    assert set(firsts(section(text, "### `provenance`"))) == set(row["provenance"])
    cells = {coded(line[0])[0]: coded(line[-1]) for line in table(section(text, "### `volume`"))}
    assert cells["shares"] == list(row["volume"]["shares"])
    assert cells["slices"] == list(row["volume"]["slices"][0])
    assert coded(table(section(text, "### Top level"))[-2][-1]) == list(row["reasons"][0])
    assert row["weight"]["mass_g"]["std"] is None, "the page says that null stands for NaN"


def test_the_columns_of_the_tables_are_those_that_are_written(results: Path) -> None:
    for file, heading in (("results.csv", "## results.csv"), ("points/skein_04.csv", "## points/*.csv")):
        header = (results / file).read_text("utf-8").splitlines()[0].split(",")
        assert firsts(section(page("results.md"), heading)) == header


def test_the_keys_of_the_provenance_are_those_that_are_written(results: Path) -> None:
    written = json.loads((results / PROVENANCE).read_text("utf-8"))
    assert set(firsts(section(page("results.md"), "## provenance.json"))) == set(written)


def test_every_status_is_told() -> None:
    assert firsts(section(page("results.md"), "## Status and exit code")) == list(get_args(Status))


def reason_codes() -> tuple[set[str], set[str], list[str]]:
    """Codes in the sources, endings of made-up codes, and calls that hold neither."""
    codes, endings, strange = set(), set(), []
    for folder in ("roemetry", "plugins"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            text = path.read_text("utf-8")
            for node in ast.walk(ast.parse(text)) if "Reason(" in text else ():
                if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Reason"):
                    continue
                code = node.args[0] if node.args else None
                if isinstance(code, ast.Constant):
                    codes.add(code.value)
                elif isinstance(code, ast.JoinedStr) and isinstance(code.values[-1], ast.Constant):
                    endings.add(code.values[-1].value)
                elif not (len(node.keywords) == 1 and node.keywords[0].arg is None):
                    strange.append(f"{path}:{node.lineno}")
    return codes, endings, strange


def test_every_reason_code_is_told_and_no_other() -> None:
    codes, endings, strange = reason_codes()
    assert not strange, "a code the test cannot read"
    assert len(codes) > 20
    assert endings == {"-refused", "-fault"}
    kinds = [
        kind for kind in KINDS if kind not in ("calibrator", "sink", "simulator", "planner", "feed", "outlet")
    ]
    stages = {kind + ending for kind in kinds for ending in endings}
    text = page("reasons.md")
    broken = section(text, "## A stage refused, or failed")
    told = set(firsts(text.replace(broken, "")))
    both = {word for row in table(broken) for cell in row[:2] for word in coded(cell)}
    assert told - stages == codes - stages
    assert stages <= both


def test_every_record_is_told_with_its_fields() -> None:
    text = without_blocks(page("records.md"))
    words = {word for found in coded(text) for word in re.findall(r"\w+", found)}
    headings = {"Frame": "## Acquisition and Frame"}
    with_table = 0
    for name in vars(records):
        record = getattr(records, name)
        if not dataclasses.is_dataclass(record) or name in ("Measurement", "Coding"):
            continue  # these two are told on the page of results
        fields = {field.name for field in dataclasses.fields(record)}
        assert fields <= words, name
        if headings.get(name, f"## {name}") in text.splitlines() and name != "Trace":
            assert set(firsts(section(text, headings.get(name, f"## {name}")))) == fields, name
            with_table += 1
    assert with_table >= 8
