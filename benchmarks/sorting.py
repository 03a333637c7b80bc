"""Wrong sorting near a limit, under any options: products, and limits drawn about what is true of them.

``python -m benchmarks sorting [--cases 1000] [--seed 1] [--fresh 100] [--lines potato …] [--sets linear …]``

The products are the shipped ones; with ``--fresh`` as many new ones of each line, drawn with the seed as
drafts from the whole population of its scene and kept in the temporary folder, a second of one core each.
Each product is measured once under each set of options. Then limits are drawn, evenly within three standard
uncertainties to either side of its true value, and a grade table of two classes decides. Wrong is a product
that is put into the class it is not of. The guard band of 1.65 standard uncertainties promises that of
products right at the limit 5 % are; nearer ones are the worst, so of all cases no more may be.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.command import parser_of
from benchmarks.products import made
from benchmarks.tables import table
from roemetry.config.dataset import DESCRIPTION, Dataset
from roemetry.config.recipe import Recipe
from roemetry.errors import RoemetryError
from roemetry.records import Estimate, ProductTrace, ProductTruth
from roemetry.run.pipeline import Pipeline
from roemetry_files.dataset_source import DatasetSource
from roemetry_shape.grade_table import GradeTable, GradeTableOptions

RECIPES = Path(__file__).resolve().parents[1] / "recipes"
LINES = {"herring_roe": "with_outline.yaml", "potato": "recipe.yaml", "bread_roll": "recipe.yaml"}
"""Lines with one product to a frame, and the recipe taken."""
DENSITY = "stages.weigher={use: density, options: {density_g_per_cm3: 1.06, density_std_g_per_cm3: 0.03}}"
SETS: dict[str, tuple[str, ...]] = {
    "linear": ("uncertainty=linear",),
    "none": ("uncertainty=none",),
    "draws 2": ("draws=2",),
    "draws 5": ("draws=5",),
    "draws 20": ("draws=20",),
    "slices": ("uncertainty=linear", "stages.volume=slice-pchip"),
    "slices, none": ("uncertainty=none", "stages.volume=slice-pchip"),
    "paper's volume": ("uncertainty=linear", "stages.volume=zero-order-hold"),
    "noise unknown": ("uncertainty=linear", "stages.extractor=centre-of-gravity", "source.sensor=null"),
    "density": ("uncertainty=linear", DENSITY),
    "density, none": ("uncertainty=none", DENSITY),
}
QUANTITIES = {"visible_volume_cm3": "visible_mm3", "true_volume_cm3": "true_mm3", "weight_g": "mass_g"}
"""Names in a grade table, and those of the truth."""
FEATURES = ("length_mm", "width_mm")
"""Of a classifier, by the names that the truth's figures have as well."""


class Case(NamedTuple):
    """A measured product of a line and its true value of one quantity, in the unit of the name."""

    line: str
    trace: ProductTrace
    quantity: str
    true: float
    std: float = math.nan
    """Standard uncertainty that the grade table states; NaN for none."""


def main() -> None:
    """Print a line for each set of options."""
    parser = parser_of(__doc__)
    parser.add_argument("--cases", type=int, default=1000, help="for each set of options")
    parser.add_argument("--seed", type=int, default=1, help="of the limits, and of new products")
    parser.add_argument("--fresh", type=int, metavar="COUNT", help="new products of each line")
    parser.add_argument("--lines", nargs="+", choices=list(LINES), default=list(LINES))
    parser.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    given = parser.parse_args()
    rows = []
    data = {line: data_of(line, given.seed, given.fresh) for line in given.lines}
    for name in given.sets:
        cases = [case for line in given.lines for case in measured(line, SETS[name], data[line])]
        products = len({id(case.trace) for case in cases})
        sizes = [case for case in cases if case.quantity in FEATURES]
        for what, some in (
            ("volume, weight", [case for case in cases if case.quantity not in FEATURES]),
            ("length, width", sizes),
            ("the same, `std` in the table", told(sizes)),
        ):
            if not some:
                continue
            decided, wrong, count = sorted_at_limits(some, given.cases, given.seed)
            share = f"{100 * wrong / count:.1f}"
            rows.append([name, what, *map(str, (products, count, decided, wrong)), share])
    heads = ["options", "limits on", "products", "cases", "decided", "wrong", "wrong, % of cases"]
    print(table(heads, rows), end="")


