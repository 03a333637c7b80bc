"""The same classifiers on rendered images, to see whether traced skeins speak for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from benchmarks.experiment.six import PAPERS_CODER
from benchmarks.grading.judges import GOOD, SHOWN_MM
from benchmarks.tables import share, table
from benchmarks.traced.tables import BEST_OPTIONS, NAMED
from roemetry import Pipeline, Recipe
from roemetry.config.dataset import Dataset
from roemetry.records import Trace
from roemetry_files.dataset_source import DatasetSource
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions
from roemetry_shape.learned import Learned, LearnedOptions

SUB_PIXEL = (*PAPERS_CODER, "stages.extractor.use=centre-of-gravity", "stages.extractor.options={}")


def on_images(recipe: Path, data: Path, model: Path, count: int) -> str:
    """Judge the first images of a data set; `learned` gets sub-pixel peaks, the paper's rule its own."""
    paper, fine = (
        Pipeline(Recipe.load(recipe, sets=PAPERS_CODER)),
        Pipeline(Recipe.load(recipe, sets=SUB_PIXEL)),
    )
    best = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS))
    learned = Learned(LearnedOptions(model=model.resolve()))
    source, found, errors = DatasetSource(), {}, []
    references = {reference.id: reference for reference in source.references(data)}
    lines: dict[str, list[tuple[str, bool, str]]] = {}
    refused = 0
    for item in islice(Dataset(data).items(), count):
        (known,) = item.products
        shown = known.figures.get("defect_seen_mm", 0.0) >= SHOWN_MM
        acquisition = source.read(references[item.id])
        found = {"paper": paper.trace(acquisition), "fine": fine.trace(acquisition)}
        if not all(_measured(trace) for trace in found.values()):
            refused += 1
            continue
        one = found["paper"].products[0]
        assert one.grade is not None
        assert one.weight is not None
        given = {
            "paper's rule": one.grade.label,
            "paper's rule, best options": best.classify(one.product).label,
            "`learned`": learned.classify(found["fine"].products[0].product).label,
        }
        errors.append(100.0 * (one.weight.mass_g.value / known.mass_g - 1.0))
        for name, label in given.items():
            lines.setdefault(name, []).append((NAMED[known.defect], shown, label))
    rows = [[name, *_shares(of, "paper" not in name)] for name, of in lines.items()]
    mean = sum(map(abs, errors)) / len(errors)
    weight = (
        f"{len(errors)} skeins, {refused} refused. Mean absolute error of the paper's weight {mean:.1f} %, "
        f"from {min(errors):+.1f} % to {max(errors):+.1f} %.\n"
    )
    return table(["classifier", "good kept", "caught, if shown", "named right"], rows) + "\n" + weight


def _measured(trace: Trace) -> bool:
    return bool(trace.products) and trace.products[0].volume is not None


def _shares(of: Sequence[tuple[str, bool, str]], names: bool) -> list[str]:
    good = [label for name, _, label in of if name == GOOD]
    shown = [(name, label) for name, seen, label in of if seen and name != GOOD]
    caught = sum(label not in (GOOD, "unknown") for _, label in shown)
    named = share(sum(name == label for name, label in shown), len(shown)) if names else "does not name"
    return [share(sum(label == GOOD for label in good), len(good)), share(caught, len(shown)), named]
