"""Messages and links in the pages, and the variables of the environment."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.reference_pages import PAGES, ROOT, firsts, page, section


def sources(*places: str) -> Iterator[ast.AST]:
    for place in places:
        home = ROOT / place
        for path in sorted(home.rglob("*.py")) if home.is_dir() else [home]:
            yield from ast.walk(ast.parse(path.read_text("utf-8")))


def words_of(node: ast.AST | None) -> list[str]:
    """Give the fixed parts of a text."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return [p.value for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)]


def test_every_refusal_of_calibrating_and_of_the_papers_stages_is_told() -> None:
    text = page("rig.md") + page("reasons.md")
    refusals = []
    for node in sources("plugins/roemetry_paper", "roemetry/calibrating"):
        name = getattr(getattr(node, "func", None), "id", "")
        if isinstance(node, ast.Call) and name in ("CalibrationError", "StageError"):
            refusals.append(max(words_of(node.args[0]), key=len, default=""))
    assert len(refusals) > 15
    for refusal in filter(None, refusals):
        assert refusal.strip(" :(`")[:18] in text, refusal


def test_messages_that_the_pages_quote_are_in_the_sources() -> None:
    said = " ".join(word for node in sources("roemetry", "plugins") for word in words_of(node))
    tables = [
        section(page("rig.md"), "## Refusals"),
        section(page("recipe.md"), "## What messages look like"),
        section(page("calibration-file.md"), "## Faults"),
        section(page("command-line.md"), "## `roemetry plugins`").split("<!-- to here -->")[1],
    ]
    quoted = [
        row[0].strip("` ") for text in tables for row in re.findall(r"^\| (`[^|]+) \|", text, flags=re.M)
    ]
    assert len(quoted) > 25
    for message in quoted:
        for piece in re.split("…|PROVIDER|: 1|1$", message):
            assert piece.strip(" `()") in said, message


def test_every_variable_of_the_environment_is_told() -> None:
    read = {w for node in sources("roemetry") for w in words_of(node) if re.fullmatch("ROEMETRY_[A-Z]+", w)}
    told = {word.split("=")[0] for word in firsts(section(page("command-line.md"), "## Environment"))}
    assert told == read


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_links_lead_somewhere(path: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(#[^)\s]*)?\)", path.read_text("utf-8")):
        aim = path if not target else (path.parent / target).resolve()
        if ROOT / "docs" / "explanation" in aim.parents:
            continue  # those pages have a test of their own: mkdocs build --strict
        assert aim.is_file(), target
        if anchor:
            assert anchor[1:] in anchors(aim.read_text("utf-8")), f"{target}{anchor}"


def anchors(text: str) -> set[str]:
    found = set()
    for heading in re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE):
        own = re.search(r"\{ #(\S+) \}", heading)
        plain = re.sub(r"[^\w\s-]", "", heading.split(" {")[0].lower()).strip()
        found.add(own[1] if own else re.sub(r"[-\s]+", "-", plain))
    return found
