"""Reference pages of records, files, stages and names: nothing is missing, nothing is made up."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import json
import re
import sys
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
from pydantic import BaseModel

from benchmarks.__main__ import BENCHMARKS
from benchmarks.packages import DIAGRAM, drawing
from docs.reference_tables import contract
from roemetry import errors, records
from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import RecipeFile, StageChoice
from roemetry.config.rig import Rig, RigFile
from roemetry.config.target_file import BlockFile, BoardFile, StaircaseFile
from roemetry.config.validation import checked
from roemetry.io.yaml_source import parse
from roemetry.records import Status
from roemetry.records.calibration import Calibration
from roemetry.run.batch import run_recipe
from roemetry.run.record import PROVENANCE, RECORD
from roemetry.stages.hookspecs import KINDS
from roemetry.stages.registry import discover
from tests.docs.reading import (
    PAGES,
    REFERENCE,
    ROOT,
    STAGES,
    blocks,
    coded,
    firsts,
    page,
    section,
    table,
    text_of,
    without_blocks,
)


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


def keys_of(model: type[BaseModel], before: str = "") -> dict[str, Any]:
    """Field by its dotted path; a chosen stage is one key."""
    found = {}
    for name, field in model.model_fields.items():
        found[before + name] = field
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel) and not issubclass(part, StageChoice):
                found |= keys_of(part, f"{before}{name}.")
    return found


def test_the_keys_of_a_rig_and_a_target_are_those_of_their_models() -> None:
    rows = {coded(row[0])[0]: row for row in table(page("rig.md")) if re.fullmatch("`[a-z_.]+`", row[0])}
    # a further board's keys are those of the first
    fields = {key: one for key, one in keys_of(RigFile).items() if not key.startswith("more_boards.board.")}
    for before, model in (("target", BlockFile), ("board", BoardFile), ("staircase", StaircaseFile)):
        assert {f"{before}.{name}" for name in model.model_fields} <= set(fields)
    assert set(rows) == set(fields)
    for key, field in fields.items():
        default = field.get_default(call_default_factory=True)
        default = default.use if isinstance(default, StageChoice) else default
        assert rows[key][1] == ("required" if field.is_required() else text_of(default)), key


def complete(first: str) -> list[str]:
    paths = [*REFERENCE.rglob("*.md"), *(ROOT / "docs" / "how-to").glob("*.md")]
    texts = [text for path in paths for _, text in blocks(path.read_text("utf-8"), "yaml")]
    found = [text for text in texts if text.startswith(first)]
    assert found
    return found


def test_every_complete_recipe_in_the_pages_loads(tmp_path: Path, rig: Any) -> None:
    for content in complete("roemetry: 1\n"):
        data = parse(content, "the page").data
        if "calibration" in data:
            rig.calibration().save(tmp_path / data["calibration"])
        path = tmp_path / "recipe.yaml"
        path.write_text(content, "utf-8")
        assert set(Recipe.load(path).stages) - {"aligner"} == set(data["stages"]) - {"aligner"}, content


def test_every_complete_rig_in_the_pages_loads(tmp_path: Path) -> None:
    for content in complete("roemetry_rig: 1\n"):
        data = parse(content, "the page").data
        for name in (name for names in data["images"].values() for name in names):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name.replace("*", "1")).touch()
        (tmp_path / "rig.yaml").write_text(content, "utf-8")
        for target in complete("kind: block") if "target" in data else [""]:
            if target:
                (tmp_path / data["target"]).write_text(target, "utf-8")
            rig = Rig.load(tmp_path / "rig.yaml")
            assert (rig.block is not None) == bool(target)
            assert sum(map(len, rig.images.values())) >= 2


def test_the_keys_of_a_calibration_are_those_that_are_written(rig: Any) -> None:
    text = page("calibration-file.md")
    drawn = rig.calibration().to_dict()
    shipped = Calibration.load(ROOT / "recipes" / "herring_roe" / "calibration.yaml").to_dict()
    assert set(shipped) == set(drawn)
    rows = section(text, "## Keys").split("### ")[0]
    assert set(firsts(rows)) == set(shipped)
    # the shipped calibration was made before the lens was taken out; readers take a missing one for 0
    parameters = set(firsts(section(text, "### Parameters of `block-linear`")))
    assert parameters - {"bow_per_px2"} == set(shipped["parameters"]) - {"bow_per_px2"}
    assert set(firsts(section(text, "### Residuals of `block-linear`"))) == set(shipped["residuals"])
    assert set(coded(section(text, "### Target"))) == set(shipped["target"])
    for key in ("image_size", "extractor"):
        (row,) = [row for row in table(rows) if coded(row[0]) == [key]]
        assert set(coded(row[-1])) == set(shipped[key])


REGISTRY = discover()


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_has_a_page_with_exactly_its_options(name: str) -> None:
    text = page(f"plugins/{name}.md")
    assert text.startswith(f"# {name}\n")
    fields: dict[str, Any] = {}
    for stage in REGISTRY.stages:
        if stage.entry.name == name:
            assert re.search(rf"^Kinds?: .*\b{stage.entry.kind}\b", text, flags=re.MULTILINE)
            fields |= REGISTRY.load(stage).Options.model_fields
    part = section(text, "## Options")
    rows = {coded(row[0])[0]: row for row in table(part)}
    assert set(rows) == set(fields)
    if not fields:
        assert "It has no options." in part
    for option, field in fields.items():
        _, default, bounds, meaning = rows[option]
        assert default == text_of(field.default), option
        assert len(meaning) > 10, option
        for rule in field.metadata:
            for bound in [getattr(rule, name) for name in ("ge", "gt", "le", "lt") if hasattr(rule, name)]:
                found = re.search(rf"(?<![\d.]){bound:g}(?![\d.])", bounds)
                assert found, f"{option}: {bound} not in {bounds!r}"
        if get_origin(field.annotation) is Literal:
            assert set(coded(bounds)) == {str(one) for one in get_args(field.annotation)}, option


def test_there_is_no_page_of_a_stage_that_is_not_there() -> None:
    assert sorted(path.stem for path in (REFERENCE / "plugins").glob("*.md")) == STAGES


@pytest.mark.parametrize("name", STAGES)
def test_the_example_of_a_stage_is_legal_and_uses_it(name: str) -> None:
    used = set()
    for _, content in blocks(page(f"plugins/{name}.md"), "yaml"):
        data = parse(content, name).data
        choices = [*data.get("stages", {}).items(), *(("sink", c) for c in data.get("sinks", []))]
        choices += [(kind, data[kind]) for kind in ("calibrator", "simulator", "feed") if kind in data]
        choices += [("outlet", choice) for choice in data.get("outlets", [])]
        # a scene's `simulator` names its planner as well, where there is one
        planned = any(s.entry.name == name for s in REGISTRY.of_kind("planner"))
        choices += [("planner", data["simulator"]) for _ in range("simulator" in data and planned)]
        if "source" in data:
            source = {"use": "image-files"} | data["source"]
            choices.append(("source", {"use": source["use"], "options": source.get("options", {})}))
            _, faults = checked(RecipeFile.model_fields["source"].annotation, source, str)  # type: ignore[arg-type]
            assert not faults
        for kind, choice in choices:
            choice = {"use": choice} if isinstance(choice, str) else choice
            (found,) = (one for one in REGISTRY.of_kind(kind) if one.entry.name == choice["use"])
            stage = REGISTRY.load(found)  # `find` refuses where a camera's library is not installed
            stage.Options.model_validate(choice.get("options", {}))
            used.add((kind, choice["use"]))
    assert used >= {(s.entry.kind, name) for s in REGISTRY.stages if s.entry.name == name}


@pytest.mark.parametrize("kind", KINDS)
def test_the_contract_of_a_kind_is_what_the_code_says(kind: str) -> None:
    path = REFERENCE / "contracts" / f"{kind}.md"
    written = path.read_text("utf-8") if path.exists() else ""
    again = "write them again: python -m docs.reference_tables docs/reference"
    assert written == contract(kind, REGISTRY), again


SOURCES = sorted(path for folder in ("roemetry", "plugins") for path in (ROOT / folder).rglob("*.py"))


def test_the_drawing_of_the_packages_is_that_of_the_imports() -> None:
    assert DIAGRAM.read_text("utf-8") == drawing(), "write it anew: python -m benchmarks packages"


def test_every_error_that_reaches_users_is_told_with_its_exit_code() -> None:
    text = (REFERENCE / "errors.md").read_text("utf-8")
    told = dict(re.findall(r"^\| `(\w+Error)` \|.*\| (\d+) \|$", text, flags=re.MULTILINE))
    there = {
        name: str(found.exit_code)
        for name, found in vars(errors).items()
        if isinstance(found, type) and issubclass(found, errors.RoemetryError)
    }
    assert told == there


def test_only_our_own_error_class_is_made_for_users() -> None:
    """No plugin brings a child of its own: the exit codes of the page would not hold for it."""
    child = re.compile(rf"^ *class \w+\([^)]*\b({'|'.join(vars(errors))})\b", flags=re.MULTILINE)
    others = [path for path in SOURCES if path.name != "errors.py"]
    assert [path.name for path in others if child.search(path.read_text("utf-8"))] == []
    assert child.search("class Own(DataError):")


def test_what_is_raised_stands_in_a_section_of_its_own() -> None:
    """One form for all docstrings, numpy's: ruff checks sections, not sentences that should be one."""
    sentence = re.compile(r"\bRaises:? [A-Z]\w*Error\b")
    assert [path.name for path in SOURCES if sentence.search(path.read_text("utf-8"))] == []
    assert sentence.search("Raises DataError: it is not there.")


