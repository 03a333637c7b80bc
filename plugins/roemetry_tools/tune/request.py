"""What the page asks for, and the recipe that follows from it.

The form is made of the chain as it stands, every plugin that might stand there, and their options: an
option's schema says whether it becomes a slider, a choice, a switch or a text.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from roemetry.config.recipe import Recipe
from roemetry.config.recipe_file import NEEDS, SourceChoice, StageChoices
from roemetry.errors import ConfigurationError, RoemetryError
from roemetry.io.yaml_source import Step, parse
from roemetry.stages.registry import Registered, Registry
from roemetry_tools.tune.editing import inline

KINDS = tuple(StageChoices.model_fields)
"""Kinds of stage in the order of the chain."""


class StageRequest(BaseModel):
    """A stage and the options that are said of it; each value is written as a recipe would have it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    use: str = Field(min_length=1, max_length=200)
    options: dict[str, str] = Field(default_factory=dict)


class TuneRequest(BaseModel):
    """Everything the page's form says: which frame (empty: the first), and the recipe's source and stages.

    Options of the source are keys ``options.NAME``. A stage that is None is left out; a kind that is missing
    stays as the recipe has it. With `draws`, the recipe's Monte Carlo draws are made.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    acquisition: str = ""
    source: dict[str, str] = Field(default_factory=dict)
    stages: dict[str, StageRequest | None] = Field(default_factory=dict)
    draws: bool = False


@dataclass(frozen=True)
class Fault:
    """What is wrong at a path of the recipe."""

    path: tuple[Step, ...]
    said: str


@dataclass
class Draft:
    """The recipe as it would be saved. The place of a value is its path as JSON: `faults_of` reads it."""

    data: Any
    faults: list[Fault] = field(default_factory=list)
    sets: list[str] = field(default_factory=list)

    def place(self, path: Sequence[Step]) -> str:
        """Give the path itself."""
        return json.dumps(list(path))


def draft_of(base: Any, wish: TuneRequest) -> Draft:
    """Change a recipe's values by what is wished; what is wished as it was keeps its form."""
    draft = Draft(copy.deepcopy(base))
    if not isinstance(draft.data, dict):
        return draft
    if wish.source:
        draft.data["source"] = _source(base, wish.source, draft.faults)
    before = stages_of(base)
    stages: dict[str, Any] = {}
    for kind in (*KINDS, *(kind for kind in before if kind not in KINDS)):
        if kind not in wish.stages:
            if kind in before:
                stages[kind] = draft.data["stages"][kind]
            continue
        wished = wish.stages[kind]
        if wished is None:
            continue
        options = _values(wished.options, ("stages", kind, "options"), draft.faults)
        if before.get(kind) == {"use": wished.use, "options": options}:
            stages[kind] = draft.data["stages"][kind]
        elif options:
            stages[kind] = {"use": wished.use, "options": options}
        else:  # a map stays a map, so that what is written beside its keys stays too
            was_map = kind in before and isinstance(draft.data["stages"][kind], dict)
            stages[kind] = {"use": wished.use} if was_map else wished.use
    if wish.stages:
        draft.data["stages"] = stages
    return draft


def stages_of(data: Any) -> dict[str, dict[str, Any]]:
    """Give a recipe's stages in their long form, by kind."""
    given = data.get("stages") if isinstance(data, dict) else None
    found: dict[str, dict[str, Any]] = {}
    for kind, choice in (given if isinstance(given, Mapping) else {}).items():
        if choice is None:
            continue
        long = {"use": choice} if isinstance(choice, str) else dict(choice)
        found[kind] = {"use": long.get("use"), "options": long.get("options") or {}}
    return found


def faults_of(draft: Draft, error: ConfigurationError) -> list[Fault]:
    """Read what is wrong with a draft: which field, and why; what could not even be read is told once."""
    unread = {fault.path for fault in draft.faults}
    return draft.faults + [fault for fault in map(_read, error.faults) if fault.path not in unread]


def _read(sentence: str) -> Fault:
    try:
        path, end = json.JSONDecoder().raw_decode(sentence)
    except ValueError:
        return Fault((), sentence)
    dotted = ".".join(map(str, path)) or "the file"
    return Fault(tuple(path), sentence[end:].removeprefix(f": {dotted}: "))


def _source(base: Mapping[str, Any], wished: Mapping[str, str], faults: list[Fault]) -> dict[str, Any]:
    """Change the keys that are wished, and leave out what says no more than the default."""
    source: dict[str, Any] = copy.deepcopy(base.get("source") or {})
    defaults = {name: info.default for name, info in SourceChoice.model_fields.items()}
    given = _values(wished, ("source",), faults)
    options = dict(source.get("options") or {})
    for key, value in given.items():
        name = key.removeprefix("options.")
        if name != key:
            options[name] = value
        elif key in source or value != defaults.get(key):
            source[key] = value
    stated = {name: value for name, value in options.items() if value is not None}
    if stated:
        source["options"] = stated
    elif options:
        source.pop("options", None)
    return source


