"""How two ways of measuring the same products agree: differences, their limits, and a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_tools.compare.bootstrap import NO_INTERVAL, Bootstrap, Interval, mean_of

EQUIVALENT, DIFFERENT, UNDECIDED = "equivalent", "different", "undecided"
PRODUCTS_MIN = 5
"""With fewer products nothing is decided."""

_TWO_ONE_SIDED = 0.90
"""Level of the interval that two one-sided tests of 5 % each come to (Schuirmann 1987)."""
_LIMITS = 1.96


class Beside(NamedTuple):
    """An estimate beside what is true (NaN where not known), and of which product it is.

    Attributes
    ----------
    estimate, true
        In the unit of the quantity.
    product
        Id of the acquisition, and number of the product in it.
    specimen
        Which thing it is: one that is measured several times is one specimen.
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
    """What differences are judged by.

    Attributes
    ----------
    tolerance_pct
        Means that differ by less are as good as equal, %; None gives no verdict.
    folds
        Number of folds for the choice among variants.
    seed
        Of resampling and folds.
    """

    tolerance_pct: float | None = None
    folds: int = 5
    seed: int = 1


@dataclass(frozen=True, slots=True)
class Agreement:
    """Differences of a quantity, product by product, %.

    Attributes
    ----------
    n, specimens
        Number of differences; of different things among them.
    mean_pct, mean_interval_pct
        Their mean, and its 95 % interval.
    spread_pct
        Their standard deviation; NaN for one.
    limits_pct
        Limits of agreement, mean ∓ 1.96 standard deviations (Bland and Altman 1986): between them lie about
        95 % of the differences.
    low_limit_interval_pct, high_limit_interval_pct
        95 % intervals of the two.
    verdict
        ``equivalent`` if the 90 % interval of the mean lies within the tolerance, ``different`` if it lies
        wholly beyond it, else ``undecided``; "" without a tolerance.
    verdict_interval_pct
        That 90 % interval.
    """

    n: int
    specimens: int
    mean_pct: float
    mean_interval_pct: Interval
    spread_pct: float
    limits_pct: Interval
    low_limit_interval_pct: Interval
    high_limit_interval_pct: Interval
    verdict: str
    verdict_interval_pct: Interval


def against_truth(values: Mapping[str, Beside], terms: Terms) -> Agreement | None:
    """Compare estimates with what is true; None where nothing is known."""
    known = [one for one in values.values() if one.true > 0]
    differences = np.array([100.0 * (one.estimate / one.true - 1.0) for one in known])
    return agreement_of(differences, [one.specimen for one in known], terms)


def against_each_other(
    values: Mapping[str, Beside], others: Mapping[str, Beside], terms: Terms
) -> Agreement | None:
    """Compare estimates of the same products, as shares of the mean of both; None without common ones."""
    differences, specimens = differences_of(values, others)
    return agreement_of(differences, specimens, terms)


def differences_of(values: Mapping[str, Beside], others: Mapping[str, Beside]) -> tuple[Floats, list[str]]:
    """(product,) differences in % of the mean of both, and of which specimen each is."""
    both = [(one, others[name]) for name, one in values.items() if name in others]
    both = [(one, other) for one, other in both if one.estimate + other.estimate > 0]
    differences = [200.0 * (a.estimate - b.estimate) / (a.estimate + b.estimate) for a, b in both]
    return np.array(differences), [one.specimen for one, _ in both]


def nearer(values: Mapping[str, Beside], others: Mapping[str, Beside], terms: Terms) -> Shift | None:
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
