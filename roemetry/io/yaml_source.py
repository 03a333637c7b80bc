"""YAML with places: every value knows the line and column it stands at.

ruamel.yaml in round-trip mode, because it reads ``1e-3`` as a number, keeps ``no`` a word, refuses a key
that stands twice, and knows where each key is.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roemetry.errors import ConfigurationError
from roemetry.io.yaml_faults import syntax_fault

Step = str | int


@dataclass(frozen=True, slots=True)
class Document:
    """A YAML file as plain values, with the way back to its lines.

    Attributes
    ----------
    name
        What to call the file in messages.
    data
        Dictionaries, lists, words, numbers.
    """

    name: str
    data: Any
    _tree: Any = None

    def place(self, path: Sequence[Step]) -> str:
        """Give ``file:line:column`` of the value at a path, or of its nearest ancestor that has a place."""
        if self._tree is None:  # never was a file
            return self.name
        node, line, column = self._tree, 0, 0
        for step in path:
            positions = getattr(node, "lc", None)
            known = positions is not None and positions.data is not None and step in positions.data
            if not known or positions is None:
                break
            line, column = positions.data[step][:2]
            node = node[step]
        return f"{self.name}:{line + 1}:{column + 1}"


def read(path: Path, name: str | None = None) -> Document:
    """Read a YAML file.

    Raises
    ------
    ConfigurationError
        There is no such file, or it is empty, or not YAML, or a key stands twice; with the place.
    """
    called = name or str(path)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{called}: not a text file (byte {error.start} is not UTF-8)") from error
    except OSError as error:
        why = error.strerror or str(error)
        raise ConfigurationError(f"{called}: cannot be read: {why}", hint="check the path") from error
    return parse(text, called)


def parse(text: str, name: str) -> Document:
    """Read YAML from text; `name` stands for the file in messages."""
    from ruamel.yaml import YAML
    from ruamel.yaml.constructor import DuplicateKeyError
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    yaml = YAML(typ="rt")
    yaml.Composer = _composer()
    try:
        tree = yaml.load(text)
    except DuplicateKeyError as error:
        mark = error.problem_mark
        key = str(error.problem).split('"')[1] if '"' in str(error.problem) else "a key"
        raise ConfigurationError(
            f"{name}:{mark.line + 1}:{mark.column + 1}: `{key}` stands here a second time; keep one"
        ) from error
    except MarkedYAMLError as error:
        line, column, why = syntax_fault(text, error)
        raise ConfigurationError(f"{name}:{line + 1}:{column + 1}: not YAML: {why}") from error
    except (YAMLError, ValueError) as error:
        raise ConfigurationError(f"{name}:1:1: not YAML: {error}") from error
    if tree is None:
        raise ConfigurationError(f"{name}:1:1: the file is empty", hint="start from one in `recipes/`")
    return Document(name, _plain(tree), tree)


_DEPTH_MAX = 40
"""Maps and lists within one another. The deepest of ours has eight; Python's own limit is met at some 300."""


def _composer() -> Any:
    """Give a composer that refuses what lets a small file have no end: aliases, and nesting without bound."""
    from ruamel.yaml.composer import Composer, ComposerError
    from ruamel.yaml.events import AliasEvent

    class Bounded(Composer):
        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            event = self.parser.peek_event()
            if isinstance(event, AliasEvent):
                why = f"`*{event.anchor}` is an alias, which is not read; write the value out, or in quotes"
                raise ComposerError(None, None, why, event.start_mark)
            if self.depth > _DEPTH_MAX:
                why = f"more than {_DEPTH_MAX} maps and lists within one another"
                raise ComposerError(None, None, why, event.start_mark)
            self.depth += 1
            try:
                return super().compose_node(parent, index)
            finally:
                self.depth -= 1

    return Bounded


def dump(data: Any) -> str:
    """Write plain values as YAML; lists of numbers stay on one line."""
    from ruamel.yaml import YAML
    from ruamel.yaml.comments import CommentedSeq
    from ruamel.yaml.representer import RoundTripRepresenter

    class Representer(RoundTripRepresenter):
        """Writes "null" for nothing, where ruamel.yaml leaves the place empty."""

    def null(representer: RoundTripRepresenter, _: None) -> Any:
        return representer.represent_scalar("tag:yaml.org,2002:null", "null")

    Representer.add_representer(type(None), null)

    def flowed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: flowed(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            sequence = CommentedSeq(flowed(item) for item in value)
            if all(isinstance(item, int | float) for item in value):
                sequence.fa.set_flow_style()
            return sequence
        return value

    yaml = YAML(typ="rt")
    yaml.Representer = Representer
    yaml.width = 4096
    stream = io.StringIO()
    yaml.dump(flowed(data), stream)
    return stream.getvalue()


def _plain(node: Any) -> Any:
    """Turn ruamel's own types into Python's, for records and messages."""
    if isinstance(node, dict):
        return {_plain(key): _plain(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(item) for item in node]
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node
