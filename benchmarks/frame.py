"""Time from an array to a measurement, on one core, after warm-up.

``python -m benchmarks frame [--recipe recipes/herring_roe] [--repeats 50]``
"""

from __future__ import annotations

import argparse
import statistics
import time

from roemetry import Pipeline, Recipe
from roemetry.measuring import measurements_of


def main() -> None:
    """Print the median time of each stage and of the whole."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recipe", default="recipes/herring_roe")
    parser.add_argument("--repeats", type=int, default=50)
    given = parser.parse_args()
    recipe = Recipe.load(given.recipe)
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    acquisitions = [source.read(reference) for reference in source.references(recipe.source_path)]
    for acquisition in acquisitions:
        measurements_of(pipeline.trace(acquisition), recipe, {})
    stages: dict[str, list[float]] = {}
    whole = []
    for _ in range(given.repeats):
        for acquisition in acquisitions:
            begin = time.perf_counter()
            trace = pipeline.trace(acquisition)
            measurements_of(trace, recipe, {})
            whole.append(time.perf_counter() - begin)
            for stage, seconds in trace.seconds.items():
                stages.setdefault(stage, []).append(seconds)
    rows, columns = acquisitions[0].frames[0].size
    print(f"{len(acquisitions)} frames of {columns} × {rows}, {given.repeats} times each; medians:")
    for stage, seconds in stages.items():
        print(f"  {stage:14} {1e3 * statistics.median(seconds):7.2f} ms")
    low, _, high = statistics.quantiles(whole, n=4)
    print(
        f"  {'array to rows':14} {1e3 * statistics.median(whole):7.2f} ms  "
        f"(quartiles {1e3 * low:.2f} – {1e3 * high:.2f})"
    )


if __name__ == "__main__":
    main()
