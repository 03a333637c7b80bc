"""The best chain that is shipped, on skeins nobody had seen: grade, volume, weight, and what intervals hold.

``python -m benchmarks best_chain [--data FOLDER] [--seed 150000] [--count 100] [--draws N] [--jobs 1]``

The skeins are drawn from the whole population on the recipe's own rig, in laser light and in plain light.
They are a data set, which ``--data`` names; without it one is made, some 6 s of one core a skein, and kept in
the temporary folder. Measuring goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.traced.tables import NAMED
from roemetry import Measurement, Recipe, run_recipe
from roemetry.config.dataset import Dataset
from roemetry.config.scene import Scene
from roemetry.records import Estimate, ProductTruth
from roemetry.run.record import RECORD, read_record
from roemetry.run.simulate import simulate

HOME = Path(__file__).resolve().parents[1] / "recipes" / "herring_roe"
POPULATION = "simulator.options.product={family: herring-roe}"


def main() -> None:
    """Print a table of errors and intervals, and one of grades."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="a data set instead of one of the recipe's scene")
    parser.add_argument("--seed", type=int, default=150000, help="of the first skein")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--draws", type=int, help="Monte Carlo draws; left out: as the recipe has it")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--out", type=Path, help="where the run's record is kept; beside the data if left out"
    )
    given = parser.parse_args()
    folder = given.data or made(given.seed, given.count, given.jobs)
    draws = [] if given.draws is None else [f"draws={given.draws}"]
    recipe = Recipe.load(
        HOME / "with_outline.yaml",
        sets=[f"source.path={folder.absolute() / 'images'}", *draws, "sinks=[]"],
    )
    out = given.out or folder.with_name(f"{folder.name}-measured")
    run_recipe(recipe, out, jobs=given.jobs, resume=(out / RECORD).exists())
    data = Dataset(folder)
    truths = {item.id: data.truth(item).products[0] for item in data.items()}
    found = [row for row in read_record(out) if row.acquisition in truths]
    measured = [row for row in found if row.volume is not None]
    refused = [row.id for row in found if row.volume is None]
    print(f"{len(truths)} skeins, {len(found)} products; without a volume: {', '.join(refused) or 'none'}\n")
    print(table(measured, truths))
    print()
    print(grades(measured, truths))


def made(seed: int, count: int, jobs: int) -> Path:
    """Make the data set, or go on with it."""
    folder = Path(tempfile.gettempdir()) / f"roemetry-skeins-in-both-lights-{seed}"
    scene = Scene.load(HOME / "scene.yaml", sets=[POPULATION])
    simulate(scene, folder, count=count, seed=seed, jobs=jobs, resume=True, calibration="none")
    return folder


def table(measured: Sequence[Measurement], truths: Mapping[str, ProductTruth]) -> str:
    """Errors in per cent of the truth, and how many 95 % intervals hold it."""
    lines = [
        "| what | mean | mean absolute | 95 % point | largest | intervals with the truth | median width |",
        "|---|---|---|---|---|---|---|",
    ]
    for what, name in (("visible volume", "visible_mm3"), ("true volume", "true_mm3"), ("weight", "mass_g")):
        pairs = [(estimate(row, name), getattr(truths[row.acquisition], name)) for row in measured]
        known = [(one, truth) for one, truth in pairs if one is not None and truth is not None]
        off = np.array([one.value / truth - 1.0 for one, truth in known])
        stated = [(one.interval, truth) for one, truth in known if one.interval is not None]
        held = sum(low <= truth <= high for (low, high), truth in stated)
        width = np.median([(high - low) / truth for (low, high), truth in stated]) if stated else np.nan
        lines.append(
            f"| {what} | {off.mean():+.2%} | {np.abs(off).mean():.2%} | {np.quantile(np.abs(off), 0.95):.2%} "
            f"| {np.abs(off).max():.2%} | {held} of {len(stated)} | {width:.2%} |"
        )
    return "\n".join(lines)


def estimate(row: Measurement, name: str) -> Estimate | None:
    """Give a row's volume or weight."""
    if name == "mass_g":
        return None if row.weight is None else row.weight.mass_g
    assert row.volume is not None
    found: Estimate | None = getattr(row.volume, name)
    return found


def grades(measured: Sequence[Measurement], truths: Mapping[str, ProductTruth]) -> str:
    """What each defect was called, and what the stated probabilities came to."""
    graded = [(truths[row.acquisition].defect, row.grade) for row in measured if row.grade is not None]
    called = Counter((made, grade.label) for made, grade in graded)
    labels = sorted({label for _, label in called}, key=lambda label: (label != "good", label))
    lines = ["| made | n | " + " | ".join(labels) + " |", "|---|---|" + "---|" * len(labels)]
    for made_as in sorted({made for made, _ in called}, key=lambda made: (made != "none", made)):
        row = [called[made_as, label] for label in labels]
        lines.append(f"| {made_as} | {sum(row)} | " + " | ".join(map(str, row)) + " |")
    right = [grade.label == NAMED[made] for made, grade in graded]
    stated = [grade.probability for _, grade in graded if math.isfinite(grade.probability)]
    said = f"{np.mean(stated):.1%}" if stated else "not stated"
    deformed = [(made != "none", grade.label != "good") for made, grade in graded]
    kept = np.mean([not bad for is_bad, bad in deformed if not is_bad])
    caught = np.mean([bad for is_bad, bad in deformed if is_bad])
    lines.append(
        f"\nnamed right {np.mean(right):.1%} (mean probability stated {said}); healthy kept {kept:.1%}, "
        f"deformed caught {caught:.1%}, balanced accuracy {0.5 * (kept + caught):.3f}"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
