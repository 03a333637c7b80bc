"""Every figure's command exists: benchmarks that README and the pages name, in blocks and in sentences."""

from __future__ import annotations

import importlib
import re
import sys

import pytest

from benchmarks.__main__ import BENCHMARKS
from tests.docs.reading import ROOT

_TEXTS = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "recipes").rglob("*.md")),
]


def named() -> dict[str, set[str]]:
    """By benchmark, the options with which it is named somewhere."""
    found: dict[str, set[str]] = {}
    for path in _TEXTS:
        text = path.read_text("utf-8").replace("\\\n", " ")
        for name, rest in re.findall(r"python -m\s+benchmarks\s+([a-z_]+)([^`\n]*)", text):
            found.setdefault(name, set()).update(re.findall(r"(?<= )--[a-z][a-z-]*", rest))
    return found


@pytest.mark.parametrize("name", sorted(named()))
def test_a_benchmark_that_is_named_takes_the_options_it_is_named_with(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert name in BENCHMARKS
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit):
        importlib.import_module(f"benchmarks.{name}").main()
    known = set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out))
    assert named()[name] <= known
