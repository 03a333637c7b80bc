"""``--set a.b.c=value``: changes to a recipe from the command line."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from roemetry.errors import ConfigurationError
from roemetry.io.remote import path_of
from roemetry.io.yaml_source import Document, Step, parse

_PATHS = {("source", "path"), ("calibration",)}


class Implied(str):
    """A change that follows from something else that was typed: faults name that, not ``--set``."""

    typed: str

    def __new__(cls, change: str, typed: str) -> Implied:
        """Make a change of a text, and of what was typed for it."""
        made = super().__new__(cls, change)
        made.typed = typed
        return made


class Overridden:
    """A document with some values set otherwise; it still knows where each value comes from.

    A path that is set on the command line is relative to the working directory, not to the recipe.

    Attributes
    ----------
    data
        The changed values.
    sets
        The changes, with absolute paths, so that they mean the same in another working directory.
    """

    def __init__(self, document: Document, sets: Sequence[str]) -> None:
        self.data: Any = copy.deepcopy(document.data)
        self._document = document
        self._set: dict[tuple[Step, ...], str] = {}
        self.sets: list[str] = []
        for text in sets:
            keys, value = _split(text)
            if keys in _PATHS and isinstance(value, str):
                value = str(path_of(value, Path()).absolute())
                text = f"{'.'.join(map(str, keys))}={value}"
            self.sets.append(text)
            _put(self.data, keys, value, text)
            self._set[keys] = text

    def place(self, path: Sequence[Step]) -> str:
        """Give ``file:line:column``, or the ``--set`` that a value comes from."""
        for keys, text in self._set.items():
            if tuple(path[: len(keys)]) == keys:
                return text.typed if isinstance(text, Implied) else f"--set {text}"
        return self._document.place(path)


def _split(text: str) -> tuple[tuple[Step, ...], Any]:
    key, equals, value = text.partition("=")
    keys = tuple(key.strip().split("."))
    if not equals or not all(keys):
        raise ConfigurationError(
            f"--set {text}: expected key.key=value",
            hint="for example --set stages.extractor.options.threshold=80",
        )
    nothing = value.strip() in ("", "null", "~")
    return keys, None if nothing else parse(value, f"--set {key}").data


def _put(data: Any, keys: tuple[Step, ...], value: Any, text: str) -> None:
    node = data
    for step, following in pairwise(keys):
        if not isinstance(node, dict):
            raise ConfigurationError(f"--set {text}: `{step}` cannot be reached: there is no map above it")
        if isinstance(node.get(step), str) and following in ("use", "options"):
            node[step] = {"use": node[step]}
        node = node.setdefault(step, {})
    if not isinstance(node, dict):
        raise ConfigurationError(f"--set {text}: `{keys[-1]}` cannot be set: what is above it is not a map")
    node[keys[-1]] = value
