"""Schemas accept what roemetry accepts, and refuse what an editor should mark."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from typer.testing import CliRunner

from roemetry.cli.main import app
from roemetry.config.schemas import schema_of
from roemetry.io.yaml_source import read
from roemetry.stages.registry import Registry, discover


@pytest.fixture(scope="module")
def recipe() -> Draft202012Validator:
    schema = schema_of("recipe", discover())
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


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


def test_a_good_recipe_is_valid(recipe: Draft202012Validator) -> None:
    assert not list(recipe.iter_errors(good()))
    assert not list(recipe.iter_errors(changed("stages", "coder", to="somebody/their-coder")))
    assert not list(recipe.iter_errors(changed("stages", "coder", to=None)))


SHIPPED = sorted((Path(__file__).parents[2] / "recipes").rglob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_shipped_file_is_valid(path: Path) -> None:
    data = read(path).data
    kinds = {"roemetry": "recipe", "roemetry_rig": "rig", "roemetry_scene": "scene"}
    kind = next((kinds[key] for key in data if key in kinds), None)
    if kind is None:
        pytest.skip("another kind of file")
    errors = list(Draft202012Validator(schema_of(kind, discover())).iter_errors(data))  # type: ignore[arg-type]
    assert not errors


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
def test_a_wrong_recipe_is_marked(recipe: Draft202012Validator, wrong: dict[str, Any]) -> None:
    assert list(recipe.iter_errors(wrong))


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
    schema = schema_of("recipe", Registry((*others, *broken), ()))
    data = changed("stages", "extractor", "options", "anything", to=3)
    assert not list(Draft202012Validator(schema).iter_errors(data))


def test_the_verb_writes_a_file_and_names_what_it_knows(tmp_path: Path) -> None:
    file = tmp_path / "recipe.schema.json"
    assert CliRunner().invoke(app, ["schema", "recipe", "--out", str(file)]).exit_code == 0
    assert "Draft202012" in repr(Draft202012Validator(read(file).data))
    refused = CliRunner().invoke(app, ["schema", "recipes"])
    assert refused.exception is not None
    assert "recipe, rig, scene" in str(refused.exception)
