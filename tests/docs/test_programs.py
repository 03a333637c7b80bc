"""The Python in README and in the pages runs as it stands."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.docs.reading import ROOT, blocks


def programs(page: str) -> list[str]:
    return [program for _, program in blocks((ROOT / page).read_text("utf-8"), "python")]


PAGES = ("README.md", "docs/how-to/use-from-python.md")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the shipped recipe, three of its images only, as a reader of README stands in it."""
    folder = tmp_path_factory.mktemp("clone")
    shutil.copytree(
        ROOT / "recipes" / "herring_roe",
        folder / "recipes" / "herring_roe",
        ignore=shutil.ignore_patterns("skein_0[4-9].*", "skein_10.*", "truth"),
    )
    shutil.copytree(ROOT / "calib_targets", folder / "calib_targets")
    return folder


@pytest.mark.parametrize("program", [one for page in PAGES for one in programs(page)])
def test_a_program_of_the_pages_runs(
    program: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    exec(compile(program, "a page", "exec"), {"__name__": "page"})
    printed = capsys.readouterr().out
    assert "print(" not in program or printed.strip()


def test_the_cells_of_the_notebook_page_run_one_after_the_other(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for library in ("matplotlib", "pandas", "xarray"):
        pytest.importorskip(library)
    monkeypatch.chdir(place)
    cells = programs("docs/how-to/use-in-a-notebook.md")
    known: dict[str, object] = {"__name__": "page"}
    for cell in cells:
        exec(compile(cell, "a cell", "exec"), known)
        assert capsys.readouterr().out.strip()
    assert len(cells) == 5
    assert (place / "surface.png").stat().st_size > 10_000
