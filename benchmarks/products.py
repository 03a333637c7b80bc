"""A recipe on simulated products, held against their truth: labels, volume, weight, intervals, grades.

``python -m benchmarks products RECIPE … [--data FOLDER | --seed 170000 --count 60] [--set KEY=VALUE …]``

The products are those of the recipe's own images; with ``--data`` those of another data set; with ``--seed``
new ones, drawn from the whole population of the recipe's scene and kept in the temporary folder, some
seconds of one core each.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.command import parser_of
from benchmarks.grading.judges import SHOWN_MM
from benchmarks.tables import confusion, share, table
from benchmarks.traced import NAMED
from roemetry import Pipeline, Recipe
from roemetry.config.dataset import Dataset
from roemetry.config.scene import Scene
from roemetry.records import Estimate, ProductTruth
from roemetry.records.product import ProductTrace
from roemetry.run.simulate import simulate
from roemetry_files.dataset_source import DatasetSource
from roemetry_tools.compare.stripes import CodingScore, by_place, score_coding

HEAD = [
    "product", "made", "visible volume cm³", "stated std", "error", "true volume, error", "mass g (true)",
    "length mm (true)", "height mm (true)", "labels right, wrong", "class",
]  # fmt: skip
QUANTITIES = {"visible volume": "visible_mm3", "true volume": "true_mm3", "weight": "mass_g"}


@dataclass(frozen=True)
class Row:
    """One product: what was found of it, None where it was missed, beside what is true."""

    id: str
    one: ProductTrace | None
    truth: ProductTruth
    coding: CodingScore | None
    """Of its image; None for all but the image's first product."""

    def estimate(self, name: str) -> Estimate | None:
        """Give the estimate of a quantity; a visible volume stands for a true one that is not given."""
        of = None if self.one is None else self.one.weight if name == "mass_g" else self.one.volume
        found: Estimate | None = None if of is None else getattr(of, name)
        return self.estimate("visible_mm3") if found is None and name == "true_mm3" else found

    def off(self, name: str) -> float:
        """Relative error of a quantity; NaN where it was not measured or is not known."""
        found = self.estimate(name)
        return math.nan if found is None else found.value / (getattr(self.truth, name) or math.nan) - 1.0

    @property
    def visible_cm3(self) -> float:
        """Visible volume, cm³; NaN where it was not measured."""
        found = self.estimate("visible_mm3")
        return math.nan if found is None else 1e-3 * found.value

    @property
    def says(self) -> str:
        """Give the class that was decided on, or the grade."""
        said = None if self.one is None else self.one.decision or self.one.grade
        return "" if said is None else said.label

    def cells(self) -> list[str]:
        """Write a line of the table."""
        volume, mass = self.estimate("visible_mm3"), self.estimate("mass_g")
        features = self.one.grade.features if self.one and self.one.grade else {}
        figures, score = self.truth.figures, self.coding
        cells = [
            self.id, self.truth.defect, f"{self.visible_cm3:.2f}",
            f"{math.nan if volume is None else 1e-3 * volume.std:.2f}",
            f"{100 * self.off('visible_mm3'):+.2f} %", f"{100 * self.off('true_mm3'):+.2f} %",
            f"{math.nan if mass is None else mass.value:.1f} ({self.truth.mass_g:.1f})",
            f"{features.get('length_mm', math.nan):.1f} ({figures.get('length_mm', math.nan):.1f})",
            f"{_highest(self.one):.1f} ({figures.get('thickness_mm', math.nan):.1f})",
            "" if score is None else f"{score.right / max(score.visible, 1):.1%}, {score.wrong_points}",
            self.says,
        ]  # fmt: skip
        return [cell.replace("nan", "–") for cell in cells]


def main() -> None:
    """Print the tables of each recipe."""
    parser = parser_of(__doc__)
    parser.add_argument("recipes", nargs="+", type=Path, metavar="RECIPE")
    parser.add_argument("--data", type=Path, help="a data set of simulated products")
    parser.add_argument("--seed", type=int, help="of the first new product")
    parser.add_argument("--count", type=int, default=100, help="of new products")
    parser.add_argument("--jobs", type=int, default=1, help="processes that make them")
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    for path in given.recipes:
        recipe = Recipe.load(path, sets=given.sets)
        folder = given.data or recipe.source_path
        if given.seed is not None:
            folder = made(recipe.path.parent, given.seed, given.count, given.jobs)
        found = list(rows(recipe, folder))
        print(f"\n### {path}, {folder}\n")
        print(table(HEAD, [row.cells() for row in found]))
        print(labels(found))
        print(errors(found))
        print(grades(found))


def made(home: Path, seed: int, count: int, jobs: int = 1, *, draft: bool = False) -> Path:
    """Draw products from the whole population of a recipe's scene, or go on with that.

    Drafts take a fifth of the time.
    """
    family = Scene.load(home).simulator.options.model_dump(mode="json")["product"]["family"]
    drawn = "simulator.options.product=" + json.dumps({"family": family})
    scene = Scene.load(home, sets=[drawn, f"simulator.options.draft={json.dumps(draft)}"])
    name = f"roemetry-{family}-{seed}" + ("-draft" if draft else "")
    folder = Path(tempfile.gettempdir()) / name
    simulate(scene, folder, count=count, seed=seed, jobs=jobs, resume=True, calibration="none")
    return folder


