"""Without the compiler every kernel is a plain Python function, the reference for the compiled one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

RECIPE = Path(__file__).parents[3] / "recipes" / "herring_roe" / "recipe.yaml"
MEASURE_FIRST = """
import json, sys
from numba import config
from roemetry import Recipe

recipe = Recipe.load(sys.argv[1])
source = recipe.source.make()
frame = source.read(next(iter(source.references(recipe.source_path)))).frames[0]
rows = [json.loads(row.to_json()) for row in recipe.measure(frame.pixels)]
print(json.dumps({"compiled": not config.DISABLE_JIT, "rows": rows}))
"""


def measured(**environment: str) -> dict[str, object]:
    done = subprocess.run(
        [sys.executable, "-c", MEASURE_FIRST, str(RECIPE)],
        capture_output=True, text=True, check=False, env={**os.environ, **environment},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, object] = json.loads(done.stdout)
    return found


def flat(value: object, path: str = "") -> dict[str, object]:
    """Give every value of nested JSON by its path; times, which no two runs share, are left out."""
    if isinstance(value, dict):
        parts = [flat(one, f"{path}.{key}") for key, one in value.items() if "time" not in key]
    elif isinstance(value, list):
        parts = [flat(one, f"{path}[{k}]") for k, one in enumerate(value)]
    else:
        return {path: value}
    return {key: one for part in parts for key, one in part.items()}


def test_a_recipe_measures_the_same_without_the_compiler() -> None:
    plain, compiled = measured(NUMBA_DISABLE_JIT="1"), measured(NUMBA_DISABLE_JIT="0")
    assert (plain.pop("compiled"), compiled.pop("compiled")) == (False, True)
    expected = flat(compiled)
    assert expected[".rows[0].volume.visible_mm3.value"] == pytest.approx(21839.0, abs=1.0)  # mm³
    # the compiler may add terms in another order: the last digits of a sum
    assert flat(plain) == {
        path: pytest.approx(value, rel=1e-9) if isinstance(value, float) else value
        for path, value in expected.items()
    }
