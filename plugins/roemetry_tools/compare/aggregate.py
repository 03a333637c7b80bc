"""All acquisitions of one variant, added up one at a time: errors against truth, classes, stripes, times."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roemetry.config.recipe import Recipe
from roemetry.records import Reason
from roemetry.records.arrays import Floats
from roemetry_tools.compare.agreement import Graded, PairedValue
from roemetry_tools.compare.data import specimen_of
from roemetry_tools.compare.score import Pair, Scored
from roemetry_tools.compare.stripes import CentreScore, CodingScore

NOT_GRADED = "(none)"
"""Stands where a product has a true class, and got none."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of n estimates against what is true; relative ones are (estimate − true) / true, %.

    `bias_pct` is their mean, `spread_pct` their standard deviation (NaN for one), then quartiles and ends;
    `rmse` is in the unit of the estimate.
    """

    n: int
    bias_pct: float
    spread_pct: float
    mean_absolute_pct: float
    rmse: float
    low_pct: float
    median_pct: float
    high_pct: float
    min_pct: float
    max_pct: float


class Quartiles(NamedTuple):
    """Median and quartiles of n values."""

    n: int
    low: float
    median: float
    high: float


@dataclass(frozen=True, slots=True)
class Classes:
    """Products counted by true and given class; one without a class stands under ``(none)``.

    `accuracy` is the share with the right class, ``unknown`` and no class not right; `balanced_accuracy` the
    mean over the true classes of the share given right, NaN where there is one class only.
    """

    true: tuple[str, ...]
    given: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    accuracy: float
    balanced_accuracy: float

    @property
    def n(self) -> int:
        """Number of products."""
        return sum(map(sum, self.counts))


Pairs = list[PairedValue]

QUANTITIES = ("visible_mm3", "true_mm3", "mass_g")
"""What is estimated and known: names of the fields of truth."""


@dataclass(frozen=True, slots=True)
class Cause:
    """A reason and how often it was given, with the sentence of the first time."""

    code: str
    count: int
    text: str


@dataclass(frozen=True, eq=False, slots=True)
class Figures:
    """What a variant came to; where a figure is None, `absent` says why."""

    acquisitions: int
    refused: int
    """Acquisitions not measured, or not wholly; `causes` says why, `warnings` what stands on the others'
    rows."""
    causes: tuple[Cause, ...]
    warnings: tuple[Cause, ...]
    errors: Mapping[str, Errors | None]
    pairs: Mapping[str, Pairs]
    """errors, pairs: by `QUANTITIES`, of products whose truth is known. For the true volume the estimator's
    true volume counts, where it gives one, else its visible volume; `true_from_visible` says how often."""
    values: Mapping[str, Mapping[str, PairedValue]]
    """By `QUANTITIES` and product, all that was measured, whether its truth is known or not."""
    graded: tuple[Graded, ...]
    """Products with a true class."""
    true_from_visible: int
    classes: Classes | None
    centres: CentreScore | None
    centres_on_product: CentreScore | None
    coding: CodingScore | None
    seconds: Mapping[str, Quartiles]
    """By step, and for all of them together under ``frame``; s for an acquisition."""
    absent: Mapping[str, str]

    @property
    def failed(self) -> bool:
        """Whether nothing at all was measured wholly."""
        return self.refused == self.acquisitions


class Aggregate:
    """Adds up one variant's acquisitions; `without_truth` says why nothing is known of the data, if so."""

    def __init__(self, recipe: Recipe, without_truth: str) -> None:
        self._recipe = recipe
        self._without_truth = without_truth
        self._acquisitions = 0
        self._refused = 0
        self._causes, self._warnings = Counter[str](), Counter[str]()
        self._texts: dict[str, str] = {}
        self._pairs: dict[str, Pairs] = {name: [] for name in QUANTITIES}
        self._values: dict[str, dict[str, PairedValue]] = {name: {} for name in QUANTITIES}
        self._graded: list[Graded] = []
        self._known, self._estimated = Counter[str](), Counter[str]()
        self._from_visible = 0
        self._classes: Counter[tuple[str, str]] = Counter()
        self._centres: list[CentreScore | None] = [None, None]
        self._coding: CodingScore | None = None
        self._without: dict[str, Reason] = {}
        self._seconds: dict[str, list[float]] = {}
        self._cold: dict[str, list[float]] = {}  # of acquisitions that paid for what is done once

    def add(self, scored: Scored, *, cold: bool) -> None:
        """Add an acquisition; `cold`: its times hold what is done once, such as compiling."""
        self._acquisitions += 1
        if scored.refused is not None:
            self._refused += 1
            self._note(self._causes, scored.refused)
        said = {reason for pair in scored.pairs for reason in pair.reasons} - {scored.refused}
        for reason in sorted(said):
            self._note(self._warnings, reason)
        for pair in scored.pairs:
            self._add_pair(pair, f"{scored.item}#{pair.product}")
        for place, score in enumerate((scored.centres, scored.centres_on_product)):
            if score is not None:
                self._centres[place] = (self._centres[place] or CentreScore()) + score
        if scored.coding is not None:
            self._coding = (self._coding or CodingScore()) + scored.coding
        for name, reason in scored.without.items():
            self._without.setdefault(name, reason)
        if scored.seconds:
            kept = self._cold if cold else self._seconds
            for step, value in {**scored.seconds, "frame": sum(scored.seconds.values())}.items():
                kept.setdefault(step, []).append(value)

    @property
    def values(self) -> Mapping[str, Mapping[str, PairedValue]]:
        """What was measured until now: see `Figures.values`."""
        return self._values

    def figures(self) -> Figures:
        """Sum up."""
        seconds = self._seconds or self._cold
        errors = {name: errors_of(*columns_of(pairs)) for name, pairs in self._pairs.items()}
        classes = classes_of(self._classes) if self._estimated["label"] else None
        found: dict[str, object] = {
            **errors,
            "label": classes,
            "centres": self._centres[0] if self._centres[0] and self._centres[0].true else None,
            "coding": self._coding if self._coding and self._coding.visible else None,
        }
        return Figures(
            acquisitions=self._acquisitions,
            refused=self._refused,
            causes=self._counted(self._causes),
            warnings=self._counted(self._warnings),
            errors=errors,
            pairs=self._pairs,
            values=self._values,
            graded=tuple(self._graded) if self._estimated["label"] else (),
            true_from_visible=self._from_visible,
            classes=classes,
            centres=self._centres[0],
            centres_on_product=self._centres[1],
            coding=self._coding,
            seconds={
                step: quartiles
                for step, values in seconds.items()
                if (quartiles := quartiles_of(values)) is not None
            },
            absent={name: self._why_not(name) for name, value in found.items() if value is None},
        )

    def _note(self, counter: Counter[str], reason: Reason) -> None:
        counter[reason.code] += 1
        self._texts.setdefault(reason.code, reason.text)

    def _counted(self, counter: Counter[str]) -> tuple[Cause, ...]:
        return tuple(Cause(code, count, self._texts[code]) for code, count in counter.most_common())

    def _add_pair(self, pair: Pair, product: str) -> None:
        true, specimen = pair.true, specimen_of(pair.true, product)
        estimates = estimates_of(pair)
        for name in QUANTITIES:
            value = estimates[name]
            if name == "true_mm3" and value is None:
                value = estimates["visible_mm3"]
            known = math.nan if true is None else getattr(true, name)
            self._estimated[name] += value is not None
            self._known[name] += known > 0
            if value is None or not math.isfinite(value):
                continue
            if known > 0 or estimates[name] is not None:
                self._values[name][product] = PairedValue(value, known, product, specimen)
            if known > 0:
                self._pairs[name].append(PairedValue(value, known, product, specimen))
                self._from_visible += name == "true_mm3" and estimates["true_mm3"] is None
        grade = pair.measured.grade if pair.measured else None
        label = None if grade is None else grade.label
        self._estimated["label"] += label is not None
        if true is not None and true.label:
            self._known["label"] += 1
            self._classes[true.label, label or NOT_GRADED] += 1
            probability = math.nan if grade is None else grade.probability
            self._graded.append(Graded(product, specimen, true.label, label or "", probability))

    def _why_not(self, name: str) -> str:
        """Say why a figure is missing."""
        if name in ("centres", "coding"):
            needed = {"centres": "extractor", "coding": "coder"}[name]
            if needed not in self._recipe.stages:
                return f"the recipe has no {needed}"
            if self._without_truth:
                return self._without_truth
            why = self._without.get(name) or self._without.get("stripes")
            return why.text if why is not None else f"nothing was given by the {needed}"
        needed = {"mass_g": "weigher", "label": "classifier"}.get(name, "volume")
        if needed not in self._recipe.stages:
            return f"the recipe has no {needed}"
        if self._without_truth:
            return self._without_truth
        if not self._known[name]:
            return f"the data set knows {_WORDS[name]} of no product"
        if not self._estimated[name]:
            return f"nothing was given by the {needed}"
        return "no product has both, what was measured and what is true"


