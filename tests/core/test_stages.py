"""Plugins and stages that break, clash or hang are named, with what to do; what is kept of stages."""

from __future__ import annotations

import ctypes
import json
import signal
import sys
import textwrap
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import DistributionFinder, MetadataPathFinder
from pathlib import Path

import numpy as np
import pytest

from roemetry.config.recipe import Recipe
from roemetry.config.resolve import ResolvedStage
from roemetry.errors import DataError, PluginError
from roemetry.records import Decision, Estimate, Peaks, Weight
from roemetry.run.pipeline import Pipeline, keep_freed_memory
from roemetry.run.stage_cache import CachedStages, StageCache
from roemetry.run.stage_errors import describe_failure, plugin_frame, wrap_stage_error
from roemetry.run.time_limit import StageTimeout, not_counted, time_limit, timer_kept
from roemetry.stages.hookspecs import API
from roemetry.stages.registry import Registry, discover, not_installed
from roemetry.testing.solids import HALF_ELLIPSOID, product_of

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


def caught() -> Exception:
    """What json raises when it is called from here: the error lies deeper than this file."""
    try:
        json.loads("{")
    except ValueError as error:
        return error
    raise AssertionError


def chosen() -> ResolvedStage:
    registered = discover().find("extractor", "dominant-peak")
    stage = discover().load(registered)
    return ResolvedStage(registered, stage, stage.Options())


def test_the_innermost_line_of_the_package_is_named() -> None:
    line = caught.__code__.co_firstlineno + 3
    assert plugin_frame(caught(), __name__) == f"{Path(__file__).name}:{line}"
    assert str(plugin_frame(caught(), "json")).startswith("decoder.py:")
    assert plugin_frame(caught(), "roemetry_paper.dominant_peak") is None
    assert plugin_frame(ValueError("never raised"), __name__) is None


def test_the_stage_is_named() -> None:
    said = describe_failure(ValueError("oh"), "extractor", chosen())
    assert said == (
        "the extractor `dominant-peak` failed with ValueError: oh (a plugin's fault; see --debug)"
    )
    assert describe_failure(ValueError("oh"), "draws", None).startswith("the draws failed with ValueError")


def test_outside_a_run_a_fault_is_a_plugin_error_and_a_refusal_stays_one() -> None:
    fault = pytest.raises(PluginError, match="the extractor `dominant-peak` failed")
    with fault as broke, wrap_stage_error("extractor", chosen()):
        raise ZeroDivisionError("oh")
    assert isinstance(broke.value.__cause__, ZeroDivisionError)
    with pytest.raises(DataError), wrap_stage_error("extractor", chosen()):
        raise DataError("no light")
    with fault, wrap_stage_error("extractor", chosen()):
        sys.exit(0)


def test_a_record_that_contradicts_itself_is_its_stages_fault() -> None:
    fault = pytest.raises(PluginError, match="`dominant-peak` failed with RecordError: Peaks: ")
    with fault as broke, wrap_stage_error("extractor", chosen()):
        Peaks((4, 4), np.array([0.5]), *(np.array([np.nan]),) * 5, flags=np.zeros(1))
    assert "row holds what is no whole number" in broke.value.message
    assert "x_px is outside −0.5…3.5, or not a number" in broke.value.message


GRADER = (
    "stages.grader={use: grade-table, options: {classes: "
    "[{label: heavy, limits: {weight_g: {at_least: 10}}}, {label: light}]}}"
)


def test_a_grader_decides_anew_where_draws_give_other_uncertainties(line: Callable[..., Path]) -> None:
    recipe = Recipe.load(line(count=1), sets=[GRADER])
    memory = StageCache()
    product = product_of(HALF_ELLIPSOID)

    def decided(draws: int, std_g: float) -> Decision:
        grader = CachedStages(recipe, memory, draws).stages["grader"]
        mass = Estimate(9.9, std_g, interval=(9.9 - 2.0 * std_g, 9.9 + 2.0 * std_g))
        found: Decision = grader.decide(product, None, Weight(mass), None)
        return found

    sure = decided(0, 0.001)
    assert sure.label == "light"
    assert decided(200, 1.0).label == "undecided"
    assert decided(0, 0.001) is sure


