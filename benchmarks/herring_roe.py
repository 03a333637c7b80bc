"""Coding, grading and volume of the shipped recipe on skeins it was not made with.

``python -m benchmarks herring_roe [--data FOLDER] [--seed 9000] [--count 100] [--set KEY=VALUE …]``

The skeins are a data set, which ``--data`` names; without it one is made from the recipe's scene, some 3 s of
one core a skein, and kept in the temporary folder. Wrong means: the nearest true stripe centre within 3 px
belongs to another stripe.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roemetry import Pipeline, Recipe
from roemetry.config.dataset import Dataset
from roemetry.config.scene import Scene
from roemetry.records import StripeMap, StripeTruth, Trace
from roemetry.run.simulate import simulate
from roemetry_files.dataset_source import DatasetSource
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions

BEST_OPTIONS = {"smoothing_rows": 31, "radius_max_px": 160.0, "delta_samples": 10}
"""Chosen on skeins of other seeds: see docs/explanation/herring-roe.md."""

SETS = (
    "simulator.options.product={family: herring-roe}",
    "simulator.options.light.images=[laser]",
)
"""What is changed in the recipe's scene: the whole population, without plain light."""


class Score(NamedTuple):
    """How one skein was coded."""

    visible: int
    right: int
    wrong: int
    longest_wrong_run: int


def main() -> None:
    """Print coding, confusion and volume error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recipe", default="recipes/herring_roe")
    parser.add_argument("--data", type=Path, help="a data set instead of one of the recipe's scene")
    parser.add_argument("--seed", type=int, default=9000, help="of the first skein")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--set", action="append", default=[], dest="sets")
    given = parser.parse_args()
    recipe = Recipe.load(given.recipe, sets=given.sets)
    folder = given.data or made(Path(given.recipe), given.seed, given.count)
    data, pipeline = Dataset(folder), Pipeline(recipe)
    source = DatasetSource()
    references = {reference.id: reference for reference in source.references(folder)}
    scores, errors, refused = [], [], []
    grades = {"recipe": Counter[tuple[str, str]](), "best options": Counter[tuple[str, str]]()}
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    for item in data.items():
        truth = data.truth(item)
        trace = pipeline.trace(source.read(references[item.id]))
        if trace.stripes is None or truth.stripes is None or not trace.products:
            refused.append(item.id)
            continue
        scores.append(score(trace.stripes, truth.stripes))
        (known,), one = truth.products, trace.products[0]
        if one.volume is None:
            refused.append(item.id)
        else:
            grades["recipe"][known.defect, label(trace)] += 1
            grades["best options"][known.defect, best.classify(one.product).label] += 1
            value = one.volume.visible_mm3.value
            errors.append((value / known.visible_mm3 - 1.0, value / known.true_mm3 - 1.0))
    print(f"{folder}: {len(references)} skeins; refused: {', '.join(refused) or 'none'}")
    total = [sum(column) for column in zip(*scores, strict=True)]
    print(
        f"coding: {total[1] / total[0]:.2%} of {total[0]} visible product points right, "
        f"{total[2]} points wrong,"
    )
    print(f"  longest wrong run {max(s.longest_wrong_run for s in scores)} rows; ", end="")
    print(f"worst skein {min(s.right / s.visible for s in scores):.2%} right")
    for name, found in grades.items():
        print_confusion(name, found)
    for name, column in zip(("visible", "true"), np.array(errors).T, strict=True):
        print(
            f"volume against {name:7}: mean {100 * column.mean():+.1f} %, "
            f"mean absolute {100 * np.abs(column).mean():.1f} %, "
            f"from {100 * column.min():+.1f} to {100 * column.max():+.1f} %"
        )


def made(recipe: Path, seed: int, count: int) -> Path:
    """Make the data set, or go on with it."""
    folder = Path(tempfile.gettempdir()) / f"roemetry-skeins-{seed}"
    simulate(Scene.load(recipe, sets=SETS), folder, count=count, seed=seed, resume=True, calibration="none")
    return folder


def score(stripes: StripeMap, truth: StripeTruth) -> Score:
    """Compare coded points with the true centres."""
    off = np.abs(truth.x_px[None, :, :] - np.where(stripes.seen, stripes.x_px, np.nan)[:, None, :])
    off = np.where(np.isnan(off), np.inf, off)
    nearest = off.argmin(axis=1)
    wrong = (off.min(axis=1) <= 3.0) & (nearest != np.arange(stripes.stripe_count)[:, None])
    right = truth.on_product & stripes.seen & (np.abs(truth.x_px - stripes.x_px) <= 3.0)
    return Score(
        int(truth.on_product.sum()),
        int(right.sum()),
        int(wrong.sum()),
        max(longest_run(row) for row in wrong),
    )


def longest_run(mask: np.ndarray) -> int:
    """Length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def label(trace: Trace) -> str:
    """Grade of the first product."""
    grade = trace.products[0].grade
    return "none" if grade is None else grade.label


def print_confusion(name: str, found: Counter[tuple[str, str]]) -> None:
    """Print a table of defect against grade, and the balanced accuracy of good against deformed."""
    kinds = sorted({kind for kind, _ in found}, key=lambda kind: (kind != "none", kind))
    labels = sorted({grade for _, grade in found})
    print(f"grading ({name}):")
    print("  " + " " * 14 + "".join(f"{grade:>9}" for grade in labels))
    for kind in kinds:
        print(f"  {kind:14}" + "".join(f"{found[kind, grade]:9}" for grade in labels))
    healthy = sum(found["none", grade] for grade in labels)
    deformed = sum(found.values()) - healthy
    caught = sum(count for (kind, grade), count in found.items() if kind != "none" and grade == "henkei")
    kept = found["none", "good"] / max(healthy, 1)
    print(f"  healthy kept {kept:.0%}, deformed caught {caught / max(deformed, 1):.0%}, ", end="")
    print(f"balanced accuracy {0.5 * (kept + caught / max(deformed, 1)):.3f}")


if __name__ == "__main__":
    main()
