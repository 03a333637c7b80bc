"""Time of the shape features and of the classifiers by rules, on the shipped skeins.

``python -m benchmarks shape [--repeats 200]``
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

from roemetry import Pipeline, Recipe
from roemetry.records import Product
from roemetry_paper.arc_curvature import ArcCurvature
from roemetry_shape.fuzzy_rules import FuzzyRules, FuzzyRulesOptions
from roemetry_shape.shape_limits import ShapeLimits, ShapeLimitsOptions

HOME = Path(__file__).parents[1] / "recipes" / "herring_roe"

CLASSIFIERS: dict[str, Any] = {
    "arc-curvature": ArcCurvature(),
    "shape-limits": ShapeLimits(
        ShapeLimitsOptions.model_validate(
            {"limits": [{"feature": "dent_depth_mm", "at_most": 1.0, "label": "dent"}]}
        )
    ),
    "fuzzy-rules": FuzzyRules(
        FuzzyRulesOptions.model_validate(
            {
                "terms": {"hollow": {"feature": "hollow_depth_mm", "points": [[0.5, 0.0], [2.0, 1.0]]}},
                "rules": [
                    {"when": ["hollow"], "label": "dent"},
                    {"when": ["not hollow"], "label": "good"},
                ],
            }
        )
    ),
}
"""The last two measure every shape feature."""


def main() -> None:
    """Print median and least time of each classifier."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200, help="of each product")
    given = parser.parse_args()
    products = shipped()
    print(f"{len(products)} products, {given.repeats} times each\n")
    print("| classifier | median, ms | least, ms |")
    print("|---|---|---|")
    for name, classifier in CLASSIFIERS.items():
        taken = times_ms(classifier, products, given.repeats)
        print(f"| `{name}` | {statistics.median(taken):.2f} | {min(taken):.2f} |")


def shipped() -> list[Product]:
    """Measure the shipped skeins as far as their points."""
    recipe = Recipe.load(HOME, sets=["stages.volume=", "stages.weigher=", "stages.classifier="])
    pipeline, source = Pipeline(recipe), recipe.source.make()
    traces = (pipeline.trace(source.read(one)) for one in source.references(recipe.source_path))
    return [found.product for trace in traces for found in trace.products]


def times_ms(classifier: Any, products: list[Product], repeats: int) -> list[float]:
    """Classify each product so many times; processor time of each call."""
    for product in products:
        classifier.classify(product)
    taken = []
    for _ in range(repeats):
        for product in products:
            begin = time.process_time_ns()
            classifier.classify(product)
            taken.append(1e-6 * (time.process_time_ns() - begin))
    return taken


if __name__ == "__main__":
    main()
