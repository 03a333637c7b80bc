"""The reference pages say what the program has: no option, key, reason or column is missing or made up."""

from __future__ import annotations

import ast
import dataclasses
import json
import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest
import typer
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from roemetry import records
from roemetry.calibration import Calibration
from roemetry.cli.main import app
from roemetry.cli.reference_tables import rewritten
from roemetry.hookspecs import KINDS
from roemetry.recipe import Recipe
from roemetry.recipe_file import RecipeFile, StageChoice
from roemetry.record import PROVENANCE, RECORD
from roemetry.records import Status
from roemetry.registry import discover
from roemetry.rig import Rig, RigFile
from roemetry.runner import run_recipe
from roemetry.stages import StageOptions
from roemetry.target_file import BlockFile, BoardFile, StaircaseFile
from roemetry.testing.catalogue import contract
from roemetry.validation import checked
from roemetry.yaml_source import parse

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = ROOT / "docs" / "reference"
PAGES = sorted([*REFERENCE.rglob("*.md"), *(ROOT / "docs" / "how-to").glob("*.md")])
CLI = typer.main.get_command(app)
VERBS: dict[str, Any] = dict(CLI.commands)  # type: ignore[attr-defined]
STAGES = sorted({stage.entry.name for stage in discover().stages})


def page(name: str) -> str:
    return (REFERENCE / name).read_text("utf-8")


def section(text: str, heading: str) -> str:
    """From a heading to the next one of the same or a higher level."""
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.split(" {")[0] == heading), None)
    assert begin is not None, f"no heading {heading!r}"
    level = len(heading) - len(heading.lstrip("#"))
    fenced = False
    for end in range(begin + 1, len(lines)):
        fenced ^= lines[end].startswith("```")
        if not fenced and re.match(rf"#{{1,{level}}} ", lines[end]):
            return "\n".join(lines[begin:end])
    return "\n".join(lines[begin:])


def table(text: str) -> list[list[str]]:
    """Cells of all table rows whose first cell begins with code."""
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in row] for row in rows]


