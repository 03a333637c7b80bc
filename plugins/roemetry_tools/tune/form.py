"""What the form is made of: the chain as it stands, and every plugin that might stand there instead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import NEEDS, SourceChoice
from roemetry.errors import RoemetryError
from roemetry.stages.registry import Registered, Registry
from roemetry_tools.tune.editing import inline
from roemetry_tools.tune.fields import as_plain, fields_of
from roemetry_tools.tune.request import KINDS, stages_of

_NOT_IN_FORM = ("use", "options", "sensor")


def form_of(base: Any, recipe: Recipe, registry: Registry) -> dict[str, Any]:
    """Describe a form for a recipe's values: its source, its stages, and all that may be chosen."""
    chosen = stages_of(base)
    said = base.get("source", {})
    source_fields = as_plain(fields_of(SourceChoice, _NOT_IN_FORM))
    options = as_plain(fields_of(recipe.source.stage.Options))
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
        return {"fields": as_plain(fields_of(registry.load(one).Options)), "missing": ""}
    except RoemetryError as error:
        return {"fields": [], "missing": str(error)}
