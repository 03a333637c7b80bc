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
from benchmarks.extraction.tables import Table, number

YARDSTICK = "OpenCV blur + dilate + log-parabola"
_SLOW_S = 0.5
_FEW = 3


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
