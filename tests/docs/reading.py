"""How the pages are read: sections, tables, fenced blocks, and what they tell a reader to type."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import typer
from pydantic_core import PydanticUndefined

from roemetry.cli.main import app
from roemetry.stages.registry import discover

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs" / "reference"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
STAGES = sorted({stage.entry.name for stage in discover().stages})
_CLI: Any = typer.main.get_command(app)
_CONTEXT = typer.Context(_CLI)
_FIRST = {name: _CLI.resolve_command(_CONTEXT, [name])[1] for name in _CLI.list_commands(_CONTEXT)}
VERBS: dict[str, Any] = {
    f"{name} {inner}".strip(): command
    for name, found in _FIRST.items()
    for inner, command in getattr(found, "commands", {"": found}).items()
}
"""Every command; one of a verb with commands of its own by both words."""

_FENCE = re.compile(r'^( *)```(\w*)(?: title="([^"]*)")?[^\n]*\n(.*?)^\1```$', flags=re.MULTILINE | re.DOTALL)


def page(name: str) -> str:
    return (REFERENCE / name).read_text("utf-8")


def section(text: str, heading: str) -> str:
    """From a heading to the next one of the same or a higher level."""
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.split(" {")[0] == heading), None)
    assert begin is not None, f"no heading {heading!r}"
    level = len(heading) - len(heading.lstrip("#"))
    fenced = False
    for end in range(begin + 1, len(lines)):
        fenced ^= lines[end].startswith("```")
        if not fenced and re.match(rf"#{{1,{level}}} ", lines[end]):
            return "\n".join(lines[begin:end])
    return "\n".join(lines[begin:])


def table(text: str) -> list[list[str]]:
    """Cells of all table rows whose first cell begins with code."""
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in row] for row in rows]


def coded(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def firsts(text: str) -> list[str]:
    """All that stands as code in the first cells of a text's tables."""
    return [word for row in table(text) for word in coded(row[0])]


def without_blocks(text: str) -> str:
    return _FENCE.sub("", text)


def blocks(text: str, language: str) -> list[tuple[str, str]]:
    """(title, content) of fenced blocks, also indented ones; those of the language "" are commands."""
    return [
        (title or "", re.sub(rf"^{indent}", "", content, flags=re.MULTILINE))
        for indent, named, title, content in _FENCE.findall(text)
        if named == language
    ]


def text_of(default: object) -> str:
    if default is None:
        return "none"
    if default is PydanticUndefined:
        return "its own"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


def commands(path: Path) -> list[str]:
    """Give the page's commands in their order, without comments, with continued lines joined."""
    text = path.read_text("utf-8")
    lines = [line for _, block in blocks(text, "") for line in block.replace("\\\n", " ").splitlines()]
    typed = [part.strip() for line in lines for part in re.sub(r"\s{2,}#.*", "", line).split(" && ")]
    return [line for line in typed if re.match(r"(roemetry|python|pip|pytest) ", line)]


def titled(path: Path) -> dict[str, str]:
    """Give the blocks that are files, by the name in their title."""
    fence = re.compile(r"^```\w+ title=\"([^\"]+)\"\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
    return dict(fence.findall(path.read_text("utf-8")))


def stands_for_something(command: str) -> bool:
    """Tell a synopsis, with words in capitals or brackets that the reader replaces, from a command."""
    return re.search(r"(?<![-\w'=/])(\[?[A-Z]{2,}\b(?![-_.=])|\[OPTIONS\])", command) is not None
