"""What single pages name is there, and what is there is named: packages, errors, variables, benchmarks."""

from __future__ import annotations

import importlib
import re
import sys

import pytest

from benchmarks.__main__ import BENCHMARKS
from benchmarks.packages import DIAGRAM, drawing
from roemetry import errors
from tests.docs.reading import PAGES, REFERENCE, ROOT, firsts, page, section

SOURCES = sorted(path for folder in ("roemetry", "plugins") for path in (ROOT / folder).rglob("*.py"))


def test_the_drawing_of_the_packages_is_that_of_the_imports() -> None:
    assert DIAGRAM.read_text("utf-8") == drawing(), "write it anew: python -m benchmarks packages"


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
    child = re.compile(rf"^ *class \w+\([^)]*\b({'|'.join(vars(errors))})\b", flags=re.MULTILINE)
    others = [path for path in SOURCES if path.name != "errors.py"]
    assert [path.name for path in others if child.search(path.read_text("utf-8"))] == []
    assert child.search("class Own(DataError):")


def test_what_is_raised_stands_in_a_section_of_its_own() -> None:
    """One form for all docstrings, numpy's: ruff checks sections, not sentences that should be one."""
    sentence = re.compile(r"\bRaises:? [A-Z]\w*Error\b")
    assert [path.name for path in SOURCES if sentence.search(path.read_text("utf-8"))] == []
    assert sentence.search("Raises DataError: it is not there.")


def test_every_variable_of_the_environment_and_every_first_key_of_a_file_is_told() -> None:
    core = "".join(path.read_text("utf-8") for path in SOURCES if path.is_relative_to(ROOT / "roemetry"))
    told = {word.split("=")[0] for word in firsts(section(page("command-line.md"), "## Environment"))}
    assert told == set(re.findall(r"\"(ROEMETRY_[A-Z]+)\"", core))
    text = "".join(path.read_text("utf-8") for path in SOURCES)
    told = set(re.findall(r"^\| `(roemetry_\w+)` \|", page("file-formats.md"), flags=re.MULTILINE))
    assert told == set(re.findall(r"[\"{ ](roemetry_[a-z]+)(?:\"?: (?:1|Literal\[1\]|_?VERSION))", text))


def named_benchmarks() -> dict[str, set[str]]:
    """By benchmark, the options with which it is named somewhere."""
    found: dict[str, set[str]] = {}
    for path in [*PAGES, *sorted((ROOT / "recipes").rglob("*.md"))]:
        text = path.read_text("utf-8").replace("\\\n", " ")
        for name, rest in re.findall(r"python -m\s+benchmarks\s+([a-z_]+)([^`\n]*)", text):
            found.setdefault(name, set()).update(re.findall(r"(?<= )--[a-z][a-z-]*", rest))
    return found


def test_a_benchmark_that_is_named_takes_the_options_it_is_named_with(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    named = named_benchmarks()
    assert named
    for name, options in named.items():
        assert name in BENCHMARKS
        monkeypatch.setattr(sys, "argv", [name, "--help"])
        with pytest.raises(SystemExit):
            importlib.import_module(f"benchmarks.{name}").main()
        assert options <= set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out)), name