def _values(texts: Mapping[str, str], at: tuple[str, ...], faults: list[Fault]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, text in texts.items():
        try:
            values[name] = value_of(text)
        except ConfigurationError as error:
            faults.append(Fault((*at, *name.split(".")), error.message.partition(": ")[2]))
            values[name] = text
    return values


def value_of(text: str) -> Any:
    """Read one value as a recipe would: ``80``, ``lowest``, ``[0, 480]``; nothing and ``null`` are None."""
    if text.strip() in ("", "null", "~"):
        return None
    try:
        return json.loads(text, parse_constant=_no_json)  # what JSON says, YAML says; it is 100 times faster
    except RecursionError as error:
        raise ConfigurationError("here: nested too deeply") from error
    except ValueError:
        return parse(text, "here").data


def _no_json(word: str) -> Any:
    raise ValueError(word)


_AS_WRITTEN = ("px", "mm", "rows", "g", "days", "samples")
_UNITS = {name: name for name in _AS_WRITTEN} | {"mm2": "mm²", "mm3": "mm³", "cm3": "cm³", "deg": "°"}
_UNITS |= {"sigmas": "σ", "grey": "grey levels"}
"""By the last part of an option's name."""


FormField = dict[str, Any]
"""One field of the form, as JSON has it.

What fits no other kind, ``yaml``, is written as in the recipe, on one line. `words` (and null) may replace a
number, a text or a file. An open bound is itself not legal. The default counts where the recipe says nothing;
it is meaningless where `required`.
"""


def fields_of(model: type[BaseModel], leave_out: tuple[str, ...] = ()) -> list[FormField]:
    """Give a form's fields for a model, in the model's order."""
    schema = model.model_json_schema()
    required = schema.get("required", ())
    return [
        _field(name, given, name in required)
        for name, given in schema.get("properties", {}).items()
        if name not in leave_out
    ]


def _field(name: str, given: Mapping[str, Any], required: bool) -> FormField:
    options = given.get("anyOf", [given])
    words = [option.get("const") for option in options if _is_word(option)]
    open_to = [option for option in options if not _is_word(option)]
    told = given.get("description", "")
    field = {"name": name, "description": told, "unit": _unit(name), "required": required}
    field |= {"default": given.get("default"), "choices": [], "words": words}
    field |= {"low": None, "high": None, "low_open": False, "high_open": False}
    if not open_to:
        choices = [word for word in words if word is not None]
        return field | {"kind": "choice", "choices": choices, "words": []}
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
    fields = fields_of(SourceChoice, _NOT_IN_FORM)
    for option in fields_of(recipe.source.stage.Options):
        fields.append(option | {"name": f"options.{option['name']}"})
    stated = {key: value for key, value in said.items() if key not in _NOT_IN_FORM}
    stated |= {f"options.{name}": value for name, value in (said.get("options") or {}).items()}
    stages = []
    for kind in KINDS:
        own, used = chosen.get(kind), recipe.stages.get(kind)
        default = used.registered.entry.name if own is None and used is not None else ""
        stages.append(
            {
                "kind": kind,
                "needs": NEEDS.get(kind, ""),
                "required": kind not in NEEDS and kind in chosen,
                "chosen": None if own is None else {"use": own["use"], "options": _stated(own["options"])},
                "default": default,
                "choices": _choices(kind, registry),
            }
        )
    source = {"use": recipe.source_choice.use, "fields": fields, "stated": _stated(stated)}
    return {"source": source, "stages": stages}


def _stated(values: Mapping[str, Any]) -> dict[str, str]:
    """Write values as a recipe has them; a form's field shows them so."""
    return {str(name): inline(value) for name, value in values.items()}


def _choices(kind: str, registry: Registry) -> list[dict[str, Any]]:
    """Give every plugin of a kind; two of one name are told apart by who provides them."""
    found = registry.of_kind(kind)
    names = [one.entry.name for one in found]
    choices = []
    for one in found:
        entry, alone = one.entry, names.count(one.entry.name) == 1
        use = entry.name if alone else f"{one.provider.name}/{entry.name}"
        told = {"use": use, "summary": entry.summary, "reference": entry.reference}
        choices.append(told | _options_of(one, registry))
    return choices


def _options_of(one: Registered, registry: Registry) -> dict[str, Any]:
    """Give a plugin's fields, or why it cannot be used here."""
    if one.missing is not None:
        return {"fields": [], "missing": one.missing}
    try:
        return {"fields": fields_of(registry.load(one).Options), "missing": ""}
    except RoemetryError as error:
        return {"fields": [], "missing": str(error)}
