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
from itertools import islice
from numba import config
from benchmarks import golden
from roemetry import Recipe

assert config.DISABLE_JIT
recipe = Recipe.load(sys.argv[1], sets=["draws=0", "sinks=[]"])
print(json.dumps(list(golden._lines(recipe, 1))))
"""


@pytest.mark.parametrize("name", golden.RECIPES)
def test_a_recipe_measures_the_same_without_the_compiler(name: str) -> None:
    """The first image of each shipped recipe, against the golden records that the compiled kernels made."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURE_FIRST, str(golden.ROOT / "recipes" / f"{name}.yaml")],
        capture_output=True, text=True, check=False, cwd=golden.ROOT,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    expected = json.loads(golden.file_of(name).read_text("utf-8"))[: len(found)]
    assert list(golden.differences(expected, found, name)) == []