def test_what_a_step_raised_is_raised_again_with_its_place() -> None:
    memory, places = StageCache(), []

    def breaks() -> None:
        raise IndexError("oh")

    for _ in range(3):
        with pytest.raises(IndexError) as broke:
            memory.recall("key", breaks)
        places.append([str(entry.path.name) for entry in broke.traceback])
    assert broke.traceback[-1].name == "breaks"
    assert places[0] == places[1] == places[2], "the traceback does not grow"


def test_variants_of_a_scan_do_not_take_one_line_for_another(root: Path) -> None:
    recipe = Recipe.load(root / "recipes/belt_scan", sets=["draws=0"])
    source = recipe.source.make()
    acquisition = source.read(recipe.references()[0])
    remembered = CachedStages(recipe, StageCache())
    alone, shared = (
        Pipeline(recipe, stages=stages).trace(acquisition) for stages in (None, remembered.stages)
    )
    assert alone.products
    for one, other in zip(alone.products, shared.products, strict=True):
        assert one.volume is not None
        assert other.volume is not None
        assert one.volume.visible_mm3 == other.volume.visible_mm3


def works_for(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def hangs() -> str:
    begin = time.monotonic()
    try:
        with time_limit(0.1):
            while True:
                try:
                    works_for(60.0)
                except Exception:  # what a careless plugin writes
                    continue
    except StageTimeout:
        works_for(0.15)  # nothing is raised a second time
        return "in time" if time.monotonic() - begin < 5.0 else "late"


def ends_before() -> str:
    with time_limit(60.0):
        pass
    for _ in range(2000):  # some of them end in the very moment in which their time is up
        try:
            with time_limit(1e-5):
                works_for(1e-5)
        except StageTimeout:
            continue
    works_for(0.05)
    return "undisturbed"


def hangs_after_many_that_just_ended() -> str:
    ends_before()
    return hangs()


def does_not_count_what_others_do() -> str:
    with time_limit(0.2):
        with not_counted():
            works_for(0.5)
        works_for(0.01)
    try:
        with time_limit(0.2):
            with not_counted():
                works_for(0.1)
            works_for(60.0)
    except StageTimeout:
        return "it goes on"
    return "lost"


def is_within_another() -> str:
    try:
        with time_limit(0.1):
            with time_limit(60.0):
                pass
            works_for(60.0)
    except StageTimeout:
        return "the outer one holds"
    return "lost"


@pytest.mark.parametrize(
    ("does", "comes_to"),
    [
        (hangs, "in time"),
        (ends_before, "undisturbed"),
        (hangs_after_many_that_just_ended, "in time"),
        (is_within_another, "the outer one holds"),
        (does_not_count_what_others_do, "it goes on"),
    ],
)
def test_a_limit_holds_in_every_thread_alone(does: Callable[[], str], comes_to: str) -> None:
    with ThreadPoolExecutor(2) as pool:
        beside = pool.submit(works_for, 0.3)
        assert pool.submit(does).result(timeout=60.0) == comes_to
        beside.result(timeout=60.0)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer")
def test_a_timer_that_is_kept_holds_each_limit_and_goes_back() -> None:
    before = signal.getsignal(signal.SIGALRM)
    with timer_kept():
        with time_limit(60.0):
            pass
        for _ in range(2):  # also after one that was up
            with pytest.raises(StageTimeout), time_limit(0.05), time_limit(60.0):
                works_for(60.0)
        works_for(0.1)  # nothing runs between limits
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer")
def test_a_timer_of_somebody_else_is_left_alone() -> None:
    signal.setitimer(signal.ITIMER_REAL, 60.0)
    try:
        with timer_kept(), time_limit(0.01):
            works_for(0.05)
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 50.0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


class _Library:
    def __init__(self) -> None:
        self.told: list[tuple[int, int]] = []

    def mallopt(self, which: int, value: int) -> int:
        self.told.append((which, value))
        return 1


def test_glibc_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    library = _Library()
    monkeypatch.setattr(ctypes, "CDLL", lambda _: library)
    keep_freed_memory.cache_clear()
    keep_freed_memory()
    keep_freed_memory()
    assert library.told == [(-3, 32 << 20), (-1, 256 << 20)]


@pytest.mark.parametrize("library", [object(), None])
def test_another_library_stays_as_it_is(library: object, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def found(name: object) -> object:
        asked.append(name)
        if library is None:
            raise OSError("there is no C library")
        return library

    monkeypatch.setattr(ctypes, "CDLL", found)
    keep_freed_memory.cache_clear()
    keep_freed_memory()
    keep_freed_memory()
    assert asked == [None], "the process itself is asked, once"
