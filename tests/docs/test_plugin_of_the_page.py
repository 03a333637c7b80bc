"""The plugin of the how-to page works as it stands there."""

from __future__ import annotations

import runpy
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from roemetry.stages import StageOptions
from roemetry.stages.registry import discover
from tests.docs.reading import ROOT, blocks


def test_the_plugin_of_the_page_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "how-to" / "write-a-plugin.md").read_text("utf-8")
    files = {title: content for language in ("toml", "python") for title, content in blocks(text, language)}
    assert set(files) == {
        "pyproject.toml",
        "roemetry_centroid/__init__.py",
        "roemetry_centroid/extractor.py",
        "tests/test_run_centroid.py",
        "tests/test_contract.py",
    }
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    try:
        registry = discover([EntryPoint("centroid", "roemetry_centroid", "roemetry")])
        assert registry.broken == ()
        stage = registry.load(registry.find("extractor", "run-centroid"))
        assert issubclass(stage.Options, StageOptions)
        tests = runpy.run_path(str(tmp_path / "tests" / "test_run_centroid.py"))
        found = [tests[name] for name in tests if name.startswith("test_")]
        assert len(found) == 3
        for test in found:
            test()
    finally:
        for name in [name for name in sys.modules if name.startswith("roemetry_centroid")]:
            del sys.modules[name]
