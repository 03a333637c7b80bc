"""What single pages name is there, and what is there is named: rooms, files, terms, figures, errors."""

from __future__ import annotations

import ast
import re
from collections import Counter

import pytest

from benchmarks.rooms import DRAWING, KERNELS, PLUGINS, TOOLS, drawing, imports_between_rooms
from roemetry import errors
from roemetry.stages.registry import discover
from tests.docs.reading import ROOT


def test_the_drawing_of_the_rooms_is_that_of_the_imports() -> None:
    assert DRAWING.read_text("utf-8") == drawing(), "write it anew: python -m benchmarks rooms"


def test_the_page_names_every_room_and_plugin() -> None:
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text("utf-8")
    rooms = set(imports_between_rooms()) - {PLUGINS, TOOLS, KERNELS, "errors"}
    assert set(re.findall(r"^\| `roemetry/(\w+)/` \|", page, flags=re.MULTILINE)) == rooms
    for folder in (ROOT / "plugins").iterdir():
        if (folder / "__init__.py").exists():
            assert f"`{folder.name}`" in page


def test_contributing_names_files_that_exist() -> None:
    """Every path in backticks is there; a move that forgets the page breaks this."""
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    paths = re.findall(r"`((?:[\w.-]+/)+[\w.-]*)`", text)
    assert len(paths) > 15
    assert not [path for path in paths if not (ROOT / path).exists()]


def test_glossary_defines_each_term_once() -> None:
    """Each first cell of a table is one or several terms; none stands twice, none without a meaning."""
    text = (ROOT / "docs/reference/glossary.md").read_text("utf-8")
    terms = text[text.index("## The image") :]
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|", terms, flags=re.MULTILINE)
    counts = Counter(term.strip() for cell, _ in rows if cell != "term" for term in cell.split(","))
    assert len(counts) > 80
    assert not [term for term, times in counts.items() if times > 1]
    assert not [cell for cell, meaning in rows if not meaning.strip()]


METHODS = ("extractor", "coder", "smoother", "triangulator", "volume", "classifier")
_OWN = [stage.entry for stage in discover().stages if stage.provider.distribution == "roemetry"]


@pytest.mark.parametrize("name", sorted({entry.name for entry in _OWN if entry.kind in METHODS}))
def test_a_method_has_its_measured_figures(name: str) -> None:
    page = (ROOT / "docs" / "reference" / "plugins" / f"{name}.md").read_text("utf-8")
    parts = [part for part in re.split(r"^## ", page, flags=re.MULTILINE) if "python -m benchmarks" in part]
    assert any(re.search(r"\d[.\d]* ?(%|ms|px|mm|σ)|\d\.\d", part) for part in parts)


REFERENCE = ROOT / "docs" / "reference"
SOURCES = sorted(path for folder in ("roemetry", "plugins") for path in (ROOT / folder).rglob("*.py"))


def test_every_error_that_reaches_users_is_told_with_its_exit_code() -> None:
    text = (REFERENCE / "errors.md").read_text("utf-8")
    told = dict(re.findall(r"^\| `(\w+Error)` \|.*\| (\d+) \|$", text, flags=re.MULTILINE))
    there = {
        name: str(found.exit_code)
        for name, found in vars(errors).items()
        if isinstance(found, type) and issubclass(found, errors.RoemetryError)
    }
    assert told == there


def test_only_our_own_error_class_is_made_for_users() -> None:
    """No plugin brings a child of its own: the exit codes of the page would not hold for it."""
    children = [
        f"{path.name}: {node.name}"
        for path in SOURCES
        if path.name != "errors.py"
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef)
        and any(getattr(base, "id", "") in vars(errors) for base in node.bases)
    ]
    assert children == []


def test_messages_that_the_page_on_errors_quotes_are_in_the_sources() -> None:
    said = " ".join(path.read_text("utf-8") for path in SOURCES)
    table = (REFERENCE / "errors.md").read_text("utf-8").split("## Common messages")[1]
    quoted = re.findall(r"^\| `([^`]+)` \|", table, flags=re.MULTILINE)
    assert len(quoted) >= 6
    assert [message for message in quoted if message not in said] == []


def test_every_first_key_of_a_file_is_told() -> None:
    text = (REFERENCE / "file-formats.md").read_text("utf-8")
    told = set(re.findall(r"^\| `(roemetry_\w+)` \|", text, flags=re.MULTILINE))
    keys = {
        key
        for path in SOURCES
        for key in re.findall(
            r"[\"{ ](roemetry_[a-z]+)(?:\"?: (?:1|Literal\[1\]|_?VERSION))", path.read_text("utf-8")
        )
    }
    assert told == keys
