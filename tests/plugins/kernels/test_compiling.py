"""What numba keeps on disk is used again, and only as long as nothing it was made from has changed."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

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
from roemetry_made.caller import caller
print(caller(2.0), sum(caller.stats.cache_hits.values()))
"""


def ran(folder: Path) -> list[str]:
    path = os.pathsep.join([str(folder), str(PLUGINS)])
    done = subprocess.run(
        [sys.executable, "-c", RUN], capture_output=True, text=True, check=True, cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip
    return done.stdout.split()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    made = tmp_path / "roemetry_made"
    made.mkdir()
    for name, text in (("__init__", ""), ("numbers", "FACTOR = 3.0"), ("called", CALLED), ("caller", CALLER)):
        (made / f"{name}.py").write_text(text)
    return made


def test_a_kernel_is_kept_and_made_anew_when_a_callee_or_its_constant_changes(package: Path) -> None:
    assert ran(package.parent) == ["7.0", "0"]
    assert ran(package.parent) == ["7.0", "1"]
    (package / "called.py").write_text(CALLED.replace("x * FACTOR", "x + FACTOR"))
    assert ran(package.parent) == ["6.0", "0"]
    (package / "numbers.py").write_text("FACTOR = 5.0")
    assert ran(package.parent) == ["8.0", "0"]
    assert ran(package.parent) == ["8.0", "1"]


def test_every_kernel_is_compiled_by_the_decorator_that_looks_at_all_sources() -> None:
    found = []
    for path in sorted(PLUGINS.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            compiles = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("njit", "jit")
            if compiles and path.name != "compiling.py" and any(w.arg == "cache" for w in node.keywords):
                found.append(f"{path.relative_to(PLUGINS)}:{node.lineno}")
    assert found == [], "use roemetry_kernels.compiling.kernel: numba's cache looks at one file alone"
