"""Recipes: every mistake is named with its place, in file and schema; a right one resolves twice."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from pydantic import Field

from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import StageChoice
from roemetry.config.resolve import StageResolver, misfit_of
from roemetry.config.schemas import schema_of
from roemetry.errors import ConfigurationError
from roemetry.io.files import sha256_of
from roemetry.io.yaml_source import read
from roemetry.records import Product, Volume, Weight
from roemetry.stages import StageOptions, Weigher
from roemetry.stages.hookspecs import StageEntry
from roemetry.stages.registry import Provider, Registered, Registry, discover

GOOD = """\
roemetry: 1
product: dome
source:
  path: images
stages:
  extractor:
    use: dominant-peak
    options:
      threshold: 60
  coder: window-tracking
sinks: [csv]
"""


TABLE = "{use: grade-table, options: {classes: []}}"
OPTIONS = "    options:\n      threshold: 60"
END = "sinks: [csv]\n"

MISTAKES = [
    ("empty file", GOOD, "", ":1:1:", "the file is empty"),
    ("only a comment", GOOD, "# nothing\n", ":1:1:", "the file is empty"),
    ("a list", GOOD, "- a\n- b\n", ":1:1:", "expected a map"),
    ("a bracket left open", GOOD, "roemetry: [1\nproduct: x\n", ":1:11:", "write `]`"),
    ("a bracket left open at the end", "[csv]", "[csv", ":11:8:", "write `]`"),
    ("a quote left open", "images", '"images', ":4:9:", "this quote is not closed"),
    ("no colon", "product:", "product", ":2:1:", "write `key: value`"),
    ("no space after the colon", "product: ", "product:", ":2:1:", "write `key: value`"),
    ("a colon in a value", "dome", "dome: small", ":2:14:", "a second `: ` in this line"),
    ("one space too many", "  coder", "   coder", ":10:4:", "after 3 spaces"),
    ("one space too few", "  coder", " coder", ":10:2:", "after 0 or 2"),
    ("options outside their stage", OPTIONS, "    threshold: 60", ":8:5:", "stand below `options:`"),
    ("options below the short form", "king", "king\n    x: 5", ":11:6:", "the line above has a value"),
    ("a merge left unfinished", "sinks", "<<<<<<< mine\nsinks", ":11:1:", "keep one side"),
    ("a Windows path in quotes", "images", '"C:\\users"', ":4:12:", "use ' quotes, or /"),
    ("an asterisk", "images", "*.png", ":4:9:", "in quotes"),
    ("a word that begins with @", "dome", "@dome", ":2:10:", "in quotes"),
    ("a wrong unit", "60", "60 grey", ":9:7:", "a number alone"),
    ("a decimal comma", "60", "0,5", ":9:7:", "after a point"),
    ("a decimal comma in a map", OPTIONS, "    options: {threshold: 0,5}", ":8:28:", "decimals with a point"),
    ("a list for options", OPTIONS, "    options: [threshold, 60]", ":8:5:", "found a list, expected a map"),
    ("an empty table", "sinks", f"  grader: {TABLE}\nsinks", ":11:40:", "1 or more, found an empty list"),
    ("a fraction of a draw", END, END + "draws: 2.5\n", ":12:1:", "expected a whole number, found 2.5"),
    ("a word for a list", "[csv]", "csv", ":11:1:", "expected a list: `[one, two]`"),
    ("grey in American", "images", "images\n  channel: gray", ":5:3:", "did you mean `grey`?"),
    ("a plugin of another kind", "window-tracking", "dominant-peak", ":10:3:", "belongs under `extractor`"),
    ("two documents", END, END + "---\nproduct: x\n", ":12:1:", "a second document"),
    ("a tab", "  path", "\tpath", ":4:1:", "tab"),
    ("a key twice", END, END + "product: again\n", ":12:1:", "`product` stands here a second time"),
    ("a stage twice", "sinks:", "  extractor: steger\nsinks:", ":11:3:", "stands here a second"),
    ("unknown key", END, END + "calibratoin: x.yaml\n", ":12:1:", "did you mean `calibration`?"),
    (
        "unknown key in a list of maps in a map",
        "sinks:",
        "  grader: {use: grade-table, options: {classes: [{lable: A}]}}\nsinks:",
        ":11:51:",
        "did you mean `label`?",
    ),
    ("unknown key in source", "path:", "paht:", ":4:3:", "did you mean `path`?"),
    ("missing key", "product: dome\n", "", ":1:1:", "product: this is missing"),
    ("misspelt plugin", "dominant-peak", "dominant-paek", ":7:5:", "did you mean `dominant-peak`?"),
    ("misspelt short form", "window-tracking", "window-traking", ":10:3:", "window-tracking"),
    ("unknown option", "threshold", "treshold", ":9:7:", "did you mean `threshold`?"),
    ("neither a number nor the word", "60", "autp", ":9:7:", "'auto', found 'autp'; did you mean `auto`?"),
    ("out of bounds", "60", "-4", ":9:7:", "found -4"),
    ("a word for a number", "60", "high", ":9:7:", "found 'high'"),
    ("a list for a map", "  path: images", "  - images", ":3:1:", "found a list"),
    ("wrong version", "roemetry: 1", "roemetry: 7", ":1:1:", "found 7"),
    ("wrong turn", "images", "images\n  turn_deg: 45", ":5:3:", "found 45"),
    ("a stage without its input", "sinks", "  volume: zero-order-hold\nsinks", ":11:3:", "triangulator"),
    ("a missing calibration", END, END + "calibration: no.yaml\n", ":12:1:", "cannot be read"),
    ("stages left out", GOOD, "roemetry: 1\nproduct: x\nsource: {path: y}\n", ":1:1:", "stages: this is"),
]  # fmt: skip
"""What is done to the recipe, and where which words of the fault stand."""


@pytest.mark.parametrize(
    ("old", "new", "place", "says"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES]
)
def test_a_mistake_is_named_with_its_place(tmp_path: Path, old: str, new: str, place: str, says: str) -> None:
    assert old in GOOD
    path = tmp_path / "recipe.yaml"
    path.write_text(GOOD.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        Recipe.load(path)
    assert f"recipe.yaml{place}" in str(caught.value)
    assert says in str(caught.value)


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(
        GOOD.replace("threshold: 60", "threshold: -4").replace("window-tracking", "nothing-such"),
        encoding="utf-8",
    )
    with pytest.raises(ConfigurationError) as caught:
        Recipe.load(path)
    assert len(caught.value.faults) == 2


def test_set_changes_and_is_named_in_faults(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(GOOD, encoding="utf-8")
    changed = Recipe.load(path, sets=["stages.extractor.options.threshold=80"])
    assert changed.stages["extractor"].options.model_dump()["threshold"] == 80
    reached = Recipe.load(path, sets=["stages.coder.options.smallest_area_px=5"])
    assert reached.stages["coder"].options.model_dump()["smallest_area_px"] == 5
    with pytest.raises(ConfigurationError, match="--set stages.extractor.options.threshold=x"):
        Recipe.load(path, sets=["stages.extractor.options.threshold=x"])
    with pytest.raises(ConfigurationError, match="expected key.key=value"):
        Recipe.load(path, sets=["threshold"])


def test_a_path_set_on_the_command_line_is_relative_to_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    path = tmp_path / "recipe.yaml"
    path.write_text(GOOD, encoding="utf-8")
    monkeypatch.chdir(tmp_path / "here")
    assert Recipe.load(path, sets=["source.path=pictures"]).source_path == tmp_path / "here" / "pictures"
    assert Recipe.load(path).source_path == tmp_path / "images"


def test_the_hash_tells_what_decides_a_number(line: Callable[..., Path]) -> None:
    path = line()
    plain = Recipe.load(path)
    assert plain.sha256 == Recipe.load(path).sha256
    assert plain.sha256 == Recipe.load(path, sets=["source.path=elsewhere"]).sha256
    assert plain.sha256 != Recipe.load(path, sets=["stages.extractor.options.threshold=61"]).sha256


def test_a_calibration_of_another_method_is_refused(line: Callable[..., Path]) -> None:
    path = line()
    calibration = path.with_name("calibration.yaml")
    calibration.write_text(
        calibration.read_text(encoding="utf-8").replace("method: block-linear", "method: pinhole-plane"),
        encoding="utf-8",
    )
    with pytest.raises(ConfigurationError, match="made by `pinhole-plane`"):
        Recipe.load(path)


class TableOptions(StageOptions):
    table: Path = Field(description="weighed samples")


class FromTable(Weigher[TableOptions]):
    def weigh(self, product: Product, volume: Volume, *, rng: object = None) -> Weight:
        raise NotImplementedError


class OneStage:
    """A registry with one stage."""

    def find(self, kind: str, name: str) -> Registered:
        entry = StageEntry(kind, name, "somewhere:FromTable", "by a table", "our own")
        return Registered(entry, Provider("test", "1", "test"))

    def load(self, registered: Registered) -> type[FromTable]:
        return FromTable


def chooser(folder: Path) -> StageResolver:
    return StageResolver(OneStage(), lambda at: "recipe.yaml:3:5", folder)  # type: ignore[arg-type]


def test_a_file_is_looked_for_beside_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "weighed.csv").write_text("a,b\n", encoding="utf-8")
    choice = StageChoice(use="from-table", options={"table": "weighed.csv"})
    chosen = chooser(tmp_path).choose("weigher", choice, "stages", "weigher")
    assert chosen.make().options.table == tmp_path / "weighed.csv"
    told = chosen.described()["options"]["table"]
    assert told == f"weighed.csv sha256 {sha256_of(tmp_path / 'weighed.csv')}"
    assert str(tmp_path) not in str(chosen.described())
    asked = chooser(tmp_path)
    asked.choose("weigher", StageChoice(use="from-table", options={"table": "no.csv"}), "stages", "weigher")
    (fault,) = asked.faults
    assert fault.startswith("recipe.yaml:3:5: stages.weigher.options.table: there is no file")
    assert fault.endswith("no.csv")


class NoVerb(Weigher[TableOptions]):
    pass


@pytest.mark.parametrize(
    ("cls", "kind", "says"),
    [
        (FromTable, "extractor", "class FromTable does not inherit from `roemetry.stages.Extractor`"),
        (int, "volume", "class int does not inherit from `roemetry.stages.VolumeEstimator`"),
        (NoVerb, "weigher", "class NoVerb does not define `weigh`"),
        (FromTable, "weigher", None),
        (type("Inherits", (FromTable,), {}), "weigher", None),
    ],
)
def test_a_class_that_cannot_be_a_stage_is_told_why(cls: type, kind: str, says: str | None) -> None:
    assert misfit_of(cls, kind) == says


@cache
def schema(kind: Any) -> Draft202012Validator:
    made = schema_of(kind, discover())
    Draft202012Validator.check_schema(made)
    return Draft202012Validator(made)


def good() -> dict[str, Any]:
    return {
        "roemetry": 1,
        "product": "dome",
        "source": {"path": "images", "options": {"dark": "{name}_dark.png"}},
        "stages": {
            "extractor": {"use": "dominant-peak", "options": {"threshold": 60}},
            "coder": "window-tracking",
        },
        "sinks": ["csv", {"use": "report"}],
    }


def changed(*path: str | int, to: Any) -> dict[str, Any]:
    data: Any = good()
    node = data
    for step in path[:-1]:
        node = node[step]
    node[path[-1]] = to
    return dict(data)


SHIPPED = [
    pytest.param(path, kind, id=f"{path.parent.name}/{path.name}")
    for path in sorted((Path(__file__).parents[2] / "recipes").rglob("*.yaml"))
    for key, kind in (("roemetry", "recipe"), ("roemetry_rig", "rig"), ("roemetry_scene", "scene"))
    if f"\n{key}: " in "\n" + path.read_text("utf-8")
]


@pytest.mark.parametrize(("path", "kind"), SHIPPED)
def test_every_shipped_file_is_valid(path: Path, kind: Any) -> None:
    assert not list(schema(kind).iter_errors(read(path).data))


@pytest.mark.parametrize(
    "wrong",
    [
        changed("prodcut", to="x"),
        changed("stages", "extractor", "use", to="dominant-paek"),
        changed("stages", "extractor", "options", "threshold", to=-4),
        changed("stages", "extractor", "options", "threshold", to="high"),
        changed("stages", "extractor", "options", "treshold", to=60),
        changed("stages", "coder", to="dominant-peak"),
        changed("stages", "extractor", to=None),
        changed("source", "options", "drak", to="x"),
        changed("source", "turn_deg", to=45),
        changed("sinks", to=["no-such-sink"]),
    ],
    ids=str,
)
def test_a_wrong_recipe_is_marked(wrong: dict[str, Any]) -> None:
    assert list(schema("recipe").iter_errors(wrong))
    assert not list(schema("recipe").iter_errors(good()))
    assert not list(schema("recipe").iter_errors(changed("stages", "coder", to="somebody/their-coder")))
    assert not list(schema("recipe").iter_errors(changed("stages", "coder", to=None)))


def test_a_stage_that_cannot_be_imported_is_known_by_name() -> None:
    registry = discover()
    broken = [
        type(stage)(
            type(stage.entry)(stage.entry.kind, stage.entry.name, "no_such_module:Nothing", "gone", "none"),
            stage.provider,
        )
        for stage in registry.of_kind("extractor")
    ]
    others = [stage for stage in registry.stages if stage.entry.kind != "extractor"]
    made = schema_of("recipe", Registry((*others, *broken), ()))
    data = changed("stages", "extractor", "options", "anything", to=3)
    assert not list(Draft202012Validator(made).iter_errors(data))
