"""From the shell to the first extraction, beside a minimal program with numba and one cached kernel."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.tables import Table, number

MINIMAL = """
import numpy as np
from numba import njit

@njit(cache=True, nogil=True)
def brightest(image):
    top = image[0, 0]
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            top = max(top, image[y, x])
    return top

image = np.zeros((480, 640), np.uint8)
image[:, 297:306] = 20, 60, 120, 180, 200, 180, 120, 60, 20
assert brightest(image) == 200
"""

FIRST = """
import numpy as np
from roemetry.records import Frame
from roemetry.stages.registry import discover

image = np.zeros((480, 640), np.uint8)
image[:, 297:306] = 20, 60, 120, 180, 200, 180, 120, 60, 20
registry = discover()
extractor = registry.load(registry.find("extractor", "{name}"))()
assert len(extractor.extract(Frame(image))) > 400
"""

RECIPE = """\
roemetry: 1
product: one line
source: {{path: images}}
stages:
  extractor: {name}
sinks: []
"""


def startup(names: Sequence[str], repeats: int) -> Table:
    """Time whole processes in turn; the first round, which fills the caches, does not count."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        commands = {"minimal program with numba": script(home / "minimal.py", MINIMAL)}
        for name in names:
            commands[f"{name}: in a script"] = script(home / f"{name}.py", FIRST.format(name=name))
        for name in names[-1:]:
            commands[f"{name}: `roemetry run`, one image"] = run_of(home / f"run-{name}", name)
        seconds: dict[str, list[float]] = {what: [] for what in commands}
        for repeat in range(repeats + 1):
            for what, command in commands.items():
                begin = time.perf_counter()
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=folder)
                if repeat:
                    seconds[what].append(time.perf_counter() - begin)
    minimal = seconds["minimal program with numba"]
    rows = [
        [
            what,
            number(1e3 * statistics.median(taken), 0),
            number(statistics.median(a / b for a, b in zip(taken, minimal, strict=True)), 2),
        ]
        for what, taken in seconds.items()
    ]
    return Table(
        f"From the shell to the first extraction, whole processes, medians of {repeats} rounds",
        ["program", "ms", "over the minimal one"],
        rows,
    )


def script(path: Path, text: str) -> list[str]:
    """Write a program; gives the command."""
    path.write_text(text, encoding="utf-8")
    return [sys.executable, str(path)]


def run_of(home: Path, name: str) -> list[str]:
    """Write a recipe that ends after the extractor, with one image; gives the command."""
    import cv2
    import numpy as np

    (home / "images").mkdir(parents=True)
    image = np.zeros((480, 640), np.uint8)
    image[:, 297:306] = 20, 60, 120, 180, 200, 180, 120, 60, 20
    cv2.imwrite(str(home / "images" / "line.png"), image)
    (home / "recipe.yaml").write_text(RECIPE.format(name=name), encoding="utf-8")
    return [sys.executable, "-m", "roemetry", "run", str(home / "recipe.yaml")]
