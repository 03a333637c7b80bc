"""YAML with places: every value knows its line and column, and every fault says what to write instead.

ruamel.yaml in round-trip mode, because it reads ``1e-3`` as a number, keeps ``no`` a word, refuses a key
that stands twice, and knows where each key is. What it says of a file that is not YAML is what its grammar
expected at the place where it noticed; a person needs the line that was written wrong.
"""

from __future__ import annotations

import io
import json
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roemetry.errors import ConfigurationError

_CONFLICT = ("<<<<<<<", "=======", ">>>>>>>")
_QUOTED = "write it in quotes"


def syntax_fault(text: str, error: Any) -> tuple[int, int, str]:
    """Say what is wrong with a text that ruamel.yaml refused with a MarkedYAMLError.

    Gives line and column from 0, and a sentence that ends with what to write.
    """
    lines = text.splitlines() or [""]
    noticed = error.problem_mark or error.context_mark
    begun = error.context_mark or noticed
    problem = str(error.problem or error.context or error)
    if noticed is None:
        return 0, 0, problem
    at = (min(noticed.line, len(lines) - 1), noticed.column)
    for number in range(min(begun.line, at[0]), at[0] + 1):
        if lines[number].startswith(_CONFLICT):
            return number, 0, "a merge was left unfinished here; keep one side and take the marks away"
    line = lines[at[0]]
    if "\t" in line[: len(line) - len(line.lstrip())]:
        return at[0], 0, "a tab stands in the indent; indent with spaces"
    if "could not find expected ':'" in problem:
        return begun.line, begun.column, "there is no `: ` in this line; write `key: value`, with the space"
    if "mapping values are not allowed here" in problem:
        return *at, _second_colon(lines, *at)
    if "but got" in problem and "expected ','" in problem:
        bracket = lines[begun.line][begun.column : begun.column + 1]
        closing = {"[": "]", "{": "}"}.get(bracket, "]")
        return begun.line, begun.column, f"this `{bracket}` is not closed; write `{closing}` at its end"
    if "found unexpected end of stream" in problem:
        return begun.line, begun.column, "this quote is not closed; write another at the end of the word"
    if "escape" in problem:
        backslash = max(line.rfind("\\", 0, at[1] + 1), 0)
        return at[0], backslash, "a backslash begins an escape between \" quotes; use ' quotes, or / in paths"
    if "cannot start any token" in problem:
        return *at, f"a word cannot begin with `{line[at[1] : at[1] + 1]}`; {_QUOTED}"
    if "another document" in problem:
        return *at, "`---` begins a second document; keep one to a file"
    if "expected <block end>" in problem:
        return *at, _other_indent(lines, *at)
    return *at, problem


def _second_colon(lines: list[str], line: int, column: int) -> str:
    before = lines[line][:column]
    if ": " not in before:
        return (
            "the line above has a value already, and this one is indented below it; give the line above no "
            "value (a stage with options: `use: NAME`, then `options:`), or begin both in the same column"
        )
    return f"a second `: ` in this line; {_QUOTED} if it belongs to the value"


def _other_indent(lines: list[str], line: int, column: int) -> str:
    written = lines[line]
    indent = _indent(written)
    if column > indent:
        return f"what follows does not belong to the value before it; {_QUOTED} (two '' stand for one)"
    if written.lstrip().startswith("- "):
        return "a list's `-` among keys; indent it below the key it belongs to"
    open_columns: list[int] = []
    for above in reversed(lines[:line]):
        wide = _indent(above)
        if above.strip() and above.lstrip()[0] != "#" and wide < min(open_columns, default=1 + wide):
            open_columns.append(wide)
    columns = " or ".join(str(wide) for wide in sorted(open_columns))
    return (
        f"this key begins after {indent} spaces, the keys above it after {columns}; "
        "keys of one map begin in one column"
    )


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" "))


Step = str | int


@dataclass(frozen=True, slots=True)
class Document:
    """A YAML file as plain values, with the way back to its lines."""

    name: str
    """What to call the file in messages."""
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

    ConfigurationError, with the place, where there is none, or it is empty or not YAML, or a key stands
    twice.
    """
    called = name or str(path)
    return parse(text_of(path, called), called)


def text_of(path: Path, name: str | None = None) -> str:
    """Read a text file with its line ends as they are; ConfigurationError says where it is not UTF-8."""
    called = name or str(path)
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return file.read()
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode("utf-8")
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        raise ConfigurationError(
            f"{called}:{line}:{column}: byte 0x{error.object[error.start]:02x} is not UTF-8: not a text file",
            hint="save it as UTF-8 text, if it is meant to be text",
        ) from error
    except OSError as error:
        why = error.strerror or str(error)
        raise ConfigurationError(f"{called}: cannot be read: {why}", hint="check the path") from error


_ROW = re.compile(r"^( *(?:- |\w+: ))(\[[-+0-9.eE, ]+\])\r?$", re.MULTILINE)
"""A line with one list of numbers and nothing else, as `dump` writes them."""
_HELD = "held-row-"


def read_numbers(path: Path) -> Any:
    """Read a file that `dump` wrote and that is mostly numbers, as plain values; errors as `read`.

    A list of numbers on a line of its own is JSON as well, which is read a hundred times as fast as YAML: the
    covariance of 81 planes has sixty thousand numbers.
    """
    text = text_of(path)
    rows: list[Any] = []

    def hold(line: re.Match[str]) -> str:
        """Read a line of numbers as JSON, and leave its place in the text."""
        try:
            rows.append(json.loads(line[2]))
        except ValueError:  # a form that only YAML has, or a slip: the YAML reader knows what to say
            return line[0]
        return f"{line[1]}{_HELD}{len(rows) - 1}"

    def put_back(value: Any) -> Any:
        """Give what was read of YAML with the numbers in their places."""
        if isinstance(value, dict):
            return {key: put_back(item) for key, item in value.items()}
        if isinstance(value, list):
            return [put_back(item) for item in value]
        held = isinstance(value, str) and _HELD in value
        return rows[int(value.removeprefix(_HELD))] if held else value

    if _HELD in text:
        return parse(text, str(path)).data
    try:
        return put_back(parse(_ROW.sub(hold, text), str(path)).data)
    except ValueError:  # a line that seemed whole is the middle of a longer value
        return parse(text, str(path)).data


def parse(text: str, name: str) -> Document:
    """Read YAML from text; `name` stands for the file in messages."""
    from ruamel.yaml import YAML
    from ruamel.yaml.constructor import DuplicateKeyError
    from ruamel.yaml.error import MarkedYAMLError, ReusedAnchorWarning, YAMLError

    yaml = YAML(typ="rt")
    yaml.Composer = _composer()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ReusedAnchorWarning)  # a mark without an alias is harmless
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
    """Give a composer that refuses what lets a small file have no end: aliases, and nesting without bound.

    And maps and lists as keys, which Python's dict cannot have.
    """
    from ruamel.yaml.composer import Composer, ComposerError
    from ruamel.yaml.events import AliasEvent, ScalarEvent
    from ruamel.yaml.nodes import MappingNode

    class Bounded(Composer):
        depth = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            """Compose what comes next, unless it is one of what is refused."""
            event = self.parser.peek_event()
            if isinstance(event, AliasEvent):
                why = f"`*{event.anchor}` is an alias, which is not read; write the value out, or in quotes"
                raise ComposerError(None, None, why, event.start_mark)
            is_key = isinstance(parent, MappingNode) and index is None
            if is_key and not isinstance(event, ScalarEvent):
                raise ComposerError(None, None, f"a map or a list is no key; {_QUOTED}", event.start_mark)
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
