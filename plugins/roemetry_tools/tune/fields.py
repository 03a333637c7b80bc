"""From a stage's options to the fields of a form: sliders, choices, switches, words."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

Kind = Literal["number", "integer", "choice", "switch", "text", "file", "yaml"]

_UNITS = {
    "px": "px",
    "mm": "mm",
    "mm2": "mm²",
    "mm3": "mm³",
    "cm3": "cm³",
    "rows": "rows",
    "deg": "°",
    "g": "g",
    "days": "days",
    "samples": "samples",
    "sigmas": "σ",
    "grey": "grey levels",
}


class Field(BaseModel):
    """One field of the form.

    Attributes
    ----------
    kind
        How it is set. ``yaml``: what fits no other kind is written as in the recipe, on one line.
    words
        Words (and None) that may stand in the place of a number, a text or a file.
    low, high, low_open, high_open
        Bounds of a number; open: the bound itself is not legal.
    default
        Value where the recipe says nothing; meaningless where `required`.
    """

    model_config = ConfigDict(frozen=True)

    name: str
    kind: Kind
    description: str
    unit: str = ""
    choices: tuple[str | int | float, ...] = ()
    words: tuple[str | None, ...] = ()
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    high_open: bool = False
    required: bool = False
    default: Any = None


def fields_of(model: type[BaseModel], leave_out: tuple[str, ...] = ()) -> tuple[Field, ...]:
    """Give a form's fields for a model, in the model's order."""
    schema = model.model_json_schema()
    required = schema.get("required", ())
    return tuple(
        _field(name, given, name in required)
        for name, given in schema.get("properties", {}).items()
        if name not in leave_out
    )


def _field(name: str, given: Mapping[str, Any], required: bool) -> Field:
    said: dict[str, Any] = {
        "name": name,
        "description": given.get("description", ""),
        "unit": _unit(name),
        "required": required,
        "default": given.get("default"),
    }
    open_to: list[Mapping[str, Any]] = []
    words: list[str | None] = []
    for option in given.get("anyOf", [given]):
        if option.get("type") == "null":
            words.append(None)
        elif "const" in option and isinstance(option["const"], str):
            words.append(option["const"])
        else:
            open_to.append(option)
    if not open_to:
        return Field(kind="choice", choices=tuple(word for word in words if word is not None), **said)
    if len(open_to) > 1:
        return Field(kind="yaml", **said)
    return Field(words=tuple(words), **said, **_kind(open_to[0]))


def _kind(option: Mapping[str, Any]) -> dict[str, Any]:
    if "enum" in option:
        return {"kind": "choice", "choices": tuple(option["enum"])}
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


def as_plain(fields: tuple[Field, ...]) -> list[dict[str, Any]]:
    """Give fields as JSON holds them."""
    plain: list[dict[str, Any]] = json.loads(json.dumps([field.model_dump(mode="json") for field in fields]))
    return plain