def coded(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def firsts(text: str) -> list[str]:
    """All that stands as code in the first cells of a text's tables."""
    return [word for row in table(text) for word in coded(row[0])]


FENCE = re.compile(r'^( *)```(\w*)(?: title="([^"]*)")?\n(.*?)^\1```$', flags=re.MULTILINE | re.DOTALL)


def blocks(text: str, language: str) -> list[tuple[str, str]]:
    """(title, content) of fenced blocks, also indented ones."""
    return [
        (title or "", re.sub(rf"^{indent}", "", content, flags=re.MULTILINE))
        for indent, named, title, content in FENCE.findall(text)
        if named == language
    ]


# The command line


def options_of(command: Any) -> set[str]:
    shown = {option for p in command.params if p.param_type_name == "option" for option in p.opts}
    return shown | {"--help", "-h"}


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_the_tables_of_the_command_line_are_the_options(verb: str) -> None:
    part = section(page("command-line.md"), f"## `{f'roemetry {verb}'.strip()}`")
    rows = [row for row in table(part) if row[0].startswith("`-")]
    assert {word for row in rows for word in coded(row[0])} == options_of(VERBS[verb] if verb else CLI)
    assert all(len(row[-1]) > 10 for row in rows), "an option without an explanation"
    if verb:
        assert f"roemetry {verb} " in "".join(content for _, content in blocks(part, "")), "no example"


@pytest.mark.parametrize("name", ["command-line.md", "recipe.md"])
def test_what_a_page_takes_from_the_code_is_what_the_code_says(name: str) -> None:
    again = rewritten(page(name))
    assert again == page(name), "write them again: python -m roemetry.cli.reference_tables docs/reference"
    assert again.count("<!-- from the code:") == again.count("<!-- to here -->") > 3


def test_every_verb_and_no_other_stands_in_the_list_of_verbs() -> None:
    overview = page("command-line.md").split("## Exit codes")[0]
    assert firsts(overview.replace("[`", "`")) == list(VERBS)


def test_every_exit_code_is_told() -> None:
    rows = section(page("command-line.md"), "## Exit codes")
    assert re.findall(r"^\| (\d+) \|", rows, flags=re.MULTILINE) == ["0", "1", "2", "130"]


def commands() -> list[Any]:
    """Every command of the pages but those with words in capitals, which stand for something."""
    return [
        pytest.param(line, id=f"{path.stem}: {line}")
        for path in PAGES
        for _, content in blocks(path.read_text("utf-8"), "")
        for line in content.replace("\\\n", " ").splitlines()
        if re.match(r"roemetry [a-z]+( |$)", line) and not re.search(r" [A-Z\[]{3}", line)
    ]


@pytest.mark.parametrize("line", commands())
def test_every_command_in_the_pages_can_be_parsed(line: str) -> None:
    _, verb, *words = shlex.split(line)
    assert verb in VERBS
    # Parses words and types; runs nothing. Typer may bring a click of its own, so any exception will do.
    VERBS[verb].make_context(verb, words)


def test_a_wrong_command_would_be_noticed() -> None:
    with pytest.raises(Exception, match="bogus"):
        VERBS["run"].make_context("run", ["recipe.yaml", "--bogus"])
    assert len(list(commands())) > 25


# Stages and their options


def text_of(default: object) -> str:
    if default is None:
        return "none"
    if default is PydanticUndefined:
        return "its own"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_has_a_page_with_exactly_its_options(name: str) -> None:
    registry = discover()
    text = page(f"plugins/{name}.md")
    assert text.startswith(f"# {name}\n")
    fields: dict[str, Any] = {}
    for stage in registry.stages:
        if stage.entry.name == name:
            assert re.search(rf"^Kinds?: .*\b{stage.entry.kind}\b", text, flags=re.MULTILINE)
            fields |= registry.load(stage).Options.model_fields
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
    does = "## Triangulator" if name == "block-linear" else "## What it does"
    for heading in (does, "## Source", "## Known weaknesses"):
        assert len(section(text, heading)) > len(heading) + 10


def test_there_is_no_page_of_a_stage_that_is_not_there() -> None:
    assert sorted(path.stem for path in (REFERENCE / "plugins").glob("*.md")) == STAGES


@pytest.mark.parametrize("name", STAGES)
def test_the_example_of_a_stage_is_legal_and_uses_it(name: str) -> None:
    registry = discover()
    used = set()
    for _, content in blocks(page(f"plugins/{name}.md"), "yaml"):
        data = parse(content, name).data
        choices = [*data.get("stages", {}).items(), *(("sink", c) for c in data.get("sinks", []))]
        choices += [(kind, data[kind]) for kind in ("calibrator", "simulator") if kind in data]
        # a scene's `simulator` names its planner as well
        choices += [("planner", data["simulator"]) for _ in range("simulator" in data)]
        if "source" in data:
            source = {"use": "image-files"} | data["source"]
            choices.append(("source", {"use": source["use"], "options": source.get("options", {})}))
            _, faults = checked(RecipeFile.model_fields["source"].annotation, source, str)  # type: ignore[arg-type]
            assert not faults
        for kind, choice in choices:
            choice = {"use": choice} if isinstance(choice, str) else choice
            stage = registry.load(registry.find(kind, choice["use"]))
            stage.Options.model_validate(choice.get("options", {}))
            used.add((kind, choice["use"]))
    assert used >= {(s.entry.kind, name) for s in registry.stages if s.entry.name == name}


@pytest.mark.parametrize("kind", KINDS)
def test_the_contract_of_a_kind_is_what_the_code_says(kind: str) -> None:
    path = REFERENCE / "contracts" / f"{kind}.md"
    written = path.read_text("utf-8") if path.exists() else ""
    again = "write them again: python -m roemetry.testing.catalogue docs/reference/contracts"
    assert written == contract(kind, discover()), again


# Files


def keys_of(model: type[BaseModel], before: str = "") -> dict[str, Any]:
    """Field by its dotted path; a chosen stage is one key."""
    found = {}
    for name, field in model.model_fields.items():
        found[before + name] = field
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel) and not issubclass(part, StageChoice):
                found |= keys_of(part, f"{before}{name}.")
    return found


