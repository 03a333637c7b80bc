"""Local polynomials along each stripe: less noise, paid for in resolution."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import Field, field_validator

from roemetry.records import Reason, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.stages import Smoother, StageOptions

_OF_SECOND_DIFFERENCE = 0.6745 * math.sqrt(6.0)  # median size of white noise's second differences
_POINTS_MIN = 3


class LocalPolynomialOptions(StageOptions):
    """Options of `LocalPolynomial`."""

    rows: int = Field(
        default=9,
        ge=3,
        le=201,
        description="rows (odd) that a line is put through; so long is what is no longer resolved",
    )

    @field_validator("rows")
    @classmethod
    def _odd(cls, rows: int) -> int:
        if rows % 2 == 0:
            raise ValueError(f"rows is {rows}, expected an odd number")
        return rows


class LocalPolynomial(Smoother[LocalPolynomialOptions]):
    """Puts a line, bent as a wider window is, through the rows around each; stops at breaks and steps."""

    Options: ClassVar[type[StageOptions]] = LocalPolynomialOptions

    def smooth(self, stripes: StripeMap) -> StripeMap:
        """Smooth what was seen; bridged points and labels stay as they are."""
        from roemetry_kernels.extraction.along_stripe import smoothed_run

        rows = self.options.rows
        x_px, x_std_px = stripes.x_px.copy(), stripes.x_std_px.copy()
        before: list[Floats] = []
        after: list[Floats] = []
        steps = 0
        for stripe in range(stripes.stripe_count):
            own_px = _scatter_px(stripes.x_px[stripe])
            for at in _runs(stripes, stripe, rows):
                position = stripes.x_px[stripe, at]
                stated = stripes.x_std_px[stripe, at]
                std = np.where(stated > 0.0, stated, own_px)
                out, out_std = np.empty(at.size), np.empty(at.size)
                steps += smoothed_run(
                    at.astype(np.float64), position, std, rows, stripes.correlation_rows, out, out_std
                )
                x_px[stripe, at] = out
                x_std_px[stripe, at] = np.where(stated > 0.0, out_std, np.nan)
                before.append(std)
                after.append(out_std)
        if not before:
            return stripes
        kept = f"; {steps} steps kept" if steps else ""
        return replace(
            stripes,
            x_px=x_px,
            x_std_px=x_std_px,
            correlation_rows=_reach(np.concatenate(before), np.concatenate(after), stripes.correlation_rows),
            reasons=(
                *stripes.reasons,
                Reason(
                    "smoothed",
                    f"stripes are smoothed over {rows} rows: what is shorter along a stripe is not "
                    f"resolved{kept}",
                ),
            ),
        )


def _runs(stripes: StripeMap, stripe: int, rows: int) -> Iterator[Integers]:
    """Rows of each piece of a stripe that was seen, is one product or belt, and has no long gap."""
    seen = np.flatnonzero(stripes.seen[stripe])
    product = stripes.product[stripe, seen]
    breaks = np.flatnonzero((np.diff(product) != 0) | (np.diff(seen) > rows // 2)) + 1
    for run in np.split(seen, breaks):
        if run.size >= _POINTS_MIN:
            yield run


def _scatter_px(x_px: Floats) -> float:
    """Scatter of a stripe from its second differences, for points that state no uncertainty, px."""
    second = np.diff(x_px, 2)
    second = second[np.isfinite(second)]
    if not second.size:
        return 1.0
    return max(float(np.median(np.abs(second))) / _OF_SECOND_DIFFERENCE, 1e-6)


def _reach(before: Floats, after: Floats, length: float) -> float:
    """Correlation afterwards, rows: smoothing keeps the sum of the autocovariance and lowers the variance."""
    rows = np.arange(1, 1 + int(8 * length + 1))
    own = 1.0 + 2.0 * float(np.exp(-(rows**2) / (4.0 * length**2)).sum()) if length > 0.0 else 1.0
    left = float(np.median(after**2 / before**2))
    return max(own / left / (2.0 * math.sqrt(math.pi)), length) if left < 1.0 else length
