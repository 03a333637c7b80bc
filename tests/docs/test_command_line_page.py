"""The page of the command line has the verbs and options that the program has, and no other."""

from __future__ import annotations

import re
import shlex
from typing import Any

import pytest

from docs.reference_tables import rewritten
from tests.docs.reference_pages import CLI, PAGES, VERBS, blocks, coded, firsts, page, section, table


def options_of(command: Any) -> set[str]:
    shown = {option for p in command.params if p.param_type_name == "option" for option in p.opts}
    return shown | {"--help", "-h"}


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_the_tables_of_the_command_line_are_the_options(verb: str) -> None:
    part = section(page("command-line.md"), f"## `{f'roemetry {verb}'.strip()}`")
    rows = [row for row in table(part) if row[0].startswith("`-")]
    assert {word for row in rows for word in coded(row[0])} == options_of(VERBS[verb] if verb else CLI)
    assert all(len(row[-1]) > 10 for row in rows), "an option without an explanation"
    if verb:
        assert f"roemetry {verb} " in "".join(content for _, content in blocks(part, "")), "no example"


@pytest.mark.parametrize("name", ["command-line.md", "recipe.md"])
def test_what_a_page_takes_from_the_code_is_what_the_code_says(name: str) -> None:
    again = rewritten(page(name))
    assert again == page(name), "write them again: python -m docs.reference_tables docs/reference"
    assert again.count("<!-- from the code:") == again.count("<!-- to here -->") > 3


def test_every_verb_and_no_other_stands_in_the_list_of_verbs() -> None:
    overview = page("command-line.md").split("## Exit codes")[0]
    assert firsts(overview.replace("[`", "`")) == list(VERBS)


def test_every_exit_code_is_told() -> None:
    rows = section(page("command-line.md"), "## Exit codes")
    assert re.findall(r"^\| (\d+) \|", rows, flags=re.MULTILINE) == ["0", "1", "2", "130"]


def commands() -> list[Any]:
    """Every command of the pages but those with words in capitals, which stand for something."""
    return [
        pytest.param(line, id=f"{path.stem}: {line}")
        for path in PAGES
        for _, content in blocks(path.read_text("utf-8"), "")
        for line in content.replace("\\\n", " ").splitlines()
        if re.match(r"roemetry [a-z]+( |$)", line) and not re.search(r" [A-Z\[]{3}", line)
    ]


@pytest.mark.parametrize("line", commands())
def test_every_command_in_the_pages_can_be_parsed(line: str) -> None:
    _, verb, *words = shlex.split(line)
    if verb not in VERBS:
        verb, words = f"{verb} {words[0]}", words[1:]
    assert verb in VERBS
    # Parses words and types; runs nothing. Typer may bring a click of its own, so any exception will do.
    VERBS[verb].make_context(verb, words)


def test_a_wrong_command_would_be_noticed() -> None:
    with pytest.raises(Exception, match="bogus"):
        VERBS["run"].make_context("run", ["recipe.yaml", "--bogus"])
    assert len(list(commands())) > 25
