"""Kernels are compiled before the first run, and only then; the run takes them from disk."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

COUNT = """
import json
import sys

import roemetry
from roemetry.cli.warm_up import warm_up

if __name__ == "__main__":
    told = []
    quick = ["stages.extractor=log-parabola", "stages.coder=ordered", "stages.aligner=null"]
    recipe = roemetry.Recipe.load(sys.argv[1], sets=quick)
    kinds = warm_up(recipe.stages, lambda done, of: told.append((done, of)))
    print(json.dumps([kinds, told]))
"""


def test_kernels_are_compiled_once(root: Path, tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_OPT": "1"}
    environment.pop("NUMBA_DISABLE_JIT", None)
    script = tmp_path / "count.py"
    script.write_text(COUNT, encoding="utf-8")
    command = [sys.executable, str(script), str(root / "recipes/herring_roe")]
    (kinds, told), again = (
        json.loads(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)
        for _ in range(2)
    )
    assert {"extractor", "coder"} <= set(kinds)
    done, of = zip(*told, strict=True)
    assert len(told) == len(kinds) + 1
    assert done == tuple(sorted(set(done)))
    assert (done[0], {done[-1]}) == (0, set(of))
    assert again == [[], []], "what lies on disk is not compiled again"
    assert list((tmp_path / "cache").rglob("*.nbi"))
