"""The shipped recipe on the shipped skeins, one by one, as a Markdown table.

``python -m benchmarks shipped_skeins``
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.herring_roe import BEST_OPTIONS, score
from roemetry import Pipeline, Recipe
from roemetry.config.dataset import Dataset
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions

FOLDER = Path("recipes/herring_roe")


def main() -> None:
    """Print the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    recipe = Recipe.load(FOLDER)
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    data = Dataset(FOLDER)
    truths = {item.id: data.truth(item) for item in data.items()}
    print(
        "| skein | made | points right | wrong | grade, paper's rule | grade, best options | volume cm³ ",
        end="",
    )
    print("| of visible | of true | weight g | true g |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    visible, right = 0, 0
    for reference in source.references(recipe.source_path):
        trace = pipeline.trace(source.read(reference))
        stripes, (known,) = truths[reference.id].stripes, truths[reference.id].products
        one = trace.products[0]
        if trace.stripes is None or one.volume is None or one.grade is None or one.weight is None:
            raise SystemExit(f"{reference.id} was not measured: {trace.absent} {one.absent}")
        assert stripes is not None
        found = score(trace.stripes, stripes)
        visible, right = visible + found.visible, right + found.right
        value = one.volume.visible_mm3.value
        kind = known.label if known.label == "good" else known.defect
        print(
            f"| {reference.id} | {kind} | {found.right / found.visible:.1%} | {found.wrong} "
            f"| {one.grade.label} | {best.classify(one.product).label} | {value / 1000:.2f} "
            f"| {100 * (value / known.visible_mm3 - 1):+.1f} % | {100 * (value / known.true_mm3 - 1):+.1f} % "
            f"| {one.weight.mass_g.value:.1f} | {known.mass_g:.1f} |"
        )
    print(f"\n{right / visible:.2%} of {visible} visible product points right")


if __name__ == "__main__":
    main()
