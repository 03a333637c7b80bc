"""The page of the command line has the verbs and options that the program has, and no other."""

from __future__ import annotations

import re

import pytest

from docs.reference_tables import rewritten
from tests.docs.reading import VERBS, blocks, coded, page, section, table


def test_the_tables_of_the_command_line_are_the_options() -> None:
    assert VERBS
    for verb, command in VERBS.items():
        part = section(page("command-line.md"), f"## `roemetry {verb}`")
        told = {word for row in table(part) if row[0].startswith("`-") for word in coded(row[0])}
        options = {o for p in command.params if p.param_type_name == "option" for o in p.opts}
        assert told == options | {"--help", "-h"}, verb
        assert f"roemetry {verb} " in "".join(content for _, content in blocks(part, "")), "no example"


@pytest.mark.parametrize("name", ["command-line.md", "recipe.md"])
def test_what_a_page_takes_from_the_code_is_what_the_code_says(name: str) -> None:
    again = rewritten(page(name))
    assert again == page(name), "write them again: python -m docs.reference_tables docs/reference"
    assert again.count("<!-- from the code:") == again.count("<!-- to here -->") > 3


def test_every_exit_code_is_told() -> None:
    rows = section(page("command-line.md"), "## Exit codes")
    assert re.findall(r"^\| (\d+) \|", rows, flags=re.MULTILINE) == ["0", "1", "2", "130"]