def test_the_keys_of_a_recipe_are_those_of_its_model() -> None:
    part = section(page("recipe.md"), "## Keys")
    choice = section(part, "### Choosing a stage")
    rows = {coded(row[0])[0]: row for row in table(part.replace(choice, ""))}
    fields = keys_of(RecipeFile)
    assert set(rows) == set(fields)
    assert set(firsts(choice)) == set(StageChoice.model_fields)
    for key in [key for key in fields if not key.startswith("stages.")]:
        check_default(key, fields[key], rows[key][1])


def test_the_keys_of_a_rig_and_a_target_are_those_of_their_models() -> None:
    rows = {coded(row[0])[0]: row for row in table(page("rig.md")) if re.fullmatch("`[a-z_.]+`", row[0])}
    fields = keys_of(RigFile)
    for before, model in (("target", BlockFile), ("board", BoardFile), ("staircase", StaircaseFile)):
        assert {f"{before}.{name}" for name in model.model_fields} <= set(fields)
    assert set(rows) == set(fields)
    for key, field in fields.items():
        check_default(key, field, rows[key][1])


def check_default(key: str, field: Any, cell: str) -> None:
    if field.is_required():
        assert cell == "required", key
        return
    default = field.get_default(call_default_factory=True)
    if isinstance(default, list):
        default = "[" + ", ".join(choice.use for choice in default) + "]"
    elif isinstance(default, StageChoice):
        default = default.use
    assert cell == text_of(default), key


def test_choices_of_a_source_are_told() -> None:
    for model, text, before in ((RecipeFile, page("recipe.md"), "source."), (RigFile, page("rig.md"), "")):
        fields = keys_of(model)
        rows = {coded(row[0])[0]: row[-1] for row in table(text)}
        for key in ("channel", "turn_deg"):
            for legal in get_args(fields[before + key].annotation):
                assert str(legal) in rows[before + key], (key, legal)


def complete(first: str) -> list[Any]:
    return [
        pytest.param(content, id=f"{path.stem}-{index}")
        for path in PAGES
        for index, (_, content) in enumerate(blocks(path.read_text("utf-8"), "yaml"))
        if content.startswith(f"{first}: 1\n")
    ]


@pytest.mark.parametrize("content", complete("roemetry"))
def test_every_complete_recipe_in_the_pages_loads(content: str, tmp_path: Path, rig: Any) -> None:
    data = parse(content, "the page").data
    if "calibration" in data:
        rig.calibration().save(tmp_path / data["calibration"])
    path = tmp_path / "recipe.yaml"
    path.write_text(content, "utf-8")
    recipe = Recipe.load(path)
    assert set(recipe.stages) == set(data["stages"])


@pytest.mark.parametrize("content", complete("roemetry_rig"))
def test_every_complete_rig_in_the_pages_loads(content: str, tmp_path: Path) -> None:
    targets = [
        text
        for path in PAGES
        for _, text in blocks(path.read_text("utf-8"), "yaml")
        if text.startswith("kind: block")
    ]
    data = parse(content, "the page").data
    for paths in data["images"].values():
        for name in paths:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name.replace("*", "1")).touch()
    for target in targets:
        (tmp_path / data["target"]).write_text(target, "utf-8")
        (tmp_path / "rig.yaml").write_text(content, "utf-8")
        rig = Rig.load(tmp_path / "rig.yaml")
        assert rig.block is not None
        assert sum(map(len, rig.images.values())) >= 2


