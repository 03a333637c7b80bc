"""The shipped product lines on their own simulated products: the tables of their README pages.

``python -m benchmarks product_lines [LINE …] [--data FOLDER] [--set KEY=VALUE]``

With ``--data`` the line's recipe measures another set of simulated products; ``--set`` changes the recipe.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roemetry import Pipeline, Recipe
from roemetry.config.dataset import Dataset
from roemetry.records import ProductTruth
from roemetry.records.product import ProductTrace
from roemetry_tools.compare.stripes import by_place

HOME = Path(__file__).resolve().parents[1] / "recipes"
LINES = ("potato", "fish_fillet", "bread_roll", "egg")


@dataclass(frozen=True)
class Row:
    """One product: what was found beside what is true; NaN where nothing was."""

    id: str
    made: str
    visible_cm3: float
    visible_std_cm3: float
    visible_true_cm3: float
    true_cm3: float
    true_true_cm3: float
    mass_g: float
    mass_true_g: float
    length_mm: float
    length_true_mm: float
    height_mm: float
    height_true_mm: float
    says: str

    @property
    def visible_off(self) -> float:
        """Relative error of the visible volume."""
        return self.visible_cm3 / self.visible_true_cm3 - 1.0

    @property
    def true_off(self) -> float:
        """Relative error of the true volume."""
        return self.true_cm3 / self.true_true_cm3 - 1.0

    def markdown(self) -> str:
        """One line of the table."""
        cells = [
            self.id,
            self.made,
            f"{self.visible_cm3:.2f}",
            f"{self.visible_std_cm3:.2f}",
            f"{100 * self.visible_off:+.2f} %",
            f"{100 * self.true_off:+.2f} %",
            f"{self.mass_g:.1f} ({self.mass_true_g:.1f})",
            f"{self.length_mm:.1f} ({self.length_true_mm:.1f})",
            f"{self.height_mm:.1f} ({self.height_true_mm:.1f})",
            self.says,
        ]
        return f"| {' | '.join(cell.replace('nan', '–') for cell in cells)} |"


HEAD = (
    "| product | made | visible volume cm³ | stated std | error | true volume, error | mass g (true) "
    "| length mm (true) | height mm (true) | class |\n|---|---|---|---|---|---|---|---|---|---|"
)


def rows(line: str, folder: Path | None = None, sets: Sequence[str] = ()) -> Iterator[Row]:
    """Measure a line's products, or a folder's, each beside its truth; one that was missed has a row too."""
    recipe = Recipe.load(HOME / line, sets=sets)
    source, pipeline = recipe.source.make(), Pipeline(recipe, debug=True)
    folder = folder or recipe.source_path
    data = Dataset(folder)
    truths = {item.id: data.truth(item) for item in data.items()}
    for reference in source.references(folder):
        trace, known = pipeline.trace(source.read(reference)), truths[reference.id]
        assert trace.stripes is not None and known.stripes is not None
        place = {true: mine for mine, true in by_place(trace.stripes, known.stripes).items()}
        found = {one.product.number: one for one in trace.products}
        for number, truth in enumerate(known.products, start=1):
            yield row_of(f"{reference.id}#{number}", found.get(place.get(number, 0)), truth)


def row_of(name: str, one: ProductTrace | None, truth: ProductTruth) -> Row:
    """Put one product beside its truth."""
    volume, weight = (None, None) if one is None else (one.volume, one.weight)
    features = {} if one is None or one.grade is None else one.grade.features
    says = "" if one is None else one.decision.label if one.decision else one.grade.label if one.grade else ""
    missing = math.nan
    return Row(
        id=name,
        made=truth.defect,
        visible_cm3=missing if volume is None else 1e-3 * volume.visible_mm3.value,
        visible_std_cm3=missing if volume is None else 1e-3 * volume.visible_mm3.std,
        visible_true_cm3=1e-3 * (truth.visible_mm3 or missing),
        true_cm3=missing if volume is None or volume.true_mm3 is None else 1e-3 * volume.true_mm3.value,
        true_true_cm3=1e-3 * (truth.true_mm3 or missing),
        mass_g=missing if weight is None else weight.mass_g.value,
        mass_true_g=missing if truth.mass_g is None else truth.mass_g,
        length_mm=features.get("length_mm", missing),
        length_true_mm=truth.figures.get("length_mm", missing),
        height_mm=missing if one is None else highest(one),
        height_true_mm=truth.figures.get("thickness_mm", missing),
        says=says,
    )


def highest(one: ProductTrace) -> float:
    """Give the largest height of a product's points, mm."""
    profiles = one.product.profiles
    return float(np.nanmax(profiles.xyz_mm[..., 2][profiles.product == one.product.number]))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("lines", nargs="*", default=LINES, metavar="LINE")
    parser.add_argument("--data", type=Path, help="a set of simulated products, instead of the line's own")
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="KEY=VALUE")
    asked = parser.parse_args()
    for line in asked.lines:
        print(f"\n### {line}\n\n{HEAD}")
        found = list(rows(line, asked.data, asked.sets))
        for row in found:
            print(row.markdown())
        for what in ("visible_off", "true_off"):
            off = [getattr(row, what) for row in found if not math.isnan(getattr(row, what))]
            if off:
                mean, spread, worst = np.mean(off), np.std(off, ddof=1), max(map(abs, off))
                print(
                    f"\n{what}: mean {100 * mean:+.2f} %, standard deviation {100 * spread:.2f} %, "
                    f"largest {100 * worst:.2f} %, of {len(off)}"
                )


if __name__ == "__main__":
    main()
