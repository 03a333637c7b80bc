"""A kept result is used only where the same code would make it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from benchmarks.made_by import made_by

SOURCES = {
    "roemetry_made/__init__.py": "",
    "roemetry_made/top.py": "def go():\n    from roemetry_made.deep import VALUE\n    return VALUE\n",
    "roemetry_made/deep.py": "import math\nfrom . import beside\nVALUE = 1\n",
    "roemetry_made/beside.py": "NAME = 'a'\n",
    "roemetry_made/alone.py": "OTHER = 1\n",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, source in SOURCES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "roemetry_made", raising=False)
    return tmp_path / "roemetry_made"


def made() -> str:
    made_by.cache_clear()
    return made_by("roemetry_made.top")


@pytest.mark.parametrize("file", ["top.py", "deep.py", "beside.py", "__init__.py"])
def test_a_change_of_what_is_imported_is_seen_however_deep(folder: Path, file: str) -> None:
    before = made()
    path = folder / file
    path.write_text(path.read_text("utf-8") + "\nMORE = 2\n", encoding="utf-8")
    assert made() != before


def test_comments_and_what_is_not_imported_do_not_count(folder: Path) -> None:
    before = made()
    deep = folder / "deep.py"
    deep.write_text("# why\n" + deep.read_text("utf-8") + "\n", encoding="utf-8")
    (folder / "alone.py").write_text("OTHER = 2\n", encoding="utf-8")
    assert made() == before