def test_there_are_complete_examples() -> None:
    found = [content for _, content in blocks(page("recipe.md"), "yaml")]
    stages = [set(parse(c, "").data["stages"]) for c in found if c.startswith("roemetry: 1")]
    assert {"extractor", "coder", "triangulator", "volume", "weigher", "classifier"} in stages
    assert any(content.startswith("roemetry_rig: 1") for _, content in blocks(page("rig.md"), "yaml"))


def test_the_keys_of_a_calibration_are_those_that_are_written(rig: Any) -> None:
    text = page("calibration-file.md")
    drawn = rig.calibration().to_dict()
    shipped = Calibration.load(ROOT / "recipes" / "herring_roe" / "calibration.yaml").to_dict()
    assert set(shipped) == set(drawn)
    rows = section(text, "## Keys").split("### ")[0]
    assert set(firsts(rows)) == set(shipped)
    assert set(firsts(section(text, "### Parameters of `block-linear`"))) == set(shipped["parameters"])
    assert set(firsts(section(text, "### Residuals of `block-linear`"))) == set(shipped["residuals"])
    assert set(coded(section(text, "### Target"))) == set(shipped["target"])
    for key in ("image_size", "extractor"):
        (row,) = [row for row in table(rows) if coded(row[0]) == [key]]
        assert set(coded(row[-1])) == set(shipped[key])


# Results


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run of a shipped skein with every table."""
    folder = tmp_path_factory.mktemp("run")
    home = ROOT / "recipes" / "herring_roe"
    sets = [f"source.path={home / 'images' / 'skein_02.png'}", "sinks=[csv, points]"]
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
    for file, heading in (("results.csv", "## results.csv"), ("points/skein_02.csv", "## points/*.csv")):
        header = (results / file).read_text("utf-8").splitlines()[0].split(",")
        assert firsts(section(page("results.md"), heading)) == header


def test_the_keys_of_the_provenance_are_those_that_are_written(results: Path) -> None:
    written = json.loads((results / PROVENANCE).read_text("utf-8"))
    assert set(firsts(section(page("results.md"), "## provenance.json"))) == set(written)


def test_every_status_is_told() -> None:
    assert firsts(section(page("results.md"), "## Status and exit code")) == list(get_args(Status))


# Reasons


def reason_codes() -> tuple[set[str], set[str], list[str]]:
    """Codes in the sources, endings of made-up codes, and calls that hold neither."""
    codes, endings, strange = set(), set(), []
    for folder in ("roemetry", "plugins"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
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
    kinds = [kind for kind in KINDS if kind not in ("calibrator", "sink", "simulator", "planner")]
    stages = {kind + ending for kind in kinds for ending in endings}
    text = page("reasons.md")
    broken = section(text, "## A stage refused, or failed")
    told = set(firsts(text.replace(broken, "")))
    both = {word for row in table(broken) for cell in row[:2] for word in coded(cell)}
    assert told - stages == codes - stages
    assert stages <= both


# Records


def test_every_record_is_told_with_its_fields() -> None:
    text = FENCE.sub("", page("records.md"))
    words = {word for found in coded(text) for word in re.findall(r"\w+", found)}
    headings = {"Frame": "## Acquisition and Frame"}
    with_table = 0
    for name in records.__all__:
        record = getattr(records, name)
        if not dataclasses.is_dataclass(record) or name in ("Measurement", "Coding"):
            continue  # these two are told on the page of results
        fields = {field.name for field in dataclasses.fields(record)}
        assert fields <= words, name
        if headings.get(name, f"## {name}") in text.splitlines() and name != "Trace":
            assert set(firsts(section(text, headings.get(name, f"## {name}")))) == fields, name
            with_table += 1
    assert with_table >= 8


# Messages and surroundings


def sources(*places: str) -> Iterator[ast.AST]:
    for place in places:
        home = ROOT / place
        for path in sorted(home.rglob("*.py")) if home.is_dir() else [home]:
            yield from ast.walk(ast.parse(path.read_text("utf-8")))


def words_of(node: ast.AST | None) -> list[str]:
    """Give the fixed parts of a text."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return [p.value for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)]


