"""Where a variant stands beside the truth and the recipe as it is, and which one to choose.

The best of several variants looks better than it is, on the products that it was chosen on. So the choice is
made again for each fold of the products from all the others, and judged on that fold.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_tools.compare.agreement import (
    NO_INTERVAL,
    Agreement,
    Graded,
    Interval,
    PairedValue,
    Recall,
    Reliability,
    Shift,
    Terms,
    against_each_other,
    against_truth,
    balanced_interval,
    balanced_shift,
    nearer,
    recalls_of,
    reliability_of,
)
from roemetry_tools.compare.early_stopping import Stopped
from roemetry_tools.compare.score import QUANTITIES, Figures
from roemetry_tools.compare.variants import Variant


@dataclass(frozen=True, slots=True)
class Standing:
    """A variant beside others."""

    truth: Mapping[str, Agreement] = field(default_factory=dict)
    recipe: Mapping[str, Agreement] = field(default_factory=dict)
    """truth, recipe: by quantity, agreement with what is true; with the recipe as it is, on the same
    products."""
    nearer: Mapping[str, Shift] = field(default_factory=dict)
    """By quantity, mean absolute error less that of the recipe as it is, on the same products, %."""
    recalls: tuple[Recall, ...] = ()
    balanced_interval: Interval = NO_INTERVAL
    """95 % interval of the balanced accuracy."""
    balanced_shift: Shift | None = None
    """Balanced accuracy less that of the recipe as it is; None for the recipe itself."""
    reliability: Reliability | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Compared:
    """A variant and what it came to; without figures where it could not even be made (`Variant.fault`)."""

    variant: Variant
    figures: Figures | None
    standing: Standing = field(default_factory=Standing)
    stopped: Stopped | None = None
    """Why it was measured no further; None where it measured everything."""

    @property
    def status(self) -> str:
        """``compared``, ``stopped`` early, or ``failed``."""
        return "failed" if self.failure else "compared" if self.stopped is None else "stopped"

    @property
    def failure(self) -> str:
        """Why it has nothing to show; "" where it has."""
        if self.figures is None:
            return self.variant.fault
        if not self.figures.failed:
            return ""
        return f"no acquisition was measured: {self.figures.causes[0].text}"


def rank_against(own: Figures | None, base: Figures | None, terms: Terms) -> Standing:
    """Hold a variant against the truth and, where it is another, the recipe as it is."""
    if own is None:
        return Standing()
    truth, recipe, shifts = {}, {}, {}
    for name in QUANTITIES:
        if (found := against_truth(own.values[name], terms)) is not None:
            truth[name] = found
        if base is None:
            continue
        if (found := against_each_other(own.values[name], base.values[name], terms)) is not None:
            recipe[name] = found
        if (shift := nearer(own.values[name], base.values[name], terms)) is not None:
            shifts[name] = shift
    others = {} if base is None else {one.product: one for one in base.graded}
    return Standing(
        truth,
        recipe,
        shifts,
        recalls_of(own.graded),
        balanced_interval(own.graded, terms) if len({one.true for one in own.graded}) > 1 else NO_INTERVAL,
        balanced_shift(own.graded, others, terms) if others else None,
        reliability_of(own.graded, terms),
    )


PRODUCTS_ENOUGH = 10
"""With fewer specimens an interval says little of products to come: their kinds are hardly all seen."""


@dataclass(frozen=True, slots=True)
class Leader:
    """The variant with the least mean absolute error, and how sure its lead is."""

    figure: str
    """A quantity of `QUANTITIES`: the first in which variants differ on the same products."""
    best: Variant
    other: Variant
    """The next best."""
    error_pct: float
    lead: Shift
    """How much smaller its error is on the same products, %, with the 95 % interval."""
    specimens: int

    @property
    def is_sure(self) -> bool:
        """Whether these products are enough to tell."""
        return self.specimens >= PRODUCTS_ENOUGH and self.lead.interval.low > 0.0

    @property
    def specimens_needed(self) -> int:
        """How many products would tell this lead from none, if they scatter as these do; 0: not known."""
        half = 0.5 * (self.lead.interval.high - self.lead.interval.low)
        if not (self.lead.value > 0.0 and half > 0.0):
            return 0
        return max(PRODUCTS_ENOUGH, ceil(self.specimens * (half / self.lead.value) ** 2))


def leader_of(compared: Sequence[Compared], terms: Terms) -> Leader | None:
    """Find the best variant and the margin to the next; None where no two differ by a truth.

    Of those that measured everything.
    """
    whole = [(one.variant, one.figures) for one in compared if one.figures and one.status == "compared"]
    for name in QUANTITIES:
        known = [(v, {k: one for k, one in f.values[name].items() if one.true > 0}) for v, f in whole]
        shared = set.intersection(*(set(values) for _, values in known)) if known else set()
        if len(known) < 2 or not shared:
            continue
        errors = [np.mean([abs(of[k].estimate / of[k].true - 1.0) for k in shared]) for _, of in known]
        if max(errors) - min(errors) < 1e-12:
            continue  # what is varied does not reach this quantity
        first, second = np.argsort(errors, kind="stable")[:2]
        (best, own), (other, others) = known[first], known[second]
        shift = nearer({k: others[k] for k in sorted(shared)}, {k: own[k] for k in sorted(shared)}, terms)
        assert shift is not None
        count = len({own[k].specimen for k in shared})
        return Leader(name, best, other, 100.0 * float(errors[first]), shift, count)
    return None


def same_results(compared: Sequence[Compared]) -> list[tuple[Variant, Variant]]:
    """Give variants that measured exactly what an earlier one did, each with that one."""
    found: list[tuple[Variant, Variant]] = []
    first: dict[str, Variant] = {}
    for one in compared:
        if one.figures is not None and not one.failure:
            earlier = first.setdefault(_results(one.figures), one.variant)
            if earlier is not one.variant:
                found.append((one.variant, earlier))
    return found


def _results(figures: Figures) -> str:
    """Hash everything that was measured."""
    whole = hashlib.sha256(repr(figures.refused).encode())
    for quantity, values in figures.values.items():
        whole.update(f"{quantity}\n".encode())
        for name, value in values.items():
            whole.update(f"{name}\0{value.estimate!r}\n".encode())
    for graded in figures.graded:
        whole.update(f"{graded.product}\0{graded.given}\n".encode())
    return whole.hexdigest()


def choices_of(compared: Sequence[Compared], terms: Terms) -> list[Choice]:
    """Choose the best variant by every figure that more than one of them has."""
    whole = {one.variant.number: one.figures for one in compared if one.figures and one.status == "compared"}
    found = [
        choose_by_error(name, {n: of.values[name] for n, of in whole.items() if of.pairs[name]}, terms)
        for name in QUANTITIES
    ]
    found.append(choose_by_class({n: of.graded for n, of in whole.items() if of.graded}, terms))
    return [choice for choice in found if choice is not None]


@dataclass(frozen=True, slots=True)
class Choice:
    """The best variant by one figure."""

    figure: str
    """``visible_mm3``, ``true_mm3``, ``mass_g``: least mean absolute error, %; ``label``: greatest balanced
    accuracy."""
    best: int
    """Number of the variant that is best on all products."""
    seen: float
    """Its figure on all products: flattered, since it was chosen on them."""
    held_out: float
    """The figure of the choice where each fold's variant was chosen on the other folds."""
    chosen: tuple[int, ...]
    """By fold, the number of the variant."""
    n: int
    """Products that all variants measured, and so took part."""


