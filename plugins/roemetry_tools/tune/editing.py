"""Changing values in a YAML file's text, and nothing else: comments, blanks and quotes stay as they are.

ruamel.yaml says where each key and value stands; the text between is never written anew. What comes out is
read again and must say what was wanted, or nothing is given.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from typing import Any

from roemetry.errors import ConfigurationError
from roemetry.io.yaml_source import Step, parse

_PLAIN = re.compile(r"[A-Za-z_./][\w./ -]*")
_GONE = object()
_MOST_CHANGES = 500
"""More than a recipe has values: what still changes then would never end."""


@dataclass(frozen=True)
class _Change:
    """A value to put at a path; `_GONE` takes the key away. A new key comes behind the key `after`."""

    path: tuple[Step, ...]
    value: Any
    after: Step | None = None
    new: bool = False


def edited(text: str, name: str, wanted: Any) -> str:
    """Give a YAML text that says `wanted` and is otherwise as it was.

    Comments inside a list that changes, and those beside an option that is taken away, are kept as comments
    of their own.

    Raises
    ------
    ConfigurationError
        The text cannot be changed so, for instance where ruamel.yaml gives no position for a value.
    """
    at = name
    for _ in range(_MOST_CHANGES):
        change = next(_changes(parse(text, name).data, wanted), None)
        if change is None:
            return text
        at = f"{name}: {'.'.join(map(str, change.path))}"
        before, text = text, _applied(text, change)
        if text == before:
            break
        try:
            parse(text, name)
        except ConfigurationError:
            break
    raise ConfigurationError(
        f"{at}: cannot be changed here without changing more than that",
        hint="change it by hand",
    )


def differences(before: Any, after: Any) -> list[tuple[str, str, str]]:
    """Give path, old and new value of everything that differs; an empty text where there is nothing."""
    found = []
    for change in _changes(before, after):
        old = "" if change.new else inline(reduce(getitem, change.path, before))
        new = "" if change.value is _GONE else inline(change.value)
        found.append((".".join(map(str, change.path)), old, new))
    return found


def inline(value: Any) -> str:
    """Write a value as YAML on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{inline(key)}: {inline(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(inline(item) for item in value) + "]"
    if isinstance(value, str):
        # in a list, since a word such as NULL on a line of its own is an empty file
        same = _PLAIN.fullmatch(value) and not value.endswith(" ")
        plain = same and parse(f"[{value}]", "a word").data == [value]
        return value if plain else json.dumps(value, ensure_ascii=False)
    return json.dumps(value)


def _changes(before: Any, after: Any, path: tuple[Step, ...] = ()) -> Iterator[_Change]:
    emptied = bool(before) and not after  # taking the keys away one by one would leave nothing, not a map
    if emptied or not (isinstance(before, dict) and isinstance(after, dict)):
        if not _same(before, after):
            yield _Change(path, after)
        return
    last: Step | None = None
    for key, value in after.items():
        if key in before:
            yield from _changes(before[key], value, (*path, key))
        else:
            yield _Change((*path, key), value, last, new=True)
        last = key
    for key in before:
        if key not in after:
            yield _Change((*path, key), _GONE)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return list(one) == list(other) and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other) and isinstance(one, bool) == isinstance(other, bool)


def _applied(text: str, change: _Change) -> str:
    parent = _node_at(text, change.path[:-1])
    entries = _entries_of(text, parent)
    flow = bool(parent.flow_style)
    mine = next((entry for entry in entries if entry.key == change.path[-1]), None)
    if mine is None:
        before = next((entry for entry in entries if entry.key == change.after), None)
        return (_added_inline if flow else _added_below)(text, parent, entries, before, change)
    if change.value is _GONE:
        return _without_inline(text, entries, mine) if flow else _without_lines(text, parent, mine)
    kept = _comments(text, mine.colon, mine.end)
    changed = f"{text[: mine.colon]} {inline(change.value)}{text[mine.end :]}"
    if not kept and mine.value_start < mine.end and "\n" not in text[mine.colon : mine.value_start]:
        return f"{text[: mine.value_start]}{inline(change.value)}{text[mine.end :]}"
    if flow:
        return changed  # a comment within braces has no line of its own to go to
    start = text.rfind("\n", 0, mine.start) + 1
    lines = "".join(f"{' ' * (mine.start - start)}{comment}\n" for comment in kept)
    return changed[:start] + lines + changed[start:]


def _added_inline(
    text: str, parent: Any, entries: list[_Entry], before: _Entry | None, change: _Change
) -> str:
    said = f"{inline(change.path[-1])}: {inline(change.value)}"
    if before is not None:
        return f"{text[: before.end]}, {said}{text[before.end :]}"
    place = parent.start_mark.index + 1
    return f"{text[:place]}{said}{', ' if entries else ''}{text[place:]}"


def _added_below(
    text: str, parent: Any, entries: list[_Entry], before: _Entry | None, change: _Change
) -> str:
    indent = entries[0].start - text.rfind("\n", 0, entries[0].start) - 1
    said = _block(change.path[-1], change.value, indent)
    if before is None:
        place = text.rfind("\n", 0, entries[0].start) + 1
        return text[:place] + said + text[place:]
    place = _line_end(text, before.end)
    gap = "" if text[place - 1] == "\n" else "\n"
    return text[:place] + gap + said + text[place:]


def _block(key: Step, value: Any, indent: int) -> str:
    space = " " * indent
    if isinstance(value, Mapping) and value:
        below = "".join(_block(name, item, indent + 2) for name, item in value.items())
        return f"{space}{inline(key)}:\n{below}"
    return f"{space}{inline(key)}: {inline(value)}\n"


def _without_inline(text: str, entries: list[_Entry], mine: _Entry) -> str:
    place = entries.index(mine)
    if place:
        return text[: entries[place - 1].end] + text[mine.end :]
    end = entries[1].start if len(entries) > 1 else mine.end
    return text[: mine.start] + text[end:]


def _without_lines(text: str, parent: Any, mine: _Entry) -> str:
    """Take lines away; where something is written beside them, turn them into comments."""
    start, end = text.rfind("\n", 0, mine.start) + 1, _line_end(text, mine.end)
    lines = text[start:end].splitlines(keepends=True)
    if not _comments(text, start, end):
        return text[:start] + text[end:]
    indent = " " * (mine.start - start)
    told = "".join(f"{indent}# {line.removeprefix(indent)}" if line.strip() else line for line in lines)
    return text[:start] + told + text[end:]


def _line_end(text: str, place: int) -> int:
    """Give where the line after a place begins; a block of text ends there already."""
    if place and text[place - 1] == "\n":
        return place
    end = text.find("\n", place)
    return len(text) if end < 0 else end + 1


def _comments(text: str, start: int, end: int) -> list[str]:
    """Give the comments that begin between two places."""
    spans = [(node.start_mark.index, node.end_mark.index) for node in _scalars(_composed(text))]
    begins = [start + found.start() for found in re.finditer(r"(?<!\S)#", text[start:end])]
    return [
        text[begin : _line_end(text, begin)].rstrip("\r\n")
        for begin in begins
        if not any(low <= begin < high for low, high in spans)
    ]


@dataclass(frozen=True)
class _Entry:
    """Where in the text a key of a map begins, where its colon ends, where its value begins and ends.

    Comments behind the value do not count.
    """

    key: Step
    start: int
    colon: int
    value_start: int
    end: int


def _node_at(text: str, path: tuple[Step, ...]) -> Any:
    """Give the node a path leads to."""
    node = _composed(text)
    for step in path:
        node = next(value for key, value in node.value if key.value == step)
    return node


def _entries_of(text: str, node: Any) -> list[_Entry]:
    """Give the entries of a map's node."""
    found = []
    for key, value in node.value:
        colon = text.index(":", key.end_mark.index) + 1
        found.append(_Entry(key.value, key.start_mark.index, colon, value.start_mark.index, _end(value)))
    return found


def _composed(text: str) -> Any:
    from ruamel.yaml import YAML

    return YAML(typ="rt").compose(text)


def _end(node: Any) -> int:
    """Give where a node's last word ends; a block's own end lies behind the comments that follow it."""
    if isinstance(node.value, str) or node.flow_style or not node.value:
        return int(node.end_mark.index)
    last = node.value[-1]
    return _end(last[1] if isinstance(last, tuple) else last)


def _scalars(node: Any) -> Iterator[Any]:
    if isinstance(node.value, str):
        yield node
        return
    for item in node.value:
        for part in item if isinstance(item, tuple) else (item,):
            yield from _scalars(part)
