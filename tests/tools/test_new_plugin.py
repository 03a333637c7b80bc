"""A new plugin of every kind works as it is written: it keeps the contract of its kind, typed and styled."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from roemetry.errors import ConfigurationError, OutputError
from roemetry.io.yaml_source import parse
from roemetry.stages.hookspecs import KINDS
from roemetry.stages.registry import Provider, Registered, discover
from roemetry.testing import conformance
from roemetry_tools.new_plugin import TEMPLATES, write_plugin


@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_new_plugin_keeps_its_kinds_contract(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"tried-{kind}"
    write_plugin(name, kind, tmp_path, discover())
    monkeypatch.syspath_prepend(tmp_path / name)
    module = __import__(f"tried_{kind}")
    try:
        (entry,) = module.roemetry_stages()
        assert (entry.kind, entry.name) == (kind, name)
        registered = Registered(entry, Provider(name, "0.1.0", name))
        results = [(check.__name__, result) for check, result in conformance(registered)]
        assert results
        assert [(check, result.message) for check, result in results if not result.as_declared] == []
    finally:
        for loaded in [loaded for loaded in sys.modules if loaded.startswith(f"tried_{kind}")]:
            del sys.modules[loaded]


def test_every_kind_has_a_template_or_a_place_to_start_from(tmp_path: Path) -> None:
    for kind in set(KINDS) - set(TEMPLATES):
        with pytest.raises(ConfigurationError, match="start from plugins/"):
            write_plugin("my-thing", kind, tmp_path, discover())


def test_what_is_written_is_in_good_style(tmp_path: Path) -> None:
    for kind in TEMPLATES:
        write_plugin(f"tried-{kind}", kind, tmp_path, discover())
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--line-length", "110", "--select",
               "E,F,W,I,UP,B", str(tmp_path)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_package_can_be_installed(tmp_path: Path) -> None:
    files = write_plugin("my-peaks", "extractor", tmp_path, discover())
    assert all(file.is_file() for file in files)
    project = tomllib.loads((tmp_path / "my-peaks" / "pyproject.toml").read_text("utf-8"))
    assert project["project"]["entry-points"]["roemetry"] == {"my-peaks": "my_peaks"}
    readme = (tmp_path / "my-peaks" / "README.md").read_text("utf-8")
    said = readme.split("```yaml\n")[1].split("```")[0]
    assert parse(said, "readme").data == {"stages": {"extractor": "my-peaks"}}


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("gaussian", "extractor", "there is a stage `gaussian` of this kind already"),
        ("json", "sink", "`json` is installed already as a Python module"),
        ("class", "sink", "it is a word of Python"),
        ("my-peaks", "extracter", "did you mean `extractor`"),
        ("my-peaks", "Extractor", "did you mean `extractor`"),
    ],
)
def test_what_is_taken_is_refused(name: str, kind: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=says):
        write_plugin(name, kind, tmp_path, discover())


@pytest.mark.parametrize(
    ("name", "better"),
    [("MyPeaks", "my-peaks"), ("my peaks", "my-peaks"), ("3d-peaks", "my-3d-peaks"), ("Class", "my-class"),
     ("", "my-peaks"), ("../peaks", "peaks")],
)  # fmt: skip
def test_a_name_that_cannot_be_is_refused_and_a_better_one_offered(
    name: str, better: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigurationError, match=f"cannot be a plugin's name(.|\\n)*`{better}`"):
        write_plugin(name, "extractor", tmp_path, discover())
    assert not list(tmp_path.iterdir())
    assert write_plugin(better, "extractor", tmp_path, discover())


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    written = write_plugin("my-peaks", "extractor", tmp_path, discover())
    before = [file.read_bytes() for file in written]
    with pytest.raises(ConfigurationError, match=r"is there already(.|\n)*pip install -e"):
        write_plugin("my-peaks", "extractor", tmp_path, discover())
    assert [file.read_bytes() for file in written] == before
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="--out names a folder"):
        write_plugin("my-peaks", "extractor", tmp_path / "file", discover())


def test_the_example_is_what_new_plugin_writes(root: Path, tmp_path: Path) -> None:
    write_plugin("run-centroid", "extractor", tmp_path, discover())
    example = root / "examples" / "roemetry-example-plugin" / "roemetry_example" / "extractor.py"
    written = tmp_path / "run-centroid" / "run_centroid" / "extractor.py"
    assert example.read_text("utf-8") == written.read_text("utf-8")
