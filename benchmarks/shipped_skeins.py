"""The shipped recipe on the shipped skeins, one by one, as a Markdown table.

``python -m benchmarks shipped_skeins``
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from benchmarks.herring_roe import BEST_OPTIONS, Sample, score
from roemetry import Pipeline, Recipe
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions

FOLDER = Path("recipes/herring_roe")


def main() -> None:
    """Print the table."""
    recipe = Recipe.load(FOLDER)
    source, pipeline = recipe.source.make(), Pipeline(recipe)
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    with (FOLDER / "truth.csv").open(encoding="utf-8") as file:
        truth = list(csv.DictReader(file))
    with np.load(FOLDER / "truth_stripes.npz") as kept:
        x_px, on_product = kept["x_px"].astype(float), kept["on_product"]
    print(
        "| skein | made | points right | wrong | grade, paper's rule | grade, best options | volume cm³ ",
        end="",
    )
    print("| of visible | of true | weight g | true g |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    visible, right = 0, 0
    for index, reference in enumerate(source.references(recipe.source_path)):
        row = truth[index]
        trace = pipeline.trace(source.read(reference))
        product = trace.products[0]
        if trace.stripes is None or product.volume is None or product.grade is None or product.weight is None:
            raise SystemExit(f"{reference.id} was not measured: {trace.absent} {product.absent}")
        volumes = float(row["visible_volume_mm3"]), float(row["true_volume_mm3"])
        image = np.empty(0)
        sample = Sample(index, row["defect"], image, x_px[index], on_product[index], *volumes)
        found = score(trace.stripes, sample)
        visible, right = visible + found.visible, right + found.right
        value = product.volume.visible_mm3.value
        made = row["class"] if row["class"] == "good" else row["defect"]
        print(
            f"| {reference.id} | {made} | {found.right / found.visible:.1%} | {found.wrong} "
            f"| {product.grade.label} | {best.classify(product.product).label} | {value / 1000:.2f} "
            f"| {100 * (value / volumes[0] - 1):+.1f} % | {100 * (value / volumes[1] - 1):+.1f} % "
            f"| {product.weight.mass_g.value:.1f} | {float(row['weight_g']):.1f} |"
        )
    print(f"\n{right / visible:.2%} of {visible} visible product points right")


if __name__ == "__main__":
    main()
