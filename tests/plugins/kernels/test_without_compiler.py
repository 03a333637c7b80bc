"""Without the compiler every kernel is a plain Python function, the reference for the compiled one."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from benchmarks import golden

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
