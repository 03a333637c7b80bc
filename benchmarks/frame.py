"""Time from an array to a measurement, part by part against its budget, and over worker processes.

``python -m benchmarks frame [--recipe recipes/herring_roe] [--repeats 50] [--sets fastest,careful,recipe]``
``python -m benchmarks frame --jobs [--frames 2000]``

One core, after warm-up, without files and without uncertainty. Milliseconds move with the machine and its
load: the 5 % quickest frames are the least disturbed, and OpenCV's blur and dilation of the same image stand
beside them as a yardstick. What other programs take away is in no processor time.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2

from roemetry import Pipeline, Recipe
from roemetry.run.batch import run_recipe
from roemetry.run.rows import measurements_of
from roemetry.stages.registry import discover

BUDGET_MS = {
    "extractor": 0.35,
    "coder": 0.20,
    "triangulator": 0.15,
    "volume": 0.08,
    "classifier": 0.08,
    "records": 0.10,
}
"""Of the fastest set at 640 × 480 with 11 stripes; all together under 1 ms, the most careful under 30."""

WANTED = {
    "fastest": {
        "extractor": ("log-parabola",),
        "coder": ("ordered", "window-tracking"),
        "classifier": ("arc-curvature",),
    },
    "careful": {
        "extractor": ("maximum-likelihood", "centre-of-gravity", "dominant-peak"),
        "coder": ("planes", "window-tracking"),
    },
    "recipe": {},
}
"""Stages of each set: the first of these that is there, with its default options."""


def main() -> None:
    """Print the parts of a frame for each set, or the gain of a second process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--recipe", default="recipes/herring_roe")
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--sets", default=",".join(WANTED))
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    parser.add_argument("--jobs", action="store_true", help="one process against two")
    parser.add_argument("--frames", type=int, default=2000, help="for --jobs")
    given = parser.parse_args()
    if given.jobs:
        _print_jobs(given.recipe, given.frames, given.overrides)
        return
    for name in given.sets.split(","):
        _print_parts(name, given.recipe, given.repeats, [*_sets_of(name), *given.overrides])


def _sets_of(name: str) -> list[str]:
    registry = discover()
    chosen = []
    for kind, wanted in WANTED[name].items():
        there = {stage.entry.name for stage in registry.of_kind(kind)}
        chosen.append(f"stages.{kind}={next(stage for stage in wanted if stage in there)}")
    return chosen


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
    print(
        f"{name}: {', '.join(sets) or 'as it is'}; {len(acquisitions)} frames of {columns} × {rows}, ", end=""
    )
    print(f"{repeats} times each, ms")
    print(f"  {'':14} {'median':>8} {'quickest 5 %':>13} {'budget':>8}")
    sums = (("array to rows", whole), ("  processor", worked), ("yardstick", yardstick))
    for stage, seconds in (*parts.items(), *sums):
        quick = statistics.quantiles(seconds, n=20)[0]
        budget = BUDGET_MS.get(stage, 1.0 if stage == "array to rows" else None)
        wanted = f"{budget:8.2f}" if budget is not None and name == "fastest" else ""
        print(f"  {stage:14} {1e3 * statistics.median(seconds):8.3f} {1e3 * quick:13.3f} {wanted}")
    ratios = [one / other for one, other in zip(whole, yardstick, strict=True)]
    print(f"  a frame takes {statistics.median(ratios):.1f} times the yardstick")


def _print_jobs(path: str, frames: int, sets: list[str]) -> None:
    """Run a recipe over copies of its images by one process and by two, over few and over many of them.

    What the many take more than the few is the work itself; the start of the processes is in both.
    """
    few = frames // 4
    walls: dict[tuple[int, int], list[float]] = {}
    cpus: dict[tuple[int, int], list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        recipes = {many: _copied(path, many, Path(folder) / f"{many}", sets) for many in (few, frames)}
        for turn in range(3):
            for many, recipe in recipes.items():
                for jobs in (1, 2):
                    out = Path(folder) / f"out-{turn}-{many}-{jobs}"
                    before = _cpu_s()
                    wall = _taken(lambda r=recipe, o=out, j=jobs: run_recipe(r, o, jobs=j))
                    for child in multiprocessing.active_children():
                        child.join()
                    walls.setdefault((jobs, many), []).append(wall)
                    cpus.setdefault((jobs, many), []).append(_cpu_s() - before)
    wall_s = {key: statistics.median(found) for key, found in walls.items()}
    cpu_s = {key: statistics.median(found) for key, found in cpus.items()}
    for jobs in (1, 2):
        more = wall_s[jobs, frames] - wall_s[jobs, few]
        cpu = cpu_s[jobs, frames] - cpu_s[jobs, few]
        start = cpu_s[jobs, few] - cpu * few / (frames - few)
        print(f"{jobs} process(es): {(frames - few) / more:.0f} frames a second, ", end="")
        print(f"{1e3 * cpu / (frames - few):.2f} ms of processor a frame, {start:.1f} s for the start")
    gain = (wall_s[1, frames] - wall_s[1, few]) / (wall_s[2, frames] - wall_s[2, few])
    paid = (cpu_s[2, frames] - cpu_s[2, few]) / (cpu_s[1, frames] - cpu_s[1, few])
    print(f"two are {gain:.2f} times as fast as one, beside their start; a frame takes {paid:.2f} times the")
    print(f"processor time, so that two cores with nothing else to do give {2.0 / paid:.2f} times the speed")


def _copied(path: str, frames: int, images: Path, sets: list[str]) -> Recipe:
    """Give the recipe on a folder of so many links to its images."""
    there = sorted(image for image in Recipe.load(path).source_path.iterdir() if image.suffix == ".png")
    images.mkdir()
    for number in range(frames):
        (images / f"{number:06d}.png").symlink_to(there[number % len(there)].resolve())
    return Recipe.load(path, sets=[*sets, f"source.path={images}", "sinks=[]"])


def _cpu_s() -> float:
    """Processor time of this process and of its ended children, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _blurred(pixels: object) -> None:
    cv2.dilate(cv2.GaussianBlur(pixels, (9, 1), 1.5), None)  # type: ignore[call-overload]


def _taken(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
