"""Kernels on disk are used as long as nothing has changed; without a compiler they are plain functions."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import ClassVar

import pytest
from llvmlite import binding
from numba import types

import roemetry_kernels
from benchmarks import golden
from roemetry.run.time_limit import StageTimeout, time_limit
from roemetry_kernels import kernel_cache
from roemetry_kernels.compiling import kernel

PLUGINS = Path(__file__).parents[3] / "plugins"

CALLED = """
from roemetry_made.numbers import FACTOR
from roemetry_kernels.compiling import kernel

@kernel
def called(x):
    return x * FACTOR
"""
CALLER = """
from roemetry_kernels.compiling import kernel
from roemetry_made.called import called

@kernel
def caller(x):
    return called(x) + 1.0

"""
RUN = """
import os
from roemetry_kernels import kernel_cache
if "ROEMETRY_TEST_READ_ONLY" in os.environ:  # permissions do not stop a superuser
    kernel_cache.BesideSource.from_function = classmethod(lambda cls, py_func, py_file: None)
from roemetry_made.caller import caller
print(caller(2.0), sum(caller.stats.cache_hits.values()))
"""


@pytest.fixture(autouse=True)
def no_common_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)


def started(folder: Path, **env: str) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(folder), str(PLUGINS)])
    return subprocess.Popen(
        [sys.executable, "-c", RUN], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", **env},
    )  # fmt: skip


def ran(folder: Path, **env: str) -> list[str]:
    out, warned = said(started(folder, **env))
    assert warned == ""
    return out


def said(process: subprocess.Popen[str]) -> tuple[list[str], str]:
    out, warned = process.communicate()
    assert process.returncode == 0, warned
    return out.split(), warned


@pytest.fixture
def package(tmp_path: Path) -> Path:
    made = tmp_path / "roemetry_made"
    made.mkdir()
    for name, text in (("__init__", ""), ("numbers", "FACTOR = 3.0"), ("called", CALLED), ("caller", CALLER)):
        (made / f"{name}.py").write_text(text)
    return made


def test_a_kernel_is_kept_and_made_anew_when_damaged_or_a_callee_or_its_constant_changes(
    package: Path,
) -> None:
    assert ran(package.parent) == ["7.0", "0"]
    damaged(package, "nbi")
    # what another processor makes stands aside
    assert ran(package.parent, NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="") == ["7.0", "0"]
    # nothing can be written beside the source: what lies there is used from home
    home = package.parent / "home"
    out, warned = said(started(package.parent, XDG_CACHE_HOME=str(home), ROEMETRY_TEST_READ_ONLY="1"))
    assert (out, warned) == (["7.0", "1"], "")
    assert len(list(home.rglob("*.nbc"))) == 2
    (package / "called.py").write_text(CALLED.replace("x * FACTOR", "x + FACTOR"))
    assert ran(package.parent) == ["6.0", "0"]
    (package / "numbers.py").write_text("FACTOR = 5.0")
    assert ran(package.parent) == ["8.0", "0"]


def damaged(package: Path, ending: str) -> None:
    """Cut off what is kept; it is compiled anew, which is said once."""
    kept = sorted((package / "__pycache__").glob(f"*.{ending}"))
    assert len(kept) == 2
    for path in kept:
        path.write_bytes(path.read_bytes()[:40])
    out, warned = said(started(package.parent))
    assert out == ["7.0", "0"]
    assert "is damaged" in warned
    assert warned.count("KernelCacheWarning:") == 1


@pytest.mark.thorough
def test_installations_of_the_same_sources_share_a_given_folder(package: Path, tmp_path: Path) -> None:
    shutil.copytree(package, tmp_path / "other" / package.name)
    given = str(tmp_path / "kernels")
    assert ran(package.parent, NUMBA_CACHE_DIR=given) == ["7.0", "0"]
    assert ran(tmp_path / "other", NUMBA_CACHE_DIR=given) == ["7.0", "1"]
    (tmp_path / "other" / package.name / "numbers.py").write_text("FACTOR = 5.0")
    assert ran(tmp_path / "other", NUMBA_CACHE_DIR=given) == ["11.0", "0"]
    assert ran(package.parent, NUMBA_CACHE_DIR=given) == ["7.0", "1"]


def test_of_processes_that_start_together_one_compiles(package: Path) -> None:
    processes = [started(package.parent) for _ in range(2)]
    assert sorted(said(process)[0] for process in processes) == [["7.0", "0"], ["7.0", "1"]]


@pytest.mark.thorough
def test_two_processes_name_no_function_alike(package: Path) -> None:
    """The linker takes one for the other where both are read from disk."""
    names: list[set[bytes]] = []
    for _ in range(2):
        assert ran(package.parent) == ["7.0", "0"]
        code = b"".join(path.read_bytes() for path in (package / "__pycache__").glob("*.nbc"))
        names.append(set(re.findall(rb"roemetry_made6caller6callerB\d+v\d+", code)))
        (package / "caller.py").write_text(CALLER + "# changed\n")
    assert len(names[0]) == len(names[1]) == 1
    assert names[0] != names[1]


@pytest.mark.thorough
def test_code_that_is_damaged_on_disk_is_compiled_anew(package: Path) -> None:
    assert ran(package.parent) == ["7.0", "0"]
    damaged(package, "nbc")
    assert ran(package.parent) == ["7.0", "1"]


@pytest.mark.parametrize(("lacks", "target"), [("avx512f", "x86-64-v3"), ("avx2", None)])
def test_every_processor_with_avx2_runs_the_same_kernels(
    monkeypatch: pytest.MonkeyPatch, lacks: str, target: str | None
) -> None:
    has = dict.fromkeys(roemetry_kernels._NEEDED, True) | {lacks: False}
    monkeypatch.setattr(binding, "get_host_cpu_features", lambda: has)
    monkeypatch.setenv("NUMBA_CPU_NAME", "somebody's")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    roemetry_kernels._compile_for_common_processors()
    assert os.environ["NUMBA_CPU_NAME"] == "somebody's"
    monkeypatch.delenv("NUMBA_CPU_NAME")
    monkeypatch.delenv("NUMBA_CPU_FEATURES")
    monkeypatch.delitem(sys.modules, "numba")
    roemetry_kernels._compile_for_common_processors()
    assert os.environ.get("NUMBA_CPU_NAME") == target


def test_where_nothing_can_be_written_kernels_run_all_the_same_and_it_is_said_once(package: Path) -> None:
    (package / "__pycache__").write_text("a file, where numba would make a folder")
    out, warned = said(
        started(package.parent, XDG_CACHE_HOME=str(package / "__init__.py"), NUMBA_CACHE_DIR="")
    )
    assert out == ["7.0", "0"]
    assert "are not kept" in warned
    assert warned.count("KernelCacheWarning:") == 1


def test_who_waited_long_enough_compiles_for_himself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl", reason="no locks of this kind on this system")
    source = tmp_path / "made.py"
    source.write_text("")
    monkeypatch.setattr(kernel_cache, "_WAIT_S", 0.1)
    with source.open("rb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with kernel_cache._turn(source):
            pass
    with source.open("rb") as other:
        with kernel_cache._turn(source), kernel_cache._turn(source), pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


@pytest.mark.parametrize("in_thread", [False, True])
def test_a_stage_s_time_limit_waits_until_its_kernel_is_compiled(in_thread: bool) -> None:
    """Of a kernel whose compilation takes longer than the stage may."""

    def compiles_slowly(signature: object) -> str:
        time.sleep(0.3)
        return "compiled"

    class Compiled:
        compile = staticmethod(compiles_slowly)
        overloads: ClassVar[dict[object, object]] = {}

    def stage() -> tuple[object, str]:
        made = None
        try:
            with time_limit(0.15):
                made = kernel_cache.compiled_in_turns(Compiled(), Path(__file__)).compile((types.float64,))
                while True:
                    time.sleep(0.01)
        except StageTimeout:
            return made, "stopped afterwards"

    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(stage).result(10.0) if in_thread else stage()
    assert found == ("compiled", "stopped afterwards")


def test_every_kernel_is_compiled_by_the_decorator_that_looks_at_all_sources() -> None:
    found = []
    for path in sorted(PLUGINS.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            compiles = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("njit", "jit")
            if compiles and path.name != "compiling.py" and any(w.arg == "cache" for w in node.keywords):
                found.append(f"{path.relative_to(PLUGINS)}:{node.lineno}")
    assert found == [], "use roemetry_kernels.compiling.kernel: numba's cache looks at one file alone"


def test_a_kernel_that_could_not_be_kept_on_disk_is_refused() -> None:
    def made(called: object) -> object:
        def calling(x):
            return called(x)

        return kernel(calling)

    with pytest.raises(TypeError, match="would never be found again on disk"):
        made(kernel(lambda x: x))


MEASURE_FIRST = """
import json, sys
from numba import config
from benchmarks import golden

assert config.DISABLE_JIT
print(json.dumps(golden.first_lines(sys.argv[1], 1)))
"""


IN_SECONDS = ("egg/recipe", "herring_roe/recipe", "weld_groove/recipe")
"""Of the shipped recipes; the others take up to half a minute each without the compiler:
``NUMBA_DISABLE_JIT=1 python -m benchmarks golden --images 1`` compares all of them."""


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=pytest.mark.thorough) for name in IN_SECONDS[:2]), IN_SECONDS[2]]
)
def test_a_recipe_measures_the_same_without_the_compiler(name: str) -> None:
    """The first image of a shipped recipe, against the golden records that the compiled kernels made."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURE_FIRST, name],
        capture_output=True, text=True, check=False, cwd=golden.ROOT,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    expected = json.loads(golden.file_of(name).read_text("utf-8"))[: len(found)]
    assert list(golden.differences(expected, found, name)) == []
