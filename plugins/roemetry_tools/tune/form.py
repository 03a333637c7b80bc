"""What the form is made of: the chain as it stands, every plugin that might stand there, and their options.

An option's schema says whether it becomes a slider, a choice, a switch or a text.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import NEEDS, SourceChoice
from roemetry.errors import RoemetryError
from roemetry.stages.registry import Registered, Registry
from roemetry_tools.tune.editing import inline
from roemetry_tools.tune.request import KINDS, stages_of

_AS_WRITTEN = ("px", "mm", "rows", "g", "days", "samples")
_UNITS = {name: name for name in _AS_WRITTEN} | {"mm2": "mm²", "mm3": "mm³", "cm3": "cm³", "deg": "°"}
_UNITS |= {"sigmas": "σ", "grey": "grey levels"}
"""By the last part of an option's name."""


Field = dict[str, Any]
"""One field of the form, as JSON has it.

What fits no other kind, ``yaml``, is written as in the recipe, on one line. `words` (and null) may replace a
number, a text or a file. An open bound is itself not legal. The default counts where the recipe says nothing;
it is meaningless where `required`.
"""


def fields_of(model: type[BaseModel], leave_out: tuple[str, ...] = ()) -> list[Field]:
    """Give a form's fields for a model, in the model's order."""
    schema = model.model_json_schema()
    required = schema.get("required", ())
    return [
        _field(name, given, name in required)
        for name, given in schema.get("properties", {}).items()
        if name not in leave_out
    ]


def _field(name: str, given: Mapping[str, Any], required: bool) -> Field:
    options = given.get("anyOf", [given])
    words = [option.get("const") for option in options if _is_word(option)]
    open_to = [option for option in options if not _is_word(option)]
    field = {
        "name": name,
        "description": given.get("description", ""),
        "unit": _unit(name),
        "required": required,
    }
    field |= {"default": given.get("default"), "choices": [], "words": words}
    field |= {"low": None, "high": None, "low_open": False, "high_open": False}
    if not open_to:
        return field | {
            "kind": "choice",
            "choices": [word for word in words if word is not None],
            "words": [],
        }
    return field | ({"kind": "yaml", "words": []} if len(open_to) > 1 else _kind(open_to[0]))


def _is_word(option: Mapping[str, Any]) -> bool:
    return option.get("type") == "null" or isinstance(option.get("const"), str)


def _kind(option: Mapping[str, Any]) -> dict[str, Any]:
    if "enum" in option:
        return {"kind": "choice", "choices": option["enum"]}
    match option.get("type"):
        case "boolean":
            return {"kind": "switch"}
        case "number" | "integer" as kind:
            return {"kind": kind, **dict(_bounds(option))}
        case "string":
            return {"kind": "file" if option.get("format") in ("path", "file-path") else "text"}
        case _:
            return {"kind": "yaml"}


def _bounds(option: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, name, is_open in (
        ("minimum", "low", False),
        ("maximum", "high", False),
        ("exclusiveMinimum", "low", True),
        ("exclusiveMaximum", "high", True),
    ):
        if key in option:
            yield name, float(option[key])
            yield f"{name}_open", is_open


def _unit(name: str) -> str:
    """Read the unit off an option's name."""
    if name.endswith("_g_per_cm3"):
        return "g/cm³"
    return _UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""


_NOT_IN_FORM = ("use", "options", "sensor")


def form_of(base: Any, recipe: Recipe, registry: Registry) -> dict[str, Any]:
    """Describe a form for a recipe's values: its source, its stages, and all that may be chosen."""
    chosen = stages_of(base)
    said = base.get("source", {})
    source_fields = fields_of(SourceChoice, _NOT_IN_FORM)
    options = fields_of(recipe.source.stage.Options)
    for option in options:
        option["name"] = f"options.{option['name']}"
    return {
        "source": {
            "use": recipe.source_choice.use,
            "fields": source_fields + options,
            "stated": {
                **_stated({key: value for key, value in said.items() if key not in _NOT_IN_FORM}),
                **{f"options.{name}": text for name, text in _stated(said.get("options") or {}).items()},
            },
        },
        "stages": [
            {
                "kind": kind,
                "needs": NEEDS.get(kind, ""),
                "required": kind not in NEEDS,
                "chosen": None
                if kind not in chosen
                else {"use": chosen[kind]["use"], "options": _stated(chosen[kind]["options"])},
                "choices": _choices(kind, registry),
            }
            for kind in KINDS
        ],
    }


def _stated(values: Mapping[str, Any]) -> dict[str, str]:
    """Write values as a recipe has them; a form's field shows them so."""
    return {str(name): inline(value) for name, value in values.items()}


def _choices(kind: str, registry: Registry) -> list[dict[str, Any]]:
    """Give every plugin of a kind; two of one name are told apart by who provides them."""
    found = registry.of_kind(kind)
    names = [one.entry.name for one in found]
    return [
        {
            "use": one.entry.name
            if names.count(one.entry.name) == 1
            else f"{one.provider.name}/{one.entry.name}",
            "summary": one.entry.summary,
            "reference": one.entry.reference,
            **_options_of(one, registry),
        }
        for one in found
    ]


def _options_of(one: Registered, registry: Registry) -> dict[str, Any]:
    """Give a plugin's fields, or why it cannot be used here."""
    if one.missing is not None:
        return {"fields": [], "missing": one.missing}
    try:
        return {"fields": fields_of(registry.load(one).Options), "missing": ""}
    except RoemetryError as error:
        return {"fields": [], "missing": str(error)}
