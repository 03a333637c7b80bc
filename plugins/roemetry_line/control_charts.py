"""Control charts of a figure of a line's products: means by hour, and a moving mean by product.

Control limits come from the data itself, by the usual rules (Montgomery, Introduction to Statistical
Quality Control; ISO 7870-2, 7870-6):

- standard deviation within: mean of the moving ranges of two successive products over 1.128;
- means by hour: overall mean ± 3 σ / √n, n products in the hour;
- EWMA by product, z_i = λ x_i + (1 − λ) z_(i−1): overall mean ± L σ √(λ / (2 − λ) · (1 − (1 − λ)^(2i))), λ
= 0.2 and
  L = 2.86, which gives a false alarm in 370 products on average.

Products on a line are not made alike: a chart that is out of control says that the product, or the
instrument, has changed, and not which. Assumed: successive products are independent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_LAMBDA, _WIDE = 0.2, 2.86
FEWEST = 10
"""Fewer products give no limits."""
_D2 = 1.128
"""Mean range of two normal values over their standard deviation."""


@dataclass(frozen=True, slots=True)
class Chart:
    """A figure's control chart."""

    figure: str
    count: int
    mean: float
    std_within: float
    """mean, std_within: over all products, and from product to product; NaN where there are too few."""
    hours: tuple[tuple[float, int, float, float], ...]
    """By hour: begin (s since 1970), products, mean, and how far the mean may be from the overall mean."""
    ewma: NDArray[np.float64]
    """(product,) moving mean."""
    ewma_limit: NDArray[np.float64]
    """(product,) how far it may be from the overall mean."""
    times_s: NDArray[np.float64]
    values: NDArray[np.float64]

    @property
    def words(self) -> str:
        """Give the figure's name and unit, as in "mass, g"."""
        name, _, unit = self.figure.rpartition("_")
        return f"{name}, {unit.replace('mm3', 'mm³')}"

    @property
    def said(self) -> str:
        """Say in a line what it shows."""
        if math.isnan(self.std_within):
            return f"{self.words}: {self.count} products, too few for a control chart ({FEWEST} or more)"
        return (
            f"{self.words}: {self.count} products, mean {self.mean:.6g}, from product to product "
            f"± {self.std_within:.3g}; out of control: {len(self.hours_out)} of {len(self.hours)} hours, the "
            f"moving mean (EWMA) at {len(self.ewma_out)} products"
        )

    @property
    def hours_out(self) -> list[float]:
        """Give the begins of the hours whose mean is out of control."""
        return [begin for begin, _, mean, limit in self.hours if abs(mean - self.mean) > limit]

    @property
    def ewma_out(self) -> NDArray[np.int64]:
        """Give the products at which the moving mean is out of control."""
        return np.flatnonzero(np.abs(self.ewma - self.mean) > self.ewma_limit)


def chart_of(figure: str, times_s: NDArray[np.float64], values: NDArray[np.float64]) -> Chart:
    """Make the control chart of (product,) values in the order of their (product,) times, s since 1970."""
    known = np.isfinite(values)
    times_s, values = times_s[known], values[known]
    count = len(values)
    none = np.full(count, math.nan)
    if count < FEWEST:
        mean = float(values.mean()) if count else math.nan
        return Chart(figure, count, mean, math.nan, (), none, none, times_s, values)
    mean, std = float(values.mean()), float(np.abs(np.diff(values)).mean() / _D2)
    begins = np.floor(times_s / 3600.0) * 3600.0
    hours = []
    for begin in np.unique(begins):
        inside = values[begins == begin]
        hours.append((float(begin), len(inside), float(inside.mean()), 3.0 * std / math.sqrt(len(inside))))
    ewma = np.empty(count)
    last = mean
    for i, value in enumerate(values):
        last = _LAMBDA * value + (1.0 - _LAMBDA) * last
        ewma[i] = last
    until = 1.0 - (1.0 - _LAMBDA) ** (2.0 * np.arange(1, count + 1))
    limit = _WIDE * std * np.sqrt(_LAMBDA / (2.0 - _LAMBDA) * until)
    return Chart(figure, count, mean, std, tuple(hours), ewma, limit, times_s, values)
