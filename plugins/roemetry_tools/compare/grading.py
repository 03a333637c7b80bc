"""Classes given against true ones: recalls with intervals, and whether stated probabilities hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_tools.compare.agreement import Bootstrap, Interval, Shift, Terms, mean_of, wilson

BINS = 10
"""Tenths, as reliability diagrams are drawn (Niculescu-Mizil and Caruana 2005)."""


class Graded(NamedTuple):
    """The class of one product; `given` is "" where none was given, `probability` NaN where none was."""

    product: str
    specimen: str
    true: str
    given: str
    probability: float

    @property
    def right(self) -> bool:
        """Whether it was called what it is."""
        return self.given == self.true


class Recall(NamedTuple):
    """Of one class: products, share of them that was called so; share right of those that were called so.

    Intervals are Wilson's, 95 %; `precision` is NaN where no product was called so.
    """

    name: str
    n: int
    recall: float
    recall_interval: Interval
    called: int
    precision: float
    precision_interval: Interval


class Bin(NamedTuple):
    """Products whose class was stated with a probability from `low` to `high`."""

    low: float
    high: float
    n: int
    stated: float
    right: float
    right_interval: Interval


@dataclass(frozen=True, slots=True)
class Reliability:
    """Stated probabilities against the share that was right, over the products with a known class."""

    n: int
    bins: tuple[Bin, ...]
    """By stated probability, tenth by tenth; empty ones are left out."""
    stated: float
    right: float
    excess: Shift
    """Mean stated − share right; above 0 the classifier is surer than it should be."""
    brier: float
    """Mean squared difference of probability and outcome (1 right, 0 wrong)."""
    calibration_error: float
    """Mean over the products of their bin's difference of stated and right, without sign."""


def recalls_of(graded: Sequence[Graded]) -> tuple[Recall, ...]:
    """Give a line for each true class, in the order of their names."""
    found = []
    for name in sorted({one.true for one in graded}):
        mine = [one for one in graded if one.true == name]
        called = [one for one in graded if one.given == name]
        hits = sum(one.right for one in mine)
        found.append(
            Recall(
                name,
                len(mine),
                hits / len(mine),
                wilson(hits, len(mine)),
                len(called),
                hits / len(called) if called else math.nan,
                wilson(hits, len(called)),
            )
        )
    return tuple(found)


def balanced_interval(graded: Sequence[Graded], terms: Terms) -> Interval:
    """Give the 95 % interval of the balanced accuracy, products drawn with replacement."""
    names = sorted({one.true for one in graded})
    right = np.array([[one.right for one in graded]], np.float64).T
    columns = _by_class(graded, names, right)
    return Bootstrap([one.specimen for one in graded], terms.seed).interval(columns, _balanced)


def balanced_shift(graded: Sequence[Graded], others: Mapping[str, Graded], terms: Terms) -> Shift | None:
    """Say by how much the balanced accuracy differs on the same products; above 0: `graded` is better."""
    both = [(one, others[one.product]) for one in graded if one.product in others]
    names = sorted({one.true for one, _ in both})
    if len(names) < 2:
        return None
    change = np.array([[float(a.right) - float(b.right) for a, b in both]]).T
    mine = [one for one, _ in both]
    columns = _by_class(mine, names, change)
    value = float(_balanced(np.append(columns.sum(axis=0), len(both))[None, :])[0])
    return Shift(value, Bootstrap([one.specimen for one in mine], terms.seed).interval(columns, _balanced))


def reliability_of(graded: Sequence[Graded], terms: Terms) -> Reliability | None:
    """Hold stated probabilities against what was right; None where none is stated."""
    stated = [one for one in graded if math.isfinite(one.probability)]
    if not stated:
        return None
    p = np.array([one.probability for one in stated])
    right = np.array([one.right for one in stated], np.float64)
    place = np.minimum((p * BINS).astype(np.int64), BINS - 1)
    bins = []
    for k in np.unique(place).tolist():
        mine = place == k
        hits = int(right[mine].sum())
        n = int(mine.sum())
        bins.append(Bin(k / BINS, (k + 1) / BINS, n, float(p[mine].mean()), hits / n, wilson(hits, n)))
    bootstrap = Bootstrap([one.specimen for one in stated], terms.seed)
    excess = bootstrap.interval((p - right)[:, None], mean_of)
    return Reliability(
        n=len(stated),
        bins=tuple(bins),
        stated=float(p.mean()),
        right=float(right.mean()),
        excess=Shift(float((p - right).mean()), excess),
        brier=float(((p - right) ** 2).mean()),
        calibration_error=sum(b.n * abs(b.stated - b.right) for b in bins) / len(stated),
    )


def _by_class(graded: Sequence[Graded], names: Sequence[str], values: Floats) -> Floats:
    """(product, 2 · class): the value where the product is of the class, then whether it is."""
    of = np.array([[one.true == name for name in names] for one in graded], np.float64)
    return np.concatenate([of * values, of], axis=1)


def _balanced(sums: Floats) -> Floats:
    """Mean over the classes of value over number; a class that no draw holds leaves NaN."""
    classes = (sums.shape[1] - 1) // 2
    return np.asarray((sums[:, :classes] / sums[:, classes : 2 * classes]).mean(axis=1))
