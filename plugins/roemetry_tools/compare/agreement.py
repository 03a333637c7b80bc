"""How two ways of measuring the same products agree: differences, their limits, and a verdict.

Differences are relative, %, product by product. Their mean and the limits of agreement (Bland and Altman
1986) stand with intervals of a bootstrap over products. Two means are equivalent where the 90 % interval of
their difference lies within a tolerance (two one-sided tests, Schuirmann 1987), different where it lies
wholly beyond. With few products, or with products unlike those to come, intervals say less than they seem to.

Classes are held against true ones: recalls with intervals, and whether stated probabilities hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats

RESAMPLES = 2000
"""Draws: the ends of a 95 % interval then wander by 3 % of its half width from seed to seed."""
LEVEL = 0.95
"""Of all intervals that are stated, as in the reports of a run."""
_AT_ONCE = 2_000_000
"""Counts drawn at a time: 16 MB, however many products there are."""
MANY = 5000
"""Different products that are drawn one by one, at most: so many take a third of a second. The sums of more
are normal, but for a hundredth of an interval's width at a skewness of 3.
"""


class Interval(NamedTuple):
    """Ends of an interval; NaN where there are too few products for one."""

    low: float
    high: float


NO_INTERVAL = Interval(math.nan, math.nan)


class Bootstrap:
    """Draws products with replacement, whole: with all that was measured of each.

    The same product measured twice is one witness, not two: `products` says of which one each value is,
    `count` how many different ones there are. The same seed gives the same draws.
    """

    def __init__(self, products: Sequence[str], seed: int) -> None:
        names, self._of = np.unique(np.array(products, dtype=str), return_inverse=True)
        self.count = len(names)
        self._seed = seed

    def interval(
        self, columns: Floats, statistic: Callable[[Floats], Floats], level: float = LEVEL
    ) -> Interval:
        """Give the interval of one statistic, (draw,); otherwise as `intervals`."""
        return self.intervals(columns, lambda sums: statistic(sums)[:, None], level)[0]

    def intervals(
        self, columns: Floats, statistics: Callable[[Floats], Floats], level: float = LEVEL
    ) -> list[Interval]:
        """Give the intervals of several statistics of the same draws.

        - `columns`: (value, column): what is summed over the values.
        - `statistics`: Takes (draw, column + 1) sums, the last of them the number of values; gives (draw,
          statistic).
        - `level`: Share of draws within, widened for few products by Student's t (Hesterberg 2015, section
          5.3).
        """
        if self.count < 2:
            with np.errstate(divide="ignore", invalid="ignore"):  # asked only how many there are
                return [NO_INTERVAL] * statistics(np.ones((1, columns.shape[1] + 1))).shape[1]
        from scipy.special import ndtr, stdtrit

        sums = np.zeros((self.count, columns.shape[1] + 1))
        np.add.at(sums, self._of, np.column_stack([columns, np.ones(len(columns))]))
        rng = np.random.default_rng([self._seed, self.count])
        with np.errstate(divide="ignore", invalid="ignore"):
            drawn = [statistics(sums_drawn) for sums_drawn in _resampled(sums, rng)]
        widen = math.sqrt(self.count / (self.count - 1.0))
        tail = float(ndtr(widen * stdtrit(self.count - 1.0, 0.5 * (1.0 - level))))
        return [_ends(column, tail) for column in np.concatenate(drawn).T]


def _resampled(sums: Floats, rng: np.random.Generator) -> Iterator[Floats]:
    """Give (draw, column) sums over (product, column) of products drawn with replacement, some at a time.

    Of many products those that are alike are drawn together, such as all that are of one class and right.
    Where they are all different, the sums are drawn as what they become of many products: normal, with the
    mean and the covariance that drawing gives them.
    """
    weights = np.ones(len(sums), np.int64)
    if len(sums) > MANY:
        alike, counted = np.unique(sums, axis=0, return_counts=True)
        if len(alike) > MANY:
            covariance = len(sums) * np.atleast_2d(np.cov(sums, rowvar=False, bias=True))
            yield rng.multivariate_normal(sums.sum(axis=0), covariance, RESAMPLES, method="svd")
            return
        sums, weights = alike, counted
    count = int(weights.sum())
    block = max(_AT_ONCE // len(sums), 1)
    for first in range(0, RESAMPLES, block):
        rows = min(block, RESAMPLES - first)
        yield np.asarray(rng.multinomial(count, weights / count, size=rows) @ sums)


def mean_of(sums: Floats) -> Floats:
    """Give the mean of the first column."""
    return np.asarray(sums[:, 0] / sums[:, -1])


def wilson(right: int, n: int) -> Interval:
    """Give the 95 % interval of a share by its score (Wilson 1927): honest near 0 and 1, and for few."""
    if n == 0:
        return NO_INTERVAL
    from scipy.stats import binomtest

    found = binomtest(right, n).proportion_ci(LEVEL, "wilson")
    return Interval(float(found.low), float(found.high))


def _ends(drawn: Floats, tail: float) -> Interval:
    known = drawn[np.isfinite(drawn)]
    if not known.size:
        return NO_INTERVAL
    low, high = np.quantile(known, (tail, 1.0 - tail)).tolist()
    return Interval(low, high)


EQUIVALENT, DIFFERENT, UNDECIDED = "equivalent", "different", "undecided"
PRODUCTS_MIN = 5
"""With fewer products nothing is decided."""
_TWO_ONE_SIDED = 0.90
"""Level of the interval that two one-sided tests of 5 % each come to (Schuirmann 1987)."""
_LIMITS = 1.96
"""Standard deviations that hold 95 % of normally distributed differences."""


class PairedValue(NamedTuple):
    """An estimate beside what is true (NaN where not known), both in the unit of the quantity.

    `product` is its acquisition's id and its number there; one thing measured several times is one
    `specimen`.
    """

    estimate: float
    true: float
    product: str
    specimen: str


class Shift(NamedTuple):
    """A difference of two figures on the same products, and its 95 % interval."""

    value: float
    interval: Interval


@dataclass(frozen=True, slots=True)
class Terms:
    """What differences are judged by: means that differ by less than the tolerance are as good as equal.

    Without a tolerance there is no verdict. Folds are those of the choice among variants. Early stopped are
    those that are certainly worse than another.
    """

    tolerance_pct: float | None = None
    folds: int = 5
    seed: int = 1
    stop_early: bool = False


@dataclass(frozen=True, slots=True)
class Agreement:
    """Differences of a quantity, product by product, %."""

    n: int
    specimens: int
    """n, specimens: number of differences; of different things among them."""
    mean_pct: float
    mean_interval_pct: Interval
    """mean_pct, mean_interval_pct: their mean, and its 95 % interval."""
    spread_pct: float
    """Their standard deviation; NaN for one."""
    limits_pct: Interval
    """Limits of agreement, mean ∓ 1.96 standard deviations (Bland and Altman 1986): between them lie about 95
    % of the differences."""
    low_limit_interval_pct: Interval
    high_limit_interval_pct: Interval
    """low_limit_interval_pct, high_limit_interval_pct: 95 % intervals of the two."""
    verdict: str
    """``equivalent`` if the 90 % interval of the mean lies within the tolerance, ``different`` if it lies
    wholly beyond it, else ``undecided``; "" without a tolerance."""
    verdict_interval_pct: Interval
    """That 90 % interval."""


def against_truth(values: Mapping[str, PairedValue], terms: Terms) -> Agreement | None:
    """Compare estimates with what is true; None where nothing is known."""
    known = [one for one in values.values() if one.true > 0]
    differences = np.array([100.0 * (one.estimate / one.true - 1.0) for one in known])
    return agreement_of(differences, [one.specimen for one in known], terms)


def against_each_other(
    values: Mapping[str, PairedValue], others: Mapping[str, PairedValue], terms: Terms
) -> Agreement | None:
    """Compare estimates of the same products, as shares of the mean of both; None without common ones."""
    differences, specimens = differences_of(values, others)
    return agreement_of(differences, specimens, terms)


def differences_of(
    values: Mapping[str, PairedValue], others: Mapping[str, PairedValue]
) -> tuple[Floats, list[str]]:
    """(product,) differences in % of the mean of both, and of which specimen each is."""
    both = [(one, others[name]) for name, one in values.items() if name in others]
    both = [(one, other) for one, other in both if one.estimate + other.estimate > 0]
    differences = [200.0 * (a.estimate - b.estimate) / (a.estimate + b.estimate) for a, b in both]
    return np.array(differences), [one.specimen for one, _ in both]


def nearer(
    values: Mapping[str, PairedValue], others: Mapping[str, PairedValue], terms: Terms
) -> Shift | None:
    """Say by how much the absolute errors differ on the same products, %; below 0: `values` are nearer."""
    both = [(one, others[name]) for name, one in values.items() if name in others and one.true > 0]
    if not both:
        return None
    change = [100.0 * (abs(a.estimate - a.true) - abs(b.estimate - b.true)) / a.true for a, b in both]
    columns = np.array(change)[:, None]
    bootstrap = Bootstrap([one.specimen for one, _ in both], terms.seed)
    return Shift(float(np.mean(change)), bootstrap.interval(columns, mean_of))


def agreement_of(differences: Floats, specimens: Sequence[str], terms: Terms) -> Agreement | None:
    """Sum up (product,) differences, %; None without any."""
    n = int(differences.size)
    if n == 0:
        return None
    bootstrap = Bootstrap(specimens, terms.seed)
    columns = np.column_stack([differences, differences**2])
    mean, low, high = bootstrap.intervals(columns, _mean_and_limits) if n > 1 else [NO_INTERVAL] * 3
    narrow = bootstrap.interval(columns, mean_of, _TWO_ONE_SIDED)
    middle = float(differences.mean())
    spread = float(differences.std(ddof=1)) if n > 1 else math.nan
    return Agreement(
        n=n,
        specimens=bootstrap.count,
        mean_pct=middle,
        mean_interval_pct=mean,
        spread_pct=spread,
        limits_pct=Interval(middle - _LIMITS * spread, middle + _LIMITS * spread),
        low_limit_interval_pct=low,
        high_limit_interval_pct=high,
        verdict=_verdict(narrow, bootstrap.count, terms.tolerance_pct),
        verdict_interval_pct=narrow,
    )


def _mean_and_limits(sums: Floats) -> Floats:
    n = sums[:, -1]
    mean = sums[:, 0] / n
    spread = np.sqrt(np.maximum(sums[:, 1] / n - mean**2, 0.0) * n / (n - 1.0))
    return np.column_stack([mean, mean - _LIMITS * spread, mean + _LIMITS * spread])


def _verdict(interval: Interval, specimens: int, tolerance_pct: float | None) -> str:
    if tolerance_pct is None:
        return ""
    if specimens < PRODUCTS_MIN or math.isnan(interval.low):
        return UNDECIDED
    if -tolerance_pct < interval.low and interval.high < tolerance_pct:
        return EQUIVALENT
    if interval.low > tolerance_pct or interval.high < -tolerance_pct:
        return DIFFERENT
    return UNDECIDED


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
        recall = len(mine), hits / len(mine), wilson(hits, len(mine))
        precision = hits / len(called) if called else math.nan
        found.append(Recall(name, *recall, len(called), precision, wilson(hits, len(called))))
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
    names = {one.true for one in graded}
    right = np.array([is_true(one, names) for one in stated], np.float64)
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


def is_true(one: Graded, names: Collection[str]) -> bool:
    """Tell whether a product is what it was called, or is not what it was said not to be (`not-good`).

    A word that is itself one of the true classes' `names` denies nothing.
    """
    denied = one.given.removeprefix("not-")
    return one.right or (one.given not in names and denied in names and denied != one.true)


def _by_class(graded: Sequence[Graded], names: Sequence[str], values: Floats) -> Floats:
    """(product, 2 · class): the value where the product is of the class, then whether it is."""
    of = np.array([[one.true == name for name in names] for one in graded], np.float64)
    return np.concatenate([of * values, of], axis=1)


def _balanced(sums: Floats) -> Floats:
    """Mean over the classes of value over number; a class that no draw holds leaves NaN."""
    classes = (sums.shape[1] - 1) // 2
    return np.asarray((sums[:, :classes] / sums[:, classes : 2 * classes]).mean(axis=1))
