"""Extractors against the bound that physics sets, and against what else can be installed.

``python -m benchmarks extract [--only precision speed bias along startup] [--methods WORD …] [--page]``

Draws images of stripes whose centres are known (`benchmarks.extraction.drawing` has the model), computes the
Cramér-Rao bound of a single row, and gives for every registered extractor and every peer: RMS error over the
bound, bias, missed and false peaks, how true the stated uncertainties are, speed in one run, the time from
the shell to the first extraction. ``--page`` puts the tables into the documentation.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import chain

import cv2
import numpy as np

from benchmarks.command import parser_of
from benchmarks.extraction.drawing import SIZES, Light, drawn_set
from benchmarks.extraction.judging import along, bias, close_together, precision, two_materials
from benchmarks.extraction.methods import TOLD, Method, frame_of, measured_beforehand, methods
from benchmarks.extraction.timing import frame_after_frame, speed, startup
from benchmarks.tables import Table, put_tables
from roemetry.records import Frame

SEED = 40_000
"""Used while the extractors were built; the figures of the documentation are from another one."""


def main() -> None:
    """Print the tables, and put them into the documentation if wanted."""
    parser = parser_of(__doc__)
    parts = ("precision", "materials", "pitch", "bias", "along", "speed", "startup")
    parser.add_argument("--only", nargs="*", choices=parts, default=parts, help="parts to run")
    parser.add_argument("--methods", nargs="*", default=[], help="only methods whose name holds a word")
    parser.add_argument("--images", type=int, default=16, help="VGA images a set")
    parser.add_argument("--rows", type=int, default=10_000, help="rows behind each mean of the bias (clean)")
    parser.add_argument("--repeats", type=int, default=15, help="rounds of timing")
    parser.add_argument("--sizes", nargs="*", choices=SIZES, default=list(SIZES), help="image sizes timed")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--page", action="store_true", help="put all tables into the documentation")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    judged, left_out = methods(tuple(given.methods))
    fast = [method for method in judged if not method.slow]
    # without the peers that would take most of an hour for a million rows
    quick = [one for one in judged if one.ours or one.name.startswith(("OpenCV", "numpy", "C++"))]
    finding = [one for one in judged if one.ours and one.name not in TOLD]
    images, seed = given.images, given.seed
    runs: dict[str, Callable[[], list[Table]]] = {
        "precision": lambda: [precision(judged, images, seed, known=True), *unknown(finding, images, seed)],
        "materials": lambda: [two_materials(judged, images, seed)],
        "pitch": lambda: [close_together(fast, max(images // 4, 1), seed)],
        "bias": lambda: [bias(quick, given.rows, seed)],
        "along": lambda: along(max(images // 2, 1), seed),
        "speed": lambda: [
            speed(everything := timed(judged, seed), given.sizes, given.repeats, seed),
            frame_after_frame(everything, given.repeats, seed),
        ],
        "startup": lambda: [startup([each.name for each in finding], given.repeats)],
    }
    made: dict[str, list[Table]] = {}
    for part in parts:
        if part in given.only:
            made[part] = runs[part]()
            for table in made[part]:
                print(table, flush=True)
    for name, why in left_out.items():
        print(f"left out: {name}: {why}", file=sys.stderr)
    if given.page:
        without = "".join(f" Left out: {name} ({why})." for name, why in left_out.items())
        put_tables(chain.from_iterable(made.values()), "extract", " ".join(sys.argv[1:]), without)


def unknown(finding: list[Method], count: int, seed: int) -> list[Table]:
    """Judge those that model noise again, with nothing known of the sensor."""
    if not finding:
        return []
    table = precision(finding, count, seed, known=False)
    return [replace(table, title=f"The same without data on the sensor's noise. {table.title}")]


def timed(judged: list[Method], seed: int) -> list[Method]:
    """Add what is only a matter of time: a noise model that was measured on other images before."""
    if "maximum-likelihood" not in {method.name for method in judged}:
        return judged

    def others(size: tuple[int, int]) -> list[Frame]:
        light = Light()
        rng = np.random.default_rng([seed, 17])
        return [frame_of(drawn_set("speckle", size, rng).pixels, light) for _ in range(2)]

    return [*judged, measured_beforehand(others)]
