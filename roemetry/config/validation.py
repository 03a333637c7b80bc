"""From pydantic's errors to sentences with ``file:line:column``."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from roemetry.errors import MisfitError, did_you_mean
from roemetry.io.yaml_source import Step

Place = Callable[[Sequence[Step]], str]


def checked(
    model: type[BaseModel], data: object, place: Place, at: tuple[Step, ...] = ()
) -> tuple[Any, list[str]]:
    """Check plain values from a file, which stand at the path `at` in it, against a model.

    Gives the model's instance (None if there are faults), and every fault as a sentence with its place.
    """
    try:
        return model.model_validate(data), []
    except ValidationError as error:
        return None, [fault for group in _grouped(error) for fault in _faults(model, group, place, at)]


def unknown_key(key: object, known: Sequence[str]) -> str:
    """Write what to say of a key nobody knows."""
    meant = did_you_mean(str(key), known)
    return f"unknown key `{key}`; {meant or 'known here: ' + (', '.join(known) or 'none')}"


def _grouped(error: ValidationError) -> list[list[ErrorDetails]]:
    """Put together what is said of one value that fits none of several shapes: it is one mistake."""
    groups: dict[tuple[Step, ...], list[ErrorDetails]] = {}
    for detail in error.errors():
        groups.setdefault(_in_file(detail), []).append(detail)
    # a list of one wrong item is told as too short, too
    return [
        group
        for path, group in groups.items()
        if group[0]["type"] != "too_short" or not any(path == other[: len(path)] != other for other in groups)
    ]


def _faults(
    model: type[BaseModel], group: list[ErrorDetails], place: Place, at: tuple[Step, ...]
) -> Iterator[str]:
    detail = group[0]
    path = (*at, *_in_file(detail))
    raised = detail.get("ctx", {}).get("error")
    if not isinstance(raised, MisfitError):
        yield _placed(path, place, _sentence(model, detail) if len(group) == 1 else _either(group))
        return
    for below, said in raised.faults:
        found = _below(detail["input"], below)
        yield _placed(
            (*path, *below),
            place,
            said if found is _NOT_SAID or _names(said, found) else f"{said}, found {_shown(found)}",
        )


def _placed(path: tuple[Step, ...], place: Place, said: str) -> str:
    return f"{place(path)}: {'.'.join(str(step) for step in path) or 'the file'}: {said}"


def _names(said: str, found: object) -> bool:
    """Tell whether a sentence needs no "found": it names a key or the value, or is about a section."""
    return said.startswith("unknown key") or isinstance(found, Mapping) or f"`{found}`" in said


_NOT_SAID = object()


def _below(value: object, path: Sequence[Step]) -> object:
    """Give what a path leads to in a file's values; a mark of its own where the file does not say it."""
    for step in path:
        try:
            value = value[step]  # type: ignore[index]
        except (KeyError, IndexError, TypeError):
            return _NOT_SAID
    return value


def _in_file(detail: ErrorDetails) -> tuple[Step, ...]:
    """Give keys and indices of the file without the tags pydantic adds for unions and function validators."""
    steps = tuple(step for step in detail["loc"] if _is_in_file(step))
    return steps[:-1] if steps and steps[-1] in _SHAPES and detail["type"] != "extra_forbidden" else steps


def _is_in_file(step: Step) -> bool:
    return isinstance(step, int) or not any(mark in step for mark in "([-")


_SHAPES = ("float", "int", "str", "bool")
"""Tags of a union's plain members; no key of a file has such a name."""


def _sentence(model: type[BaseModel], detail: ErrorDetails) -> str:
    kind, found = detail["type"], detail["input"]
    if kind == "extra_forbidden":
        owner = _model_at(model, detail["loc"][:-1])
        known = list(owner.model_fields) if owner else []
        below = "; options of a stage stand below `options:`" if "options" in known else ""
        return unknown_key(detail["loc"][-1], known) + below
    if kind == "missing":
        return "this is missing"
    if kind in ("model_type", "dict_type"):
        return f"found {_shown(found)}, expected a map: `key: value`, one to a line"
    if kind in ("list_type", "tuple_type"):
        return f"found {_shown(found)}, expected a list: `[one, two]`, or `- one` to a line"
    if kind == "string_type" and detail["loc"][-1] == "[key]":
        return (
            f"a key must be a word, found {_shown(found)}; a comma ends a value: write decimals with a point"
        )
    return _expected(detail) + _but_found(found, _choices(detail) if kind == "literal_error" else [])


def _either(group: list[ErrorDetails]) -> str:
    """Say what a value may be that has several legal shapes; words stand last."""
    ordered = sorted(group, key=lambda detail: detail["type"] == "literal_error")
    first, *others = dict.fromkeys(_expected(detail) for detail in ordered)
    said = ", or ".join([first, *(other.removeprefix("expected ") for other in others)])
    words = [word for detail in ordered for word in _choices(detail)]
    return said + _but_found(group[0]["input"], words)


def _but_found(value: object, words: Sequence[str]) -> str:
    """Write what stands in the file, and which of the possible words may be meant."""
    meant = did_you_mean(str(value), words)
    return f", found {_shown(value)}" + (f"; {meant}" if meant else "")


def _expected(detail: ErrorDetails) -> str:
    limits = detail.get("ctx", {})
    if detail["type"] == "too_short":
        return f"expected {limits['min_length']} or more"
    if detail["type"] == "too_long":
        return f"expected {limits['max_length']} at most"
    said = _NUMBERS.get(detail["type"]) or detail["msg"][0].lower() + detail["msg"][1:]
    return said.removeprefix("value error, ").replace("input should be", "expected")


_NUMBERS = {
    "float_parsing": "expected a number alone (its unit stands in the key, its decimals after a point)",
    "int_parsing": "expected a whole number",
    "int_from_float": "expected a whole number",
}


def _choices(detail: ErrorDetails) -> list[str]:
    return re.findall(r"'([^']*)'", detail.get("ctx", {}).get("expected", ""))


def _shown(value: object) -> str:
    if isinstance(value, Mapping):
        return "a map" if value else "an empty map"
    if isinstance(value, list | tuple):
        return "a list" if value else "an empty list"
    if value is None:
        return "nothing"
    return repr(value)[:60]


def _model_at(model: type[BaseModel], path: Sequence[Step]) -> type[BaseModel] | None:
    """Give the model that a path into another model leads to."""
    is_key = False  # of a map whose values are models: any word
    for step in path:
        if is_key or not isinstance(step, str) or not _is_in_file(step):
            is_key = is_key and not isinstance(step, str)
            continue
        field = model.model_fields.get(step)
        found = None if field is None else next(_models(field.annotation), None)
        if field is None or found is None:
            return None
        model, is_key = found, get_origin(field.annotation) in (dict, Mapping)
    return model


def _models(annotation: object) -> Iterator[type[BaseModel]]:
    """Give the models that an annotation may stand for, inside `Annotated` and unions too."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)
