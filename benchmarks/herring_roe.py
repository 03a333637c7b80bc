"""Coding, grading and volume of the shipped recipe on skeins it was not made with.

``python -m benchmarks herring_roe [--first 6000] [--count 60] [--set KEY=VALUE …]``

Skeins are rendered anew from their seeds (3 to 4 s each) and kept in ``--cache``. Wrong means: the nearest
true stripe centre within 3 px belongs to another stripe.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roemetry import Pipeline, Recipe
from roemetry.records import Acquisition, Frame, StripeMap, Trace
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions
from roemetry_simulate.herring_roe import render_scene, scene, stripe_truth

BEST_OPTIONS = {"smoothing_rows": 31, "radius_max_px": 160.0, "delta_samples": 10}
"""Chosen on seeds 5000–5059: see docs/explanation/herring-roe.md."""


class Sample(NamedTuple):
    """A rendered skein and its truth."""

    seed: int
    kind: str
    image: np.ndarray
    x_px: np.ndarray
    on_product: np.ndarray
    visible_mm3: float
    true_mm3: float


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
    parser.add_argument("--first", type=int, default=6000, help="first seed")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-skeins")
    parser.add_argument("--set", action="append", default=[], dest="sets")
    given = parser.parse_args()
    recipe = Recipe.load(given.recipe, sets=given.sets)
    pipeline = Pipeline(recipe)
    scores, errors, refused = [], [], []
    grades = {"recipe": Counter[tuple[str, str]](), "best options": Counter[tuple[str, str]]()}
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    for seed in range(given.first, given.first + given.count):
        sample = sample_of(seed, given.cache)
        trace = pipeline.trace(Acquisition(str(seed), (Frame(sample.image),)))
        if trace.stripes is None or not trace.products:
            refused.append(seed)
            continue
        scores.append(score(trace.stripes, sample))
        volume = trace.products[0].volume
        if volume is None:
            refused.append(seed)
        else:
            grades["recipe"][sample.kind, label(trace)] += 1
            grades["best options"][sample.kind, best.classify(trace.products[0].product).label] += 1
            value = volume.visible_mm3.value
            errors.append((value / sample.visible_mm3 - 1.0, value / sample.true_mm3 - 1.0))
    print(
        f"{given.count} skeins, seeds {given.first}…{given.first + given.count - 1}; "
        f"refused: {refused or 'none'}"
    )
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


def sample_of(seed: int, cache: Path) -> Sample:
    """Render a skein, or read it from the cache."""
    path = cache / f"{seed}.npz"
    if not path.exists():
        made = scene(seed)
        truth = stripe_truth(made)
        cache.mkdir(parents=True, exist_ok=True)
        record = made.skein.record  # type: ignore[union-attr]
        np.savez_compressed(
            path,
            kind=record.kind,
            image=render_scene(made),
            x_px=truth.x_px,
            on_product=truth.on_product,
            volumes_mm3=[made.solid.visible_volume_mm3, made.solid.true_volume_mm3],
        )
    with np.load(path) as kept:
        visible, true = kept["volumes_mm3"]
        return Sample(
            seed,
            str(kept["kind"]),
            kept["image"],
            kept["x_px"],
            kept["on_product"],
            float(visible),
            float(true),
        )


def score(stripes: StripeMap, sample: Sample) -> Score:
    """Compare coded points with the true centres."""
    visible = (sample.on_product == 1) & np.isfinite(sample.x_px)
    off = np.abs(sample.x_px[None, :, :] - np.where(stripes.seen, stripes.x_px, np.nan)[:, None, :])
    off = np.where(np.isnan(off), np.inf, off)
    nearest = off.argmin(axis=1)
    wrong = (off.min(axis=1) <= 3.0) & (nearest != np.arange(stripes.stripe_count)[:, None])
    right = visible & stripes.seen & (np.abs(sample.x_px - stripes.x_px) <= 3.0)
    return Score(
        int(visible.sum()), int(right.sum()), int(wrong.sum()), max(longest_run(row) for row in wrong)
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
    """Print a table of kind against grade, and the balanced accuracy of good against deformed."""
    kinds = sorted({kind for kind, _ in found}, key=lambda kind: (kind != "healthy", kind))
    labels = sorted({grade for _, grade in found})
    print(f"grading ({name}):")
    print("  " + " " * 10 + "".join(f"{grade:>9}" for grade in labels))
    for kind in kinds:
        print(f"  {kind:10}" + "".join(f"{found[kind, grade]:9}" for grade in labels))
    healthy = sum(found["healthy", grade] for grade in labels)
    deformed = sum(found.values()) - healthy
    caught = sum(count for (kind, grade), count in found.items() if kind != "healthy" and grade == "henkei")
    kept = found["healthy", "good"] / max(healthy, 1)
    print(f"  healthy kept {kept:.0%}, deformed caught {caught / max(deformed, 1):.0%}, ", end="")
    print(f"balanced accuracy {0.5 * (kept + caught / max(deformed, 1)):.3f}")


if __name__ == "__main__":
    main()