def data_of(line: str, seed: int, fresh: int | None) -> Path:
    """Give the folder of a line's shipped products, or of so many new ones."""
    folder = RECIPES / line
    if fresh is not None:
        return made(folder, seed, fresh, draft=True)
    return folder if (folder / DESCRIPTION).is_file() else folder / "data"


def measured(line: str, sets: Sequence[str], folder: Path) -> Iterator[Case]:
    """Measure the products of a folder; none where the line's recipe has no such stage."""
    truths = {item.id: item.products for item in Dataset(folder).items()}
    recipe = Recipe.load(RECIPES / line / LINES[line], sets=[*sets, "stages.grader="])
    pipeline, source = Pipeline(recipe), DatasetSource()
    for reference in source.references(folder):
        truth = truths.get(reference.id, ())
        try:
            products = pipeline.trace(source.read(reference)).products
        except RoemetryError:
            continue
        if len(products) == len(truth) == 1:
            yield from _cases(line, products[0], truth[0])


def _cases(line: str, trace: ProductTrace, truth: ProductTruth) -> Iterator[Case]:
    for quantity, name in QUANTITIES.items():
        if estimate_of(quantity, trace) is not None:
            yield Case(line, trace, quantity, getattr(truth, name) / (1000.0 if name != "mass_g" else 1.0))
    for name in FEATURES:
        if estimate_of(name, trace) is not None and name in truth.figures:
            yield Case(line, trace, name, truth.figures[name])


def estimate_of(quantity: str, trace: ProductTrace) -> Estimate | None:
    """Give what was measured of a quantity."""
    volume, weight, grade = trace.volume, trace.weight, trace.grade
    if quantity in FEATURES:
        if grade is None or quantity not in grade.features:
            return None
        return Estimate(grade.features[quantity], grade.features_std.get(quantity, math.nan))
    if quantity == "weight_g":
        return None if weight is None or math.isnan(weight.mass_g.value) else weight.mass_g
    if volume is None:
        return None
    return volume.true_mm3 if quantity == "true_volume_cm3" else volume.visible_mm3


def told(cases: Sequence[Case]) -> list[Case]:
    """State of each quantity in the table what somebody finds who measures the line's products by hand."""
    off: dict[tuple[str, str], list[float]] = {}
    for case in cases:
        found = estimate_of(case.quantity, case.trace)
        assert found is not None
        off.setdefault((case.line, case.quantity), []).append(found.value - case.true)
    rms = {of: math.sqrt(float(np.mean(np.square(some)))) for of, some in off.items()}
    return [case._replace(std=rms[case.line, case.quantity]) for case in cases]


def sorted_at_limits(cases: Sequence[Case], count: int, seed: int) -> tuple[int, int, int]:
    """Sort cases at drawn limits; gives how many were decided, how many of them wrong, and how many cases."""
    rng = np.random.default_rng([seed, 83])
    each = math.ceil(count / len(cases))
    decided = wrong = 0
    for case in cases:
        found = estimate_of(case.quantity, case.trace)
        assert found is not None
        parts = (found.std, math.hypot(*found.budget.values()), case.std)
        part = max(one for one in parts if not math.isnan(one))
        scale = max(part / (1000.0 if case.quantity.endswith("_cm3") else 1.0), 0.01 * case.true)
        for limit in case.true + scale * rng.uniform(-3.0, 3.0, each):
            label = label_at(case, limit)
            decided += label != "undecided"
            wrong += label == ("light" if case.true >= limit else "heavy")
    return decided, wrong, each * len(cases)


def label_at(case: Case, limit: float) -> str:
    """Let a grade table of two classes decide about a product."""
    classes = [{"label": "heavy", "limits": {case.quantity: {"at_least": limit}}}, {"label": "light"}]
    std = {} if math.isnan(case.std) else {case.quantity: case.std}
    grader = GradeTable(GradeTableOptions.model_validate({"classes": classes, "std": std}))
    trace = case.trace
    return grader.decide(trace.product, trace.volume, trace.weight, trace.grade).label
