"""What to say of a file that is not YAML: where it went wrong, and what to write instead.

A YAML reader says what it expected of a grammar, at the place where it noticed. A person needs the line that
was written wrong, and what it should have been.
"""

from __future__ import annotations

from typing import Any

_CONFLICT = ("<<<<<<<", "=======", ">>>>>>>")
_QUOTED = "write it in quotes"


def syntax_fault(text: str, error: Any) -> tuple[int, int, str]:
    """Say what is wrong with a text that ruamel.yaml refused.

    Parameters
    ----------
    text
        The file.
    error
        ruamel.yaml's MarkedYAMLError.

    Returns
    -------
    tuple
        Line and column from 0, and a sentence that ends with what to write.
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
