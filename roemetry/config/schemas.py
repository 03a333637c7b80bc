"""JSON schemas of the files people write, with the options of every installed stage: for editors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel

from roemetry.config.recipe_file import RecipeFile, StageChoices
from roemetry.config.rig import RigFile
from roemetry.config.scene import SceneFile
from roemetry.errors import PluginError
from roemetry.stages.registry import Registered, Registry

FileKind = Literal["recipe", "rig", "scene"]

_FILES: dict[FileKind, type[BaseModel]] = {"recipe": RecipeFile, "rig": RigFile, "scene": SceneFile}
_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema_of(kind: FileKind, registry: Registry) -> dict[str, Any]:
    """Give the JSON schema (draft 2020-12) of a kind of file.

    A stage that cannot be imported here is known by its name only. What one option demands of another stays
    for `roemetry lint` to say.
    """
    model = _FILES[kind]
    schema: dict[str, Any] = {"$schema": _DIALECT, "title": f"roemetry {kind}"}
    schema |= model.model_json_schema() | {"title": f"roemetry {kind}"}
    definitions = schema.setdefault("$defs", {})
    if kind == "recipe":
        chain = definitions[StageChoices.__name__]["properties"]
        for name in StageChoices.model_fields:
            optional = {"type": "null"} in chain[name].get("anyOf", ())
            chain[name] = _choice(name, registry, definitions, optional=optional)
        schema["properties"]["source"] = _source(registry, definitions)
        schema["properties"]["sinks"]["items"] = _choice("sink", registry, definitions)
    else:
        for name in ("extractor", "calibrator") if kind == "rig" else ("simulator",):
            schema["properties"][name] = _choice(name, registry, definitions)
    definitions.pop("StageChoice", None)
    return schema


def _choice(
    kind: str, registry: Registry, definitions: dict[str, Any], *, optional: bool = False
) -> dict[str, Any]:
    """A stage by its name alone, or by its name with its options."""
    stages = registry.of_kind(kind)
    names = sorted({stage.entry.name for stage in stages})
    ways: list[dict[str, Any]] = [
        {"enum": names},
        {"type": "string", "pattern": "^[^/]+/[^/]+$", "description": "provider/name"},
        *(_with_options(stage, registry, definitions) for stage in stages),
        {
            "type": "object",
            "properties": {
                "use": {"type": "string", "pattern": "^[^/]+/[^/]+$"},
                "options": {"type": "object"},
            },
            "required": ["use"],
            "additionalProperties": False,
        },
    ]
    return {"anyOf": [*ways, {"type": "null"}] if optional else ways}


def _with_options(stage: Registered, registry: Registry, definitions: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "description": stage.entry.summary,
        "properties": {
            "use": {"const": stage.entry.name, "description": stage.entry.summary},
            "options": _options(stage, registry, definitions),
        },
        "required": ["use"],
        "additionalProperties": False,
    }


def _source(registry: Registry, definitions: dict[str, Any]) -> dict[str, Any]:
    """What every source has, and below `options` what each of them takes."""
    plain = definitions.pop("SourceChoice")
    default = plain["properties"]["use"]["default"]
    names = sorted({stage.entry.name for stage in registry.of_kind("source")})
    plain["properties"]["use"] |= {"examples": names}
    plain["allOf"] = [
        {
            "if": _uses(stage.entry.name, required=stage.entry.name != default),
            "then": {"properties": {"options": _options(stage, registry, definitions)}},
        }
        for stage in registry.of_kind("source")
    ]
    return dict(plain)


def _uses(name: str, *, required: bool) -> dict[str, Any]:
    said = {"properties": {"use": {"const": name}}}
    return said | {"required": ["use"]} if required else said


def _options(stage: Registered, registry: Registry, definitions: dict[str, Any]) -> Mapping[str, Any]:
    """Give a reference to the schema of a stage's options, which is put among the definitions."""
    called = f"{stage.entry.kind}.{stage.provider.name}.{stage.entry.name}"
    if called not in definitions:
        try:
            if stage.missing is not None:
                raise PluginError(stage.missing)
            options = registry.load(stage).Options
        except PluginError as error:
            definitions[called] = {"type": "object", "description": f"not known here: {error.message}"}
        else:
            schema = options.model_json_schema(ref_template=f"#/$defs/{called}.{{model}}")
            for name, inner in schema.pop("$defs", {}).items():
                definitions[f"{called}.{name}"] = inner
            definitions[called] = schema
    return {"$ref": f"#/$defs/{called}"}
