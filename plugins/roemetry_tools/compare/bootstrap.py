"""Bootstrap over products: the same product measured twice is one witness, not two."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats

RESAMPLES = 2000
LEVEL = 0.95
_AT_ONCE = 2_000_000


class Interval(NamedTuple):
    """Ends of an interval; NaN where there are too few products for one."""

    low: float
    high: float


NO_INTERVAL = Interval(math.nan, math.nan)


class Bootstrap:
    """Draws products with replacement, whole: with all that was measured of each.

    Parameters
    ----------
    products
        (value,) of which product each value is.
    seed
        The same seed gives the same draws.

    Attributes
    ----------
    count
        Number of products.
    """

    def __init__(self, products: Sequence[str], seed: int) -> None:
        names, self._of = np.unique(np.array(products, dtype=str), return_inverse=True)
        self.count = len(names)
        self._seed = seed

    def interval(
        self, columns: Floats, statistic: Callable[[Floats], Floats], level: float = LEVEL
    ) -> Interval:
        """Give the interval of a statistic of means or sums.

        Parameters
        ----------
        columns
            (value, column): what is summed over the values.
        statistic
            Takes (draw, column + 1) sums, the last of them the number of values; gives (draw,).
        level
            Share of draws within, widened for few products by Student's t (Hesterberg 2015, section 5.3).
        """
        found = self.intervals(columns, lambda sums: statistic(sums)[:, None], level)
        return found[0]

    def intervals(
        self, columns: Floats, statistics: Callable[[Floats], Floats], level: float = LEVEL
    ) -> list[Interval]:
        """Give the intervals of several statistics, (draw, statistic), of the same draws."""
        if self.count < 2:
            with np.errstate(divide="ignore", invalid="ignore"):  # asked only how many there are
                return [NO_INTERVAL] * statistics(np.ones((1, columns.shape[1] + 1))).shape[1]
        from scipy.special import ndtr, stdtrit

        sums = np.zeros((self.count, columns.shape[1] + 1))
        np.add.at(sums, self._of, np.column_stack([columns, np.ones(len(columns))]))
        rng = np.random.default_rng([self._seed, self.count])
        block = max(_AT_ONCE // self.count, 1)
        drawn = []
        for first in range(0, RESAMPLES, block):
            rows = min(block, RESAMPLES - first)
            weights = rng.multinomial(self.count, np.full(self.count, 1.0 / self.count), size=rows)
            with np.errstate(divide="ignore", invalid="ignore"):
                drawn.append(statistics(np.asarray(weights @ sums)))
        widen = math.sqrt(self.count / (self.count - 1.0))
        tail = float(ndtr(widen * stdtrit(self.count - 1.0, 0.5 * (1.0 - level))))
        return [_ends(column, tail) for column in np.concatenate(drawn).T]


def mean_of(sums: Floats) -> Floats:
    """Give the mean of the first column."""
    return np.asarray(sums[:, 0] / sums[:, -1])


def wilson(right: int, n: int, level: float = LEVEL) -> Interval:
    """Give the interval of a share by its score (Wilson 1927): honest near 0 and 1, and for few."""
    if n == 0:
        return NO_INTERVAL
    from scipy.special import ndtri

    z = float(ndtri(0.5 * (1.0 + level)))
    share, room = right / n, z * z / n
    middle = (share + 0.5 * room) / (1.0 + room)
    half = math.sqrt(room * (share * (1.0 - share) + 0.25 * room)) / (1.0 + room)
    return Interval(max(middle - half, 0.0), min(middle + half, 1.0))


def _ends(drawn: Floats, tail: float) -> Interval:
    known = drawn[np.isfinite(drawn)]
    if not known.size:
        return NO_INTERVAL
    low, high = np.quantile(known, (tail, 1.0 - tail)).tolist()
    return Interval(low, high)
