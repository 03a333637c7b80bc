"""A line file beside a recipe, and a receiver of rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.plugins.line.loopback import Receiver

LINE = """\
roemetry_line: 1
name: line-1
folder: data
stations:
  - name: one
    recipe: recipe.yaml
    feed: {use: folder-watch, options: {path: FOLDER/in}}
"""


@pytest.fixture
def line_file(line: Callable[..., Path]) -> Callable[..., Path]:
    """Write a line file of one station beside a recipe; in its text some is replaced, some put at its end."""

    def make(*replaced: tuple[str, str], end: str = "") -> Path:
        path = line().parent / "line.yaml"
        text = LINE + end
        for old, new in replaced:
            assert old in text
            text = text.replace(old, new)
        path.write_text(text.replace("FOLDER", str(path.parent)), "utf-8")
        return path

    return make


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    made = Receiver()
    yield made
    made.close()