def test_every_refusal_of_calibrating_and_of_the_papers_stages_is_told() -> None:
    text = page("rig.md") + page("reasons.md")
    refusals = []
    for node in sources("plugins/roemetry_paper", "roemetry/calibrating.py"):
        name = getattr(getattr(node, "func", None), "id", "")
        if isinstance(node, ast.Call) and name in ("CalibrationError", "StageError"):
            refusals.append(max(words_of(node.args[0]), key=len, default=""))
    assert len(refusals) > 15
    for refusal in filter(None, refusals):
        assert refusal.strip(" :(`")[:18] in text, refusal


def test_messages_that_the_pages_quote_are_in_the_sources() -> None:
    said = " ".join(word for node in sources("roemetry", "plugins") for word in words_of(node))
    tables = [
        section(page("rig.md"), "## Refusals"),
        section(page("recipe.md"), "## What messages look like"),
        section(page("calibration-file.md"), "## Faults"),
        section(page("command-line.md"), "## `roemetry plugins`").split("<!-- to here -->")[1],
    ]
    quoted = [
        row[0].strip("` ") for text in tables for row in re.findall(r"^\| (`[^|]+) \|", text, flags=re.M)
    ]
    assert len(quoted) > 25
    for message in quoted:
        for piece in re.split("…|PROVIDER|: 1|1$", message):
            assert piece.strip(" `()") in said, message


def test_every_variable_of_the_environment_is_told() -> None:
    read = {w for node in sources("roemetry") for w in words_of(node) if re.fullmatch("ROEMETRY_[A-Z]+", w)}
    told = {word.split("=")[0] for word in firsts(section(page("command-line.md"), "## Environment"))}
    assert told == read


# Links


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_links_lead_somewhere(path: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(#[^)\s]*)?\)", path.read_text("utf-8")):
        aim = path if not target else (path.parent / target).resolve()
        if ROOT / "docs" / "explanation" in aim.parents:
            continue  # those pages have a test of their own: mkdocs build --strict
        assert aim.is_file(), target
        if anchor:
            assert anchor[1:] in anchors(aim.read_text("utf-8")), f"{target}{anchor}"


def anchors(text: str) -> set[str]:
    found = set()
    for heading in re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE):
        own = re.search(r"\{ #(\S+) \}", heading)
        plain = re.sub(r"[^\w\s-]", "", heading.split(" {")[0].lower()).strip()
        found.add(own[1] if own else re.sub(r"[-\s]+", "-", plain))
    return found


# The plugin of the how-to page


def test_the_plugin_of_the_page_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "how-to" / "write-a-plugin.md").read_text("utf-8")
    files = {title: content for language in ("toml", "python") for title, content in blocks(text, language)}
    assert set(files) == {
        "pyproject.toml",
        "roemetry_centroid/__init__.py",
        "roemetry_centroid/extractor.py",
        "tests/test_run_centroid.py",
        "tests/test_contract.py",
    }
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    try:
        registry = discover([EntryPoint("centroid", "roemetry_centroid", "roemetry")])
        assert registry.broken == ()
        stage = registry.load(registry.find("extractor", "run-centroid"))
        assert issubclass(stage.Options, StageOptions)
        tests = runpy.run_path(str(tmp_path / "tests" / "test_run_centroid.py"))
        found = [tests[name] for name in tests if name.startswith("test_")]
        assert len(found) == 3
        for test in found:
            test()
    finally:
        for name in [name for name in sys.modules if name.startswith("roemetry_centroid")]:
            del sys.modules[name]
