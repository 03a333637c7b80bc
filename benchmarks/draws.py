"""Time of a frame with Monte Carlo draws over the time of the same frame without.

``python -m benchmarks draws [--draws 200] [--repeats 9]``: the shipped skeins' first image, labels frozen.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

from roemetry.config.recipe import Recipe
from roemetry.records import Acquisition
from roemetry.run.pipeline import Pipeline

RECIPE = Path(__file__).parents[1] / "recipes" / "herring_roe" / "with_outline.yaml"
CHAINS = {
    "slice-pchip": ["stages.volume=slice-pchip"],
    "slice-pchip, classified": ["stages.volume=slice-pchip", "stages.classifier=arc-curvature"],
    "outline-surface": [],
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=9)
    given = parser.parse_args()
    print(f"| volume | frame | with {given.draws} draws: least | median | over the frame |")
    print("|---|---|---|---|---|")
    for name, sets in CHAINS.items():
        alone = seconds(sets, 0, given.repeats)
        drawn = seconds(sets, given.draws, given.repeats)
        middle, base = statistics.median(drawn), statistics.median(alone)
        print(
            f"| {name} | {1e3 * base:.1f} ms | {1e3 * (min(drawn) - base):.0f} ms "
            f"| {1e3 * (middle - base):.0f} ms | {(middle - base) / base:.0f} |"
        )


def seconds(sets: list[str], draws: int, repeats: int) -> list[float]:
    """Processor time of each repeat, s: that of this thread, for those of the linear algebra wait busily."""
    classifier = [] if any("classifier" in key for key in sets) else ["stages.classifier=null"]
    recipe = Recipe.load(RECIPE, sets=[*sets, *classifier])
    source = recipe.source.make()
    acquisition: Acquisition = source.read(source.references(recipe.source_path)[0])
    pipeline = Pipeline(recipe, draws=draws)
    pipeline.trace(acquisition)  # kernels compile
    took = []
    for _ in range(repeats):
        begin = time.thread_time()
        pipeline.trace(acquisition)
        took.append(time.thread_time() - begin)
    return took


if __name__ == "__main__":
    main()
