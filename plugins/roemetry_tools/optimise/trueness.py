"""How near recipes are to the truth over all products that are known, whether they were measured or not."""

from __future__ import annotations

import math
from collections import defaultdict

from roemetry.errors import DataError
from roemetry_tools.compare.aggregate import QUANTITIES, estimates_of
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.score import Scored
from roemetry_tools.compare.tables import WORDS
from roemetry_tools.compare.variants import Variant

_MISSING_PCT = 100.0
"""Error of a product that was not measured, and of any other at most: else who refuses what is difficult
would be the nearest.
"""


class Trueness:
    """Adds up the absolute errors of a quantity, by the number of the variant."""

    def __init__(self, field: str) -> None:
        self._field = field
        self._errors: defaultdict[int, list[float]] = defaultdict(list)
        self._missing: defaultdict[int, int] = defaultdict(int)

    def add(self, variant: Variant, scored: Scored) -> None:
        """Add what a variant made of an acquisition."""
        for pair in scored.pairs:
            true = math.nan if pair.true is None else getattr(pair.true, self._field)
            if not true > 0.0:
                continue
            estimates = estimates_of(pair)
            value = estimates[self._field]
            if self._field == "true_mm3" and value is None:
                value = estimates["visible_mm3"]
            measured = value is not None and math.isfinite(value)
            self._missing[variant.number] += not measured
            error = 100.0 * abs(value / true - 1.0) if measured and value is not None else _MISSING_PCT
            self._errors[variant.number].append(min(error, _MISSING_PCT))

    def of(self, number: int) -> tuple[float, int]:
        """Give the mean absolute error, %, NaN without any, and how many products were not measured."""
        errors = self._errors[number]
        return math.fsum(errors) / len(errors) if errors else math.nan, self._missing[number]


def field_of(data: Data, wanted: str | None) -> str:
    """Give the quantity to judge by: the one that is wanted, else the first that the data know.

    DataError where they know none, or not that one.
    """
    known = [
        name
        for name in QUANTITIES
        if any(
            getattr(product, name) > 0.0
            for unit in data.units()
            for product in (() if unit.item is None else unit.item.products)
        )
    ]
    if wanted in known:
        return wanted
    if wanted is not None or not known:
        what = "neither volume nor weight" if wanted is None else f"no {WORDS[wanted]}"
        raise DataError(
            f"nothing to search by: {data.without_truth or f'the data set knows {what} of any product'}",
            hint="name a data set with truth by --data, or another quantity by --by",
        )
    return known[0]
