"""The pages on errors and on file formats name every class of error and every format there is."""

from __future__ import annotations

import ast
import re

from reading import ROOT

from roemetry import errors

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
