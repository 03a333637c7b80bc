"""Figures over many products: errors against truth, classes, times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from roemetry.records.arrays import Floats

NOT_GRADED = "(none)"
"""Stands where a product has a true class, and got none."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of estimates against what is true; relative ones are (estimate − true) / true.

    Attributes
    ----------
    n
        Number of products.
    bias_pct, spread_pct
        Mean of the relative errors, and their standard deviation (NaN for one product), %.
    mean_absolute_pct
        Mean of their absolute values, %.
    rmse
        Root of the mean squared error, in the unit of the estimate.
    low_pct, median_pct, high_pct
        Quartiles of the relative errors, %.
    min_pct, max_pct
        The ends, %.
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


@dataclass(frozen=True, slots=True)
class Quartiles:
    """Median and quartiles of n values."""

    n: int
    low: float
    median: float
    high: float


@dataclass(frozen=True, slots=True)
class Classes:
    """True classes against those given.

    Attributes
    ----------
    true, given
        Classes in the order of the table's rows and columns; a product without a class given stands under
        ``(none)``.
    counts
        (true, given) products.
    accuracy
        Share of the products with the right class. ``unknown`` and no class count as not right.
    balanced_accuracy
        Mean over the true classes of the share that was given right; NaN where there is one class only.
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
