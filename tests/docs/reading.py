"""What the pages tell a reader to type."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

_FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)


def blocks(page: Path, language: str) -> list[str]:
    """Give the page's fenced blocks of a language; "" are commands."""
    return [body for found, body in _FENCE.findall(page.read_text("utf-8")) if found == language]


def commands(page: Path) -> list[str]:
    """Give the page's commands in their order, without comments, with continued lines joined."""
    lines = [line for block in blocks(page, "") for line in block.replace("\\\n", " ").splitlines()]
    typed = [part.strip() for line in lines for part in re.sub(r"\s{2,}#.*", "", line).split(" && ")]
    return [line for line in typed if re.match(r"(roemetry|python|pip|pytest) ", line)]


def titled(page: Path) -> dict[str, str]:
    """Give the blocks that are files, by the name in their title."""
    fence = re.compile(r"^```\w+ title=\"([^\"]+)\"\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
    return dict(fence.findall(page.read_text("utf-8")))


def stands_for_something(command: str) -> bool:
    """Tell a synopsis, with words in capitals or brackets that the reader replaces, from a command."""
    return re.search(r"(?<![-\w'=/])(\[?[A-Z]{2,}\b(?![-_.=])|\[OPTIONS\])", command) is not None
