"""How fast: every method on the same image in turn, in one thread, by the processor time of that thread.

The thread's own time is that of the clock on a machine with nothing else to do; a busy machine adds only what
it does to caches and clock rates, which hits all methods alike.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence

import numpy as np

from benchmarks.extraction.drawing import SIZES, drawn_set
from benchmarks.extraction.methods import Method
from benchmarks.tables import Table, number

YARDSTICK = "OpenCV blur + dilate + log-parabola"
_SLOW_S = 0.5
_FEW = 3
_IMAGES = 8
_WARMING = 2  # rounds that are not counted


def speed(methods: Sequence[Method], sizes: Sequence[str], repeats: int, seed: int) -> Table:
    """Give the median time at each size, Mpixel/s, and the median of the ratios to the fastest OpenCV recipe.

    Methods that take long are tried at the smallest size only, and three times.
    """
    cells: dict[str, list[str]] = {method.name: [method.name] for method in methods}
    for size in sizes:
        seconds = times(methods, size, repeats, seed)
        own = seconds.get(YARDSTICK)
        height, width = SIZES[size]
        for method in methods:
            taken = seconds.get(method.name)
            if taken is None:
                cells[method.name] += ["–", "–", "–"]
                continue
            middle = statistics.median(taken)
            ratio = (
                statistics.median(a / b for a, b in zip(own, taken, strict=False)) if own else float("nan")
            )
            cells[method.name] += [
                number(1e3 * middle, 2),
                number(height * width / middle / 1e6, 0),
                number(ratio, 2 if ratio >= 0.1 else 3),
            ]
    return Table(
        f"Speed, processor time of one thread, medians of {repeats} rounds; ×: over the OpenCV log-parabola",
        ["method", *(f"{size}, {what}" for size in sizes for what in ("ms", "Mpixel/s", "×"))],
        list(cells.values()),
    )


def frame_after_frame(methods: Sequence[Method], repeats: int, seed: int) -> Table:
    """Time each method as it runs on a line: one frame after the other, and nothing else in between.

    In turn with two dozen others each method finds caches that hold none of its instructions; what it then
    takes over this is theirs to fill.
    """
    size = next(iter(SIZES))
    rng = np.random.default_rng([seed, 15])
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
    return Table(
        f"The same frame after frame, as on a line; {_IMAGES} VGA images, {repeats} times each",
        ["method", "median, ms", "quickest 5 %, ms"],
        rows,
    )


def times(methods: Sequence[Method], size: str, repeats: int, seed: int) -> dict[str, list[float]]:
    """Time every method on one image of a size, in turn."""
    drawn = drawn_set("speckle", SIZES[size], np.random.default_rng([seed, 14]))
    smallest = size == next(iter(SIZES))
    seconds: dict[str, list[float]] = {}
    for method in methods:
        if method.slow and not smallest:
            continue
        method.find(drawn.pixels, drawn.light)  # compiled, and the memory touched
        seconds[method.name] = []
    for repeat in range(repeats):
        for method in methods:
            taken = seconds.get(method.name)
            if taken is None or (repeat >= _FEW and statistics.median(taken) > _SLOW_S):
                continue
            begin = time.thread_time()
            method.find(drawn.pixels, drawn.light)
            taken.append(time.thread_time() - begin)
    return seconds
