"""What the page asks for, and the recipe that follows from it."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from roemetry.config.recipe_file import SourceChoice, StageChoices
from roemetry.errors import ConfigurationError
from roemetry.io.yaml_source import Step, parse

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
