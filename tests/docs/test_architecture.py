"""The drawing of the rooms shows what the imports say, and the table has every room."""

from __future__ import annotations

import re

from reading import ROOT

from benchmarks.rooms import DRAWING, KERNELS, PLUGINS, TOOLS, drawing, imports_between_rooms


def test_the_drawing_of_the_rooms_is_that_of_the_imports() -> None:
    assert DRAWING.read_text("utf-8") == drawing(), "write it anew: python -m benchmarks rooms"


def test_the_page_names_every_room_and_plugin() -> None:
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text("utf-8")
    rooms = set(imports_between_rooms()) - {PLUGINS, TOOLS, KERNELS, "errors"}
    assert set(re.findall(r"^\| `roemetry/(\w+)/` \|", page, flags=re.MULTILINE)) == rooms
    for folder in (ROOT / "plugins").iterdir():
        if (folder / "__init__.py").exists():
            assert f"`{folder.name}`" in page
