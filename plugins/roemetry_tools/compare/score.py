"""What variants made of acquisitions: each beside its truth, then all of one variant added up."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from roemetry.config.recipe import Recipe
from roemetry.records import Measurement, ProductTruth, Reason, StripeTruth, Trace, Truth
from roemetry.records.arrays import Floats
from roemetry.run.rows import measurements_of
from roemetry.run.stage_cache import StageCache
from roemetry_tools.compare.agreement import Graded, PairedValue
from roemetry_tools.compare.data import specimen_of
from roemetry_tools.compare.stripes import (
    CentreScore,
    CodingScore,
    by_place,
    score_centres,
    score_coding,
    truth_in,
)


@dataclass(frozen=True, eq=False, slots=True)
class Pair:
    """A product as measured (without provenance) and as it is; either may be missing.

    Products are numbered from left to right; 0 stands where there is none at all.
    """

    product: int
    measured: Measurement | None
    true: ProductTruth | None
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Scored:
    """What one variant made of one acquisition (`item` is its id)."""

    variant: int
    item: str
    pairs: tuple[Pair, ...]
    refused: Reason | None
    """Why it was not measured, or not all of it; None where it was."""
    centres: CentreScore | None = None
    centres_on_product: CentreScore | None = None
    coding: CodingScore | None = None
    """centres, centres_on_product, coding: extractor and coder against the true stripes; where None,
    `without` says why."""
    without: Mapping[str, Reason] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    """By step, the time it took where it was done, s."""


def score(
    variant: int, trace: Trace, recipe: Recipe, truth: Truth | None,
    memory: tuple[Mapping[str, str], StageCache], seconds: Mapping[str, float], turn_deg: int,
) -> Scored:  # fmt: skip
    """Judge what a variant did with an acquisition; `truth` is None where nothing is known.

    Scores are shared like steps: `memory` holds them, under the keys of the variant's steps. The truth of the
    stripes is given for the image turned by the data set's `turn_deg`.
    """
    keys, shared = memory
    rows = measurements_of(trace, recipe, {})
    without: dict[str, Reason] = {}
    centres = on_product = coding = None
    stripes = _stripes(trace, truth, without, turn_deg)
    pairs = _pairs(rows, trace, truth, stripes, turn_deg)
    if stripes is not None and trace.peaks is not None:
        peaks = trace.peaks
        key = ("centres", keys["extractor"])
        centres, on_product = shared.recall(key, lambda: score_centres(peaks, stripes))[0]
        coded = trace.stripes
        if coded is not None and coded.stripe_count != stripes.x_px.shape[0]:
            without["coding"] = Reason(
                "other-stripes",
                f"{coded.stripe_count} stripes are labelled, the truth counts {stripes.x_px.shape[0]}",
            )
        elif coded is not None:
            key = ("coding", keys["coder"])
            coding = shared.recall(key, lambda: score_coding(coded, peaks, stripes))[0]
    refused = _refused(rows, pairs, truth)
    found = centres, on_product, coding, without, seconds
    return Scored(variant, trace.acquisition_id, pairs, refused, *found)


def unreadable(variant: int, item: str, why: Reason, truth: Truth | None) -> Scored:
    """Judge an acquisition that could not be read."""
    products = () if truth is None else truth.products
    pairs = tuple(Pair(number, None, true, (why,)) for number, true in enumerate(products, start=1))
    return Scored(variant, item, pairs or (Pair(0, None, None, (why,)),), why)


def _stripes(
    trace: Trace, truth: Truth | None, without: dict[str, Reason], turn_deg: int
) -> StripeTruth | None:
    if truth is None or trace.frame is None:
        return None
    if truth.stripes is None:
        without["stripes"] = Reason("no-true-stripes", "the data set does not say where the stripes are")
        return None
    found = truth_in(trace.frame, truth.stripes, turn_deg)
    if isinstance(found, Reason):
        without["stripes"] = found
        return None
    return found


def _pairs(
    rows: Sequence[Measurement],
    trace: Trace,
    truth: Truth | None,
    stripes: StripeTruth | None,
    turn_deg: int,
) -> tuple[Pair, ...]:
    """Put measured and true products together: by place, else from left to right if there are as many."""
    found = _left_to_right([row for row in rows if row.product > 0], trace, turn_deg)
    if truth is None:
        return tuple(Pair(row.product, row, None, row.all_reasons) for row in found or rows)
    matched = _matched(found, trace, truth, stripes)
    if not found:
        why = rows[0].all_reasons
        missed = tuple(Pair(n, None, product, why) for n, product in enumerate(truth.products, start=1))
        return missed or (Pair(0, rows[0], None, why),)
    why = (_differ(len(found), len(truth.products)),)
    measured = {number: row for row in found if (number := matched.get(row.product)) is not None}
    pairs = []
    for number, true in enumerate(truth.products, start=1):
        row = measured.get(number)
        pairs.append(Pair(number, row, true, why if row is None else row.all_reasons))
    left = [row for row in found if row.product not in matched]
    return (*pairs, *(Pair(row.product, row, None, (*why, *row.all_reasons)) for row in left))


def _matched(
    found: Sequence[Measurement], trace: Trace, truth: Truth, stripes: StripeTruth | None
) -> dict[int, int]:
    """Give the true product's number for each measured one's, as far as that is known."""
    several = len(found) > 1 or len(truth.products) > 1
    if several and stripes is not None and trace.stripes is not None:
        placed = by_place(trace.stripes, stripes)
        if placed:
            return placed
    if len(found) == len(truth.products):
        return {row.product: number for number, row in enumerate(found, start=1)}
    return {}


def _left_to_right(found: list[Measurement], trace: Trace, turn_deg: int) -> list[Measurement]:
    """Order by the place in the image that the truth is given for."""
    if len(found) < 2 or trace.frame is None:
        return found
    half_turned = (trace.frame.turn_deg - turn_deg) % 360 == 180
    place = {
        product.product.number: float(np.nanmean(product.product.profiles.x_px))
        for product in trace.products
        if np.isfinite(product.product.profiles.x_px).any()
    }
    return sorted(found, key=lambda row: place.get(row.product, math.inf) * (-1 if half_turned else 1))


def _refused(rows: Sequence[Measurement], pairs: Sequence[Pair], truth: Truth | None) -> Reason | None:
    for row in rows:
        if row.status == "failed":
            faults = tuple(row.absent.values()) or row.reasons
            return next((why for why in row.reasons if why in faults), faults[0])
        if row.status == "empty" and truth is not None and truth.products:
            return row.reasons[0]
    return next((why for pair in pairs for why in pair.reasons if why.code == "products-differ"), None)


def _differ(found: int, true: int) -> Reason:
    if found == true:
        return Reason("products-differ", "a product was found where there is none, and one was missed")
    there = f", {true} are there" if true else " where there is none"
    return Reason("products-differ", f"{found} products were found{there}")


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
            seconds={step: quartiles_of(values) for step, values in seconds.items()},
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
            value, known = beside_truth(pair, name)
            self._estimated[name] += value is not None
            self._known[name] += known > 0
            if value is None or not math.isfinite(value):
                continue
            paired = PairedValue(value, known, product, specimen)
            if known > 0 or estimates[name] is not None:
                self._values[name][product] = paired
            if known > 0:
                self._pairs[name].append(paired)
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
        needed = _GIVEN_BY.get(name, "volume")
        if needed not in self._recipe.stages:
            return f"the recipe has no {needed}"
        if self._without_truth:
            return self._without_truth
        nothing = f"nothing was given by the {needed}"
        if name in ("centres", "coding"):
            why = self._without.get(name) or self._without.get("stripes")
            return nothing if why is None else why.text
        if not self._known[name]:
            return f"the data set knows {_WORDS[name]} of no product"
        return "no product has both, what was measured and what is true" if self._estimated[name] else nothing


_GIVEN_BY = {"mass_g": "weigher", "label": "classifier", "centres": "extractor", "coding": "coder"}


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


def beside_truth(pair: Pair, name: str) -> tuple[float | None, float]:
    """Give what was measured of a quantity, None where it was not, and what is true, NaN where not known.

    For a true volume that was not estimated the visible one stands.
    """
    estimates = estimates_of(pair)
    value = estimates[name]
    if name == "true_mm3" and value is None:
        value = estimates["visible_mm3"]
    return value, math.nan if pair.true is None else getattr(pair.true, name)


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


def quartiles_of(values: Sequence[float]) -> Quartiles:
    """Sum up values, at least one."""
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
