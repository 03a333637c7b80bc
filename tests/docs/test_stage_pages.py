"""A stage and a kind have pages that say what their code says."""

from __future__ import annotations

import re
from typing import Any, Literal, get_args, get_origin

import pytest

from docs.reference_tables import contract
from roemetry.config.recipe_file import RecipeFile
from roemetry.config.validation import checked
from roemetry.io.yaml_source import parse
from roemetry.stages.hookspecs import KINDS
from roemetry.stages.registry import discover
from tests.docs.reading import REFERENCE, STAGES, blocks, coded, page, section, table, text_of

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
