"""Where keys and values stand in a YAML text, by ruamel.yaml's own marks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from roemetry.io.yaml_source import Step


@dataclass(frozen=True)
class Entry:
    """A key of a map with its value: places in the text.

    Attributes
    ----------
    start
        Where the key begins.
    colon
        Just behind the key's colon.
    value_start, end
        Where the value begins and ends, comments behind it not counted.
    """

    key: Step
    start: int
    colon: int
    value_start: int
    end: int


def node_at(text: str, path: tuple[Step, ...]) -> Any:
    """Give the node a path leads to."""
    node = _composed(text)
    for step in path:
        node = next(value for key, value in node.value if key.value == step)
    return node


def entries_of(text: str, node: Any) -> list[Entry]:
    """Give the entries of a map's node."""
    return [
        Entry(
            key.value,
            key.start_mark.index,
            text.index(":", key.end_mark.index) + 1,
            value.start_mark.index,
            _end(value),
        )
        for key, value in node.value
    ]


def scalar_spans(text: str) -> list[tuple[int, int]]:
    """Give where words, numbers and quoted texts begin and end."""
    return [(node.start_mark.index, node.end_mark.index) for node in _scalars(_composed(text))]


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