def rows(recipe: Recipe, folder: Path) -> Iterator[Row]:
    """Measure the products of a folder, each beside its truth; one that was missed has a row too."""
    own = recipe.source.make() if folder == recipe.source_path else DatasetSource()
    home = folder if (folder / "dataset.yaml").is_file() else folder.parent
    data, pipeline = Dataset(home), Pipeline(recipe)
    truths = {item.id: data.truth(item) for item in data.items()}
    for reference in own.references(folder):
        trace, known = pipeline.trace(own.read(reference)), truths[reference.id]
        assert known.stripes is not None
        place: dict[int, int] = {}
        coding = CodingScore(visible=int(known.stripes.on_product.sum()))
        if trace.stripes is not None and trace.peaks is not None:
            coding = score_coding(trace.stripes, trace.peaks, known.stripes)
            place = {true: mine for mine, true in by_place(trace.stripes, known.stripes).items()}
        found = {one.product.number: one for one in trace.products}
        for number, truth in enumerate(known.products, start=1):
            one = found.get(place.get(number, 0))
            yield Row(f"{reference.id}#{number}", one, truth, coding if number == 1 else None)


def labels(found: Sequence[Row]) -> str:
    """Sum up the labels of the images' points."""
    whole = sum((row.coding for row in found if row.coding is not None), CodingScore())
    return (
        f"{whole.right / max(whole.visible, 1):.2%} of {whole.visible} visible product points right, "
        f"{whole.wrong_points} points wrong, longest wrong run {whole.longest_wrong_run} rows\n"
    )


def errors(found: Sequence[Row]) -> str:
    """Write errors in per cent of the truth, and how many 95 % intervals hold it."""
    lines = []
    for what, name in QUANTITIES.items():
        known = [row for row in found if math.isfinite(row.off(name))]
        if not known:
            continue
        off = np.array([row.off(name) for row in known])
        stated = [(estimate.interval, getattr(row.truth, name)) for row in known
                  if (estimate := row.estimate(name)) and math.isfinite(estimate.std)]  # fmt: skip
        held = sum(low <= truth <= high for (low, high), truth in stated)
        width = np.median([(high - low) / truth for (low, high), truth in stated]) if stated else math.nan
        spread = off.std(ddof=1) if off.size > 1 else math.nan
        lines.append([
            what, f"{off.size} of {len(found)}", f"{off.mean():+.2%}", f"{spread:.2%}",
            f"{np.abs(off).mean():.2%}", f"{np.quantile(np.abs(off), 0.95):.2%}", f"{np.abs(off).max():.2%}",
            f"{held} of {len(stated)}", f"{width:.2%}",
        ])  # fmt: skip
    head = ["what", "measured", "mean", "standard deviation", "mean absolute", "95 % point", "largest",
            "intervals with the truth", "median width"]  # fmt: skip
    return table(head, lines)


def grades(found: Sequence[Row]) -> str:
    """Write what each defect was called, and what the stated probabilities came to.

    "" unless some that are good were called so, and others are deformed.
    """
    graded = [(row.truth.defect, row.one.grade) for row in found if row.one and row.one.grade]
    called = Counter((defect, grade.label) for defect, grade in graded)
    order = sorted({label for _, label in called}, key=lambda label: (label != "good", label))
    text = confusion(called, order, "made", sorted(NAMED, key=lambda defect: (defect != "none", defect)))
    stated = [grade.probability for _, grade in graded if math.isfinite(grade.probability)]
    said = f"{np.mean(stated):.1%}" if stated else "not stated"
    right = sum(grade.label == NAMED.get(defect, defect) for defect, grade in graded)
    good = [grade.label == "good" for defect, grade in graded if defect == "none"]
    caught = [grade.label != "good" for defect, grade in graded if defect != "none"]
    shown = [row.one.grade.label != "good" for row in found if row.one and row.one.grade
             and row.truth.figures.get("defect_seen_mm", 0.0) >= SHOWN_MM]  # fmt: skip
    if not any(good) or not caught:
        return ""
    return (
        f"{text}\nnamed right {share(right, len(graded))} (mean probability stated {said}); healthy kept "
        f"{share(sum(good), len(good))}, deformed not called good {share(sum(caught), len(caught))} "
        f"(of those that a stripe shows by {SHOWN_MM:g} mm {share(sum(shown), len(shown))}), "
        f"balanced accuracy {0.5 * (np.mean(good) + np.mean(caught)):.3f}"
    )


def _highest(one: ProductTrace | None) -> float:
    """Give the largest height of a product's points, mm; NaN without any."""
    if one is None:
        return math.nan
    profiles = one.product.profiles
    return float(np.nanmax(profiles.xyz_mm[..., 2][profiles.product == one.product.number]))