def choose_by_error(
    figure: str, values: Mapping[int, Mapping[str, PairedValue]], terms: Terms
) -> Choice | None:
    """Choose by the least mean absolute error, on the products that every variant measured.

    None with fewer than two variants, or fewer products than two a fold.
    """
    if len(values) < 2:
        return None
    first = next(iter(values.values()))
    names = [n for n, one in first.items() if one.true > 0 and all(n in other for other in values.values())]
    errors = np.array(
        [[100.0 * abs(of[n].estimate / of[n].true - 1.0) for n in names] for of in values.values()]
    )
    specimens = [first[name].specimen for name in names]
    return _chosen(figure, list(values), errors, specimens, lambda row, _: -float(row.mean()), terms)


def choose_by_class(graded: Mapping[int, Sequence[Graded]], terms: Terms) -> Choice | None:
    """Choose by the greatest balanced accuracy; None as in `choose_by_error`, or with one class."""
    if len(graded) < 2:
        return None
    tables = {number: {one.product: one for one in of} for number, of in graded.items()}
    first = next(iter(tables.values()))
    names = [name for name in first if all(name in table for table in tables.values())]
    classes = np.array([first[name].true for name in names])
    if len(np.unique(classes)) < 2:
        return None
    right = np.array([[float(table[name].right) for name in names] for table in tables.values()])
    specimens = [first[name].specimen for name in names]
    return _chosen(
        "label", list(tables), right, specimens, lambda row, of: _balanced(row, classes[of]), terms
    )


def _chosen(
    figure: str,
    numbers: Sequence[int],
    values: Floats,
    specimens: Sequence[str],
    merit: Callable[[Floats, Integers], float],
    terms: Terms,
) -> Choice | None:
    """Choose the variant of the greatest merit of its row of (variant, product) values, then fold by fold.

    `merit` takes the values of some products, and which these are; for errors it is below 0.
    """
    fold = _folds(specimens, terms)
    if fold is None:
        return None
    every = np.arange(len(specimens))
    chosen, held_out = [], np.empty(len(specimens))
    for k in range(terms.folds):
        others = every[fold != k]
        winner = int(np.argmax([merit(row[others], others) for row in values]))
        chosen.append(numbers[winner])
        held_out[fold == k] = values[winner, fold == k]
    merits = [merit(row, every) for row in values]
    best = int(np.argmax(merits))
    seen, unseen = abs(merits[best]), abs(merit(held_out, every))
    return Choice(figure, numbers[best], seen, unseen, tuple(chosen), len(specimens))


def _folds(specimens: Sequence[str], terms: Terms) -> Integers | None:
    """(product,) fold, the same for all that is measured of one specimen; None with fewer than two a fold."""
    names, of = np.unique(np.array(specimens, dtype=str), return_inverse=True)
    if len(names) < 2 * terms.folds:
        return None
    order = np.random.default_rng([terms.seed, len(names)]).permutation(len(names))
    fold = np.empty(len(names), np.int64)
    fold[order] = np.arange(len(names)) % terms.folds
    return np.asarray(fold[of])


def _balanced(right: Floats, classes: NDArray[np.str_]) -> float:
    return float(np.mean([right[classes == name].mean() for name in np.unique(classes)]))