def columns_of(pairs: Pairs) -> tuple[Floats, Floats]:
    """(product,) estimates, and (product,) true values."""
    return np.array([pair.estimate for pair in pairs]), np.array([pair.true for pair in pairs])


_WORDS = {
    "visible_mm3": "the visible volume",
    "true_mm3": "the true volume",
    "mass_g": "the mass",
    "label": "the class",
}


def estimates_of(pair: Pair) -> dict[str, float | None]:
    """Give what was measured, by `QUANTITIES`; None where it was not."""
    row = pair.measured
    volume = None if row is None else row.volume
    weight = None if row is None else row.weight
    return {
        "visible_mm3": None if volume is None else volume.visible_mm3.value,
        "true_mm3": None if volume is None or volume.true_mm3 is None else volume.true_mm3.value,
        "mass_g": None if weight is None else weight.mass_g.value,
    }


def relative_pct(estimate: Floats, true: Floats) -> Floats:
    """Relative errors, (estimate − true) / true, %."""
    return np.asarray(100.0 * (estimate - true) / true)


def errors_of(estimate: Floats, true: Floats) -> Errors | None:
    """Sum up (product,) estimates and true values, all finite, true above 0; None without any."""
    n = int(estimate.size)
    if n == 0:
        return None
    relative = relative_pct(estimate, true)
    low, median, high = np.quantile(relative, (0.25, 0.5, 0.75)).tolist()
    return Errors(
        n=n,
        bias_pct=float(relative.mean()),
        spread_pct=float(relative.std(ddof=1)) if n > 1 else math.nan,
        mean_absolute_pct=float(np.abs(relative).mean()),
        rmse=float(np.sqrt(((estimate - true) ** 2).mean())),
        low_pct=low,
        median_pct=median,
        high_pct=high,
        min_pct=float(relative.min()),
        max_pct=float(relative.max()),
    )


def quartiles_of(values: Sequence[float]) -> Quartiles | None:
    """Sum up values; None without any."""
    if not values:
        return None
    low, median, high = np.quantile(np.array(values, np.float64), (0.25, 0.5, 0.75)).tolist()
    return Quartiles(len(values), low, median, high)


def classes_of(counted: Mapping[tuple[str, str], int]) -> Classes | None:
    """Sum up products counted by (true, given) class; None without any."""
    if not counted:
        return None
    true = sorted({pair[0] for pair in counted})
    others = sorted({pair[1] for pair in counted} - {*true, NOT_GRADED})
    last = [NOT_GRADED] if any(pair[1] == NOT_GRADED for pair in counted) else []
    given = [*true, *others, *last]
    counts = tuple(tuple(counted.get((t, g), 0) for g in given) for t in true)
    right = [counted.get((name, name), 0) for name in true]
    recalls = [r / sum(row) for r, row in zip(right, counts, strict=True)]
    return Classes(
        tuple(true),
        tuple(given),
        counts,
        accuracy=sum(right) / sum(map(sum, counts)),
        balanced_accuracy=sum(recalls) / len(recalls) if len(recalls) > 1 else math.nan,
    )