def test_every_variable_of_the_environment_and_every_first_key_of_a_file_is_told() -> None:
    core = "".join(path.read_text("utf-8") for path in SOURCES if path.is_relative_to(ROOT / "roemetry"))
    told = {word.split("=")[0] for word in firsts(section(page("command-line.md"), "## Environment"))}
    assert told == set(re.findall(r"\"(ROEMETRY_[A-Z]+)\"", core))
    text = "".join(path.read_text("utf-8") for path in SOURCES)
    told = set(re.findall(r"^\| `(roemetry_\w+)` \|", page("file-formats.md"), flags=re.MULTILINE))
    assert told == set(re.findall(r"[\"{ ](roemetry_[a-z]+)(?:\"?: (?:1|Literal\[1\]|_?VERSION))", text))


def named_benchmarks() -> dict[str, set[str]]:
    """By benchmark, the options with which it is named somewhere."""
    found: dict[str, set[str]] = {}
    for path in [*PAGES, *sorted((ROOT / "recipes").rglob("*.md"))]:
        text = path.read_text("utf-8").replace("\\\n", " ")
        for name, rest in re.findall(r"python -m\s+benchmarks\s+([a-z_]+)([^`\n]*)", text):
            found.setdefault(name, set()).update(re.findall(r"(?<= )--[a-z][a-z-]*", rest))
    return found


def test_a_benchmark_that_is_named_takes_the_options_it_is_named_with(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    named = named_benchmarks()
    assert named
    for name, options in named.items():
        assert name in BENCHMARKS
        monkeypatch.setattr(sys, "argv", [name, "--help"])
        with pytest.raises(SystemExit):
            importlib.import_module(f"benchmarks.{name}").main()
        assert options <= set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out)), name
