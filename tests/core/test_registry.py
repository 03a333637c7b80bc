"""Plugins: a broken one costs one name; a clash is refused; everything says what to do."""

from __future__ import annotations

import sys
import textwrap
from importlib.metadata import DistributionFinder, MetadataPathFinder
from pathlib import Path

import pytest

from roemetry.errors import PluginError
from roemetry.stages.hookspecs import API
from roemetry.stages.registry import Registry, discover, not_installed

ENTRY = """
from roemetry.stages.hookspecs import StageEntry, hookimpl

@hookimpl
def roemetry_stages():
    yield StageEntry(
        kind={kind!r}, name={name!r}, target={target!r}, summary="s", reference="r",
        requires={requires!r}, api={api},
    )
"""
RAISES = """
from roemetry.stages.hookspecs import hookimpl
@hookimpl
def roemetry_stages():
    raise ValueError("no licence")
"""


def entry(kind="extractor", name="mine", target="nowhere:Nothing", requires=(), api=API) -> str:
    return ENTRY.format(kind=kind, name=name, target=target, requires=requires, api=api)


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Install fake distributions, each one module, and discover them alone."""
    for variable in ("ROEMETRY_STRICT", "ROEMETRY_PLUGINS"):
        monkeypatch.delenv(variable, raising=False)

    def install(**modules: str) -> Registry:
        for name, text in modules.items():
            sys.modules.pop(name, None)  # of the test before
            (tmp_path / f"{name}.py").write_text(textwrap.dedent(text), encoding="utf-8")
            info = tmp_path / f"{name}-1.0.dist-info"
            info.mkdir()
            (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", "utf-8")
            (info / "entry_points.txt").write_text(f"[roemetry]\n{name} = {name}\n", encoding="utf-8")
        monkeypatch.syspath_prepend(str(tmp_path))
        context = DistributionFinder.Context(path=[str(tmp_path)])
        found = MetadataPathFinder.find_distributions(context)
        return discover([point for one in found for point in one.entry_points])

    return install


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("raise RuntimeError('half installed')", "half installed"),
        ("raise SystemExit(0)", "SystemExit"),
        ("import not_there_at_all", "not_there_at_all"),
        (RAISES, "no licence"),
        (entry().replace("def roemetry_stages", "def roemetry_stage"), "misspelt"),
        ("x = 1", "no `roemetry_stages` hook"),
        (entry().replace("@hookimpl", ""), "put `@hookimpl` above it in plugin_bad"),
        (entry().replace("yield StageEntry", "StageEntry"), "gives nothing: `yield` a StageEntry"),
        (entry(kind="extracter"), "did you mean `extractor`"),
        (entry(api=API + 1), "update roemetry"),
    ],
)
def test_a_broken_plugin_costs_only_itself_and_says_why(plugins, text: str, says: str) -> None:
    registry = plugins(plugin_bad=text, plugin_good=entry())
    assert [stage.entry.name for stage in registry.stages] == ["mine"]
    assert "plugin_bad 1.0" in str(registry.broken[0])
    assert says in str(registry.broken[0])
    with pytest.raises(PluginError, match="plugin_bad") as caught:
        registry.find("extractor", "gone")
    assert says in str(caught.value), "the reason is repeated where a stage is missed"


def test_the_folder_of_a_package_is_told_to_be_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in {
        "my-peaks": '[project]\nname = "surely-not-installed"\n',
        "numpy": '[project]\nname = "numpy"\n',
        "no-project": "[tool]\n",
        "half-written": "[project\n",
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "pyproject.toml").write_text(text, encoding="utf-8")
    with pytest.raises(PluginError, match="`pip install -e my-peaks`"):
        discover().find("extractor", "my-peaks")
    for name in ("numpy", "no-project", "half-written", "nowhere", "a\0b"):
        assert not_installed(name) is None


def test_two_plugins_claim_a_name(plugins) -> None:
    registry = plugins(plugin_one=entry(), plugin_two=entry())
    with pytest.raises(PluginError) as caught:
        registry.find("extractor", "mine")
    assert "plugin_one 1.0" in str(caught.value)
    assert "`use: plugin_two/mine`" in str(caught.value)
    assert registry.find("extractor", "plugin_two/mine").provider.distribution == "plugin_two"


def test_a_missing_extra_and_a_missing_class_say_what_to_do(plugins) -> None:
    needs = (("not_there_at_all", 'pip install "roemetry[open3d]"'),)
    registry = plugins(plugin_extra=entry(requires=needs), plugin_class=entry(name="no-class"))
    with pytest.raises(PluginError, match=r"roemetry\[open3d\]"):
        registry.find("extractor", "mine")
    with pytest.raises(PluginError, match="cannot be imported"):
        registry.load(registry.find("extractor", "no-class"))
    number = plugins(plugin_number=entry(name="pi", target="math:pi"))
    with pytest.raises(PluginError, match=r"math:pi of plugin_number 1\.0 .* is not a class"):
        number.load(number.find("extractor", "pi"))


def test_strict_mode_only_built_in_ones_and_one_that_interrupts(plugins, monkeypatch) -> None:
    monkeypatch.setenv("ROEMETRY_STRICT", "1")
    with pytest.raises(PluginError, match="ROEMETRY_STRICT"):
        plugins(plugin_bad="raise RuntimeError('x')")
    monkeypatch.setenv("ROEMETRY_PLUGINS", "")
    assert plugins(plugin_other=entry()).stages == ()
    with pytest.raises(PluginError, match="did you mean `dominant-peak`"):
        discover().find("extractor", "dominantpeak")
    for variable in ("ROEMETRY_STRICT", "ROEMETRY_PLUGINS"):
        monkeypatch.delenv(variable)
    with pytest.raises(PluginError, match=r"interrupted while the plugin plugin_stop 1\.0"):
        plugins(plugin_stop="raise KeyboardInterrupt")
