"""How fast: every method on the same image in turn, in one thread; and whole processes, from the shell on.

The thread's own time is that of the clock on a machine with nothing else to do; a busy machine adds only what
it does to caches and clock rates, which hits all methods alike.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.extraction.drawing import SIZES, drawn_set
from benchmarks.extraction.methods import Method
from benchmarks.tables import Table, number

YARDSTICK = "OpenCV blur + dilate + log-parabola"
_SLOW_S, _FEW = 0.5, 3
_IMAGES = 8
_WARMING = 2  # rounds that are not counted


def speed(methods: Sequence[Method], sizes: Sequence[str], repeats: int, seed: int) -> Table:
    """Give the median time at each size, Mpixel/s, and the median of the ratios to the fastest OpenCV recipe.

    Methods that take long are tried at the smallest size only, and three times.
    """
    cells: dict[str, list[str]] = {method.name: [method.name] for method in methods}
    for size in sizes:
        seconds = _times(methods, size, repeats, seed)
        own, pixels = seconds.get(YARDSTICK), SIZES[size][0] * SIZES[size][1]
        for name, row in cells.items():
            if name not in seconds:
                row += ["–", "–", "–"]
                continue
            taken = seconds[name]
            middle = statistics.median(taken)
            ratio = float("nan")
            if own:
                ratio = statistics.median(a / b for a, b in zip(own, taken, strict=False))
            row += [number(1e3 * middle, 2), number(pixels / middle / 1e6, 0)]
            row.append(number(ratio, 2 if ratio >= 0.1 else 3))
    return Table(
        f"Speed, processor time of one thread, medians of {repeats} rounds; ×: over the OpenCV log-parabola",
        ["method", *(f"{size}, {what}" for size in sizes for what in ("ms", "Mpixel/s", "×"))],
        list(cells.values()),
    )


def _times(methods: Sequence[Method], size: str, repeats: int, seed: int) -> dict[str, list[float]]:
    """Time every method on one image of a size, in turn."""
    drawn = drawn_set("speckle", SIZES[size], np.random.default_rng([seed, 14]))
    timed = [method for method in methods if not method.slow or size == next(iter(SIZES))]
    for method in timed:
        method.find(drawn.pixels, drawn.light)  # compiled, and the memory touched
    seconds: dict[str, list[float]] = {method.name: [] for method in timed}
    for repeat in range(repeats):
        for method in timed:
            taken = seconds[method.name]
            if repeat < _FEW or statistics.median(taken) <= _SLOW_S:
                begin = time.thread_time()
                method.find(drawn.pixels, drawn.light)
                taken.append(time.thread_time() - begin)
    return seconds


def frame_after_frame(methods: Sequence[Method], repeats: int, seed: int) -> Table:
    """Time each method as it runs on a line: one frame after the other, and nothing else in between.

    In turn with two dozen others each method finds caches that hold none of its instructions; what it then
    takes over this is theirs to fill.
    """
    size, rng = next(iter(SIZES)), np.random.default_rng([seed, 15])
    drawn = [drawn_set("speckle", SIZES[size], rng) for _ in range(_IMAGES)]
    rows = []
    for method in (method for method in methods if not method.slow):
        taken = []
        for repeat in range(_WARMING + repeats):
            for each in drawn:
                begin = time.thread_time()
                method.find(each.pixels, each.light)
                if repeat >= _WARMING:
                    taken.append(time.thread_time() - begin)
        quick = statistics.quantiles(taken, n=20)[0]
        rows.append([method.name, number(1e3 * statistics.median(taken), 3), number(1e3 * quick, 3)])
    title = f"The same frame after frame, as on a line; {_IMAGES} VGA images, {repeats} times each"
    return Table(title, ["method", "median, ms", "quickest 5 %, ms"], rows)


def in_turn(
    commands: Mapping[str, Sequence[str]], repeats: int, folder: str | None = None
) -> dict[str, list[float]]:
    """Time whole processes in turn, s; the first round, which fills the caches, does not count."""
    seconds: dict[str, list[float]] = {what: [] for what in commands}
    for repeat in range(repeats + 1):
        for what, command in commands.items():
            begin = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=folder)
            if repeat:
                seconds[what].append(time.perf_counter() - begin)
    return seconds


def script(path: Path, text: str) -> list[str]:
    """Write a program; gives the command."""
    path.write_text(text, encoding="utf-8")
    return [sys.executable, str(path)]


_LINE = (20, 60, 120, 180, 200, 180, 120, 60, 20)
_IMAGE = f"""
import numpy as np
image = np.zeros((480, 640), np.uint8)
image[:, 297:306] = {_LINE}
"""
MINIMAL = f"""{_IMAGE}
from numba import njit

@njit(cache=True, nogil=True)
def brightest(image):
    top = image[0, 0]
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            top = max(top, image[y, x])
    return top

assert brightest(image) == 200
"""
FIRST = f"""{_IMAGE}
from roemetry.records import Frame
from roemetry.stages.registry import discover

registry = discover()
extractor = registry.load(registry.find("extractor", "NAME"))()
assert len(extractor.extract(Frame(image))) > 400
"""
RECIPE = (
    "{{roemetry: 1, product: one line, source: {{path: images}}, stages: {{extractor: {}}}, sinks: []}}\n"
)


def startup(names: Sequence[str], repeats: int) -> Table:
    """Time programs from the shell to the first extraction, beside a minimal one with numba."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        commands = {"minimal program with numba": script(home / "minimal.py", MINIMAL)}
        for name in names:
            commands[f"{name}: in a script"] = script(home / f"{name}.py", FIRST.replace("NAME", name))
        for name in names[-1:]:  # a recipe that ends after the extractor, with one image
            (home / "run" / "images").mkdir(parents=True)
            image = np.zeros((480, 640), np.uint8)
            image[:, 297:306] = _LINE
            cv2.imwrite(str(home / "run" / "images" / "line.png"), image)
            (home / "run" / "recipe.yaml").write_text(RECIPE.format(name), encoding="utf-8")
            run = [sys.executable, "-m", "roemetry", "run", str(home / "run" / "recipe.yaml")]
            commands[f"{name}: `roemetry run`, one image"] = run
        seconds = in_turn(commands, repeats, folder)
    minimal = seconds["minimal program with numba"]
    rows = []
    for what, taken in seconds.items():
        ratio = statistics.median(a / b for a, b in zip(taken, minimal, strict=True))
        rows.append([what, number(1e3 * statistics.median(taken), 0), number(ratio, 2)])
    title = f"From the shell to the first extraction, whole processes, medians of {repeats} rounds"
    return Table(title, ["program", "ms", "over the minimal one"], rows)
