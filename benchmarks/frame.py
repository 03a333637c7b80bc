"""Time from an array to a measurement, part by part against its budget.

``python -m benchmarks frame [--recipe recipes/herring_roe] [--repeats 50] [--sets fastest,careful,recipe]``
``python -m benchmarks frame --table [--repeats 5]``: what each shipped chain states and takes, as in README
``python -m benchmarks frame --patterns [--repeats 5]``: the same of the recipes of patterns

One core, after warm-up, without files; uncertainty only in tables. Milliseconds move with the machine and its
load: the 5 % quickest frames are the least disturbed, and OpenCV's blur and dilation of the same image stand
beside them as a yardstick. What other programs take away is in no processor time.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence

import cv2

from benchmarks.command import parser_of
from benchmarks.tables import table
from roemetry import Pipeline, Recipe
from roemetry.run.rows import measurements_of

BUDGET_MS = {
    "extractor": 0.35, "coder": 0.20, "triangulator": 0.15, "volume": 0.08, "classifier": 0.08,
    "records": 0.10,
}  # fmt: skip
"""Of the fastest set at 640 × 480 with 11 stripes; all together under 1 ms, the most careful under 30."""

SETS = {
    "fastest": ("extractor=log-parabola", "coder=ordered", "classifier=arc-curvature"),
    "careful": ("extractor=maximum-likelihood", "coder=planes"),
    "recipe": (),
}
"""Stages of each set, with their default options."""
_BEST = "recipes/herring_roe/with_outline.yaml"


def main() -> None:
    """Print the parts of a frame for each set."""
    parser = parser_of(__doc__)
    parser.add_argument("--recipe", default="recipes/herring_roe")
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    parser.add_argument("--table", action="store_true", help="one line for each shipped chain")
    parser.add_argument("--patterns", action="store_true", help="one line for each recipe of a pattern")
    given = parser.parse_args()
    if given.table or given.patterns:
        _print_table(CHAINS if given.table else PATTERN_CHAINS, given.repeats)
        return
    for name in given.sets.split(","):
        _print_parts(name, given.recipe, given.repeats, [*_sets_of(name), *given.overrides])


CHAINS = (
    ("`herring_roe`, fastest stages", "recipes/herring_roe", "fastest", 0, "grade, volume, weight"),
    ("`herring_roe`", "recipes/herring_roe", "recipe", 0, "the same by the paper's algorithms"),
    ("`with_outline`, `--draws 0`", _BEST, "recipe", 0, "better ones; the models' uncertainty"),
    ("`with_outline`", _BEST, "recipe", None, "every number with its uncertainty"),
)
"""Name, recipe, set of stages, draws, what is stated."""
PATTERN_CHAINS = tuple(
    (f"`{name}`", f"recipes/{name}", "recipe", None, "volume with its uncertainty")
    for name in ("potato_dots", "potato_circles", "potato_two_colours", "potato_grid")
)


def _print_table(chains: Sequence[tuple[str, str, str, int | None, str]], repeats: int) -> None:
    rows, first = [], 0.0
    for name, path, stages, draws, states in chains:
        recipe = Recipe.load(path, sets=_sets_of(stages))
        source, pipeline = recipe.source.make(), Pipeline(recipe, draws=draws)
        acquisitions = [source.read(one) for one in source.references(recipe.source_path)[:4]]
        taken = []
        for turn in range(repeats + 1):
            for acquisition in acquisitions:
                begin = time.process_time()
                measurements_of(pipeline.trace(acquisition), recipe, {})
                taken += [time.process_time() - begin] if turn else []  # the first loads the kernels
        median = statistics.median(taken)
        first = first or median
        rows.append([name, states, f"{1e3 * median:.3g}", f"{median / first:.3g}"])
    print(table(["recipe", "states", "ms a product", "times the first"], rows), end="")


def _sets_of(name: str) -> list[str]:
    return [f"stages.{stage}" for stage in SETS[name]]


def _print_parts(name: str, path: str, repeats: int, sets: list[str]) -> None:
    recipe = Recipe.load(path, sets=sets)
    source, pipeline = recipe.source.make(), Pipeline(recipe, draws=0)
    acquisitions = [source.read(reference) for reference in source.references(recipe.source_path)]
    for acquisition in acquisitions:
        measurements_of(pipeline.trace(acquisition), recipe, {})
    parts: dict[str, list[float]] = {}
    whole, yardstick, worked = [], [], []
    for _ in range(repeats):
        for acquisition in acquisitions:
            begin, cpu = time.perf_counter(), time.thread_time()
            trace = pipeline.trace(acquisition)
            measurements_of(trace, recipe, {})
            whole.append(time.perf_counter() - begin)
            worked.append(time.thread_time() - cpu)
            for stage, seconds in trace.seconds.items():
                parts.setdefault(stage, []).append(seconds)
            parts.setdefault("records", []).append(whole[-1] - sum(trace.seconds.values()))
            yardstick.append(_taken(lambda pixels=acquisition.frames[0].pixels: _blurred(pixels)))
    rows, columns = acquisitions[0].frames[0].size
    many = f"{len(acquisitions)} frames of {columns} × {rows}, {repeats} times each, ms"
    print(f"{name}: {', '.join(sets) or 'as it is'}; {many}")
    print(f"  {'':14} {'median':>8} {'quickest 5 %':>13} {'budget':>8}")
    sums = (("array to rows", whole), ("  processor", worked), ("yardstick", yardstick))
    for stage, seconds in (*parts.items(), *sums):
        quick = statistics.quantiles(seconds, n=20)[0]
        budget = BUDGET_MS.get(stage, 1.0 if stage == "array to rows" else None)
        wanted = f"{budget:8.2f}" if budget is not None and name == "fastest" else ""
        print(f"  {stage:14} {1e3 * statistics.median(seconds):8.3f} {1e3 * quick:13.3f} {wanted}")
    ratios = [one / other for one, other in zip(whole, yardstick, strict=True)]
    print(f"  a frame takes {statistics.median(ratios):.1f} times the yardstick")


def _blurred(pixels: object) -> None:
    cv2.dilate(cv2.GaussianBlur(pixels, (9, 1), 1.5), None)  # type: ignore[call-overload]


def _taken(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin
