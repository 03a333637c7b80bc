"""Many skeins, a row each: features, grades, sizes of defects, weights; kept, by the code that made them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.tables import kept_rows
from benchmarks.traced.causes import weight_figures
from benchmarks.traced.shown import defect_figures
from benchmarks.traced.skeins import Traced, traced
from roemetry_paper.arc_curvature import ArcCurvature, ArcCurvatureOptions
from roemetry_shape.features import shape_of

SMOOTHING_MM = 3.0
HEALTHY_EVERY = ("healthy",) * 6
LEARNING_MIX = (
    *HEALTHY_EVERY,
    *("dented", "dented", "several-dents", "bent", "s-bent"),
    *("twisted", "twisted", "folded", "folded", "broken"),
)
"""Kinds by turns, for learning: every defect often enough, whatever the population has of it."""

NAMED = {
    "none": "good",
    "dented": "dent",
    "several-dents": "dent",
    "bent": "bend",
    "s-bent": "bend",
    "twisted": "twist",
    "folded": "fold",
    "broken": "broken",
}
"""The name a grader would give each kind: one dent or several, one bend or an S are told alike."""

BEST_OPTIONS: dict[str, Any] = {"smoothing_rows": 31, "radius_max_px": 160.0, "delta_samples": 10}
"""Of `arc-curvature`, chosen on rendered skeins of seeds 5000 to 5059."""


class Row(NamedTuple):
    """One skein."""

    seed: int
    rig: str
    kind: str
    """seed, rig, kind: what it is; `kind` is ``none`` for a healthy one."""
    refused: str
    """Why nothing was measured; "" where it was."""
    features: dict[str, float]
    """Of `shape_of`; empty where they could not be measured."""
    grades: dict[str, str]
    """Paper's rule as it is (``paper``), and with other options (``best options``)."""
    defect: dict[str, float]
    """Of `defect_figures`; of the population also on other numbers of lines."""
    weight: dict[str, float]
    """Of `weight_figures`; of the population alone."""

    @property
    def name(self) -> str:
        """What it should be called."""
        return NAMED[self.kind]


def rows_of(seeds: Sequence[int], rig: str, cache: Path, *, mix: Sequence[str] = ()) -> list[Row]:
    """Measure skeins, or take them from the cache.

    Parameters
    ----------
    seeds
        One skein each.
    rig
        A family of rigs.
    cache
        Folder of the kept rows.
    mix
        Kinds by turns; empty: as the population has them.
    """

    def make(seed: int) -> dict[str, Any]:
        return _row(traced(seed, rig, mix[seed % len(mix)] if mix else ""), rig, whole=not mix)._asdict()

    name = f"{'mix' if mix else 'population'}_{rig}.jsonl"
    known = kept_rows(cache / name, seeds, make)
    return [Row(**known[seed]) for seed in seeds]


def _row(one: Traced, rig: str, *, whole: bool) -> Row:
    features = {} if one.exact is None else shape_of(one.exact, SMOOTHING_MM).features
    grades = {}
    if one.paper is not None:
        grades["paper"] = ArcCurvature().classify(one.paper).label
        grades["best options"] = ArcCurvature(ArcCurvatureOptions(**BEST_OPTIONS)).classify(one.paper).label
    return Row(
        one.seed,
        rig,
        one.drawn.truth.defect,
        one.refused,
        features,
        grades,
        defect_figures(one) if whole else defect_figures(one, ()),
        weight_figures(one) if whole else {},
    )
