"""Coded stripes: which plane of light made each peak, and whether it lies on belt or product."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.records.arrays import Checker, Flags, Floats, Labels
from roemetry.records.reasons import Reason

BELT = 0
NOTHING = -1

UNCODED = -1
AMBIGUOUS = -2


@dataclass(frozen=True, eq=False, slots=True)
class StripeMap:
    """Peaks with their stripe, dense over (stripe, row); stripes count from 0, left to right on the belt.

    Attributes
    ----------
    x_px
        (stripe, row) position along the row, px; NaN where nothing is known.
    x_std_px
        (stripe, row) standard uncertainty of `x_px`, px; NaN where it is not modelled.
    product
        (stripe, row) `BELT` (0), a product's number (1…n), or `NOTHING` (−1) where `x_px` is NaN.
    seen
        (stripe, row) True where a peak was seen, False where `x_px` is bridged or NaN.
    margin
        (stripe, row) how much better this label is than the second best, 0 (no better) to 1 (no other is
        possible); NaN where it is not modelled.
    ambiguous
        (stripe, row) True where a peak may belong to this stripe but may as well belong to another: `x_px`
        is NaN there unless the stripe has another, certain peak in that row.
    rest_px
        (stripe, row) where the stripe would lie on the bare belt, px; NaN where no rest line is known.
    peak_stripe
        (peak,) stripe of each peak of the `Peaks` this was made from; `UNCODED` (−1) for what is no stripe,
        `AMBIGUOUS` (−2) for what may be several.
    reasons
        What a reader of the numbers must know about the coding.
    correlation_rows
        How far the errors of `x_px` reach along a stripe: the standard deviation, rows, of the Gaussian that
        white noise would have to be smoothed with to have their autocorrelation exp(−Δ²/(4ℓ²)); 0 where
        rows err independently.
    """

    x_px: Floats
    x_std_px: Floats
    product: Labels
    seen: Flags
    margin: Floats
    ambiguous: Flags
    rest_px: Floats
    peak_stripe: Labels
    reasons: tuple[Reason, ...] = ()
    correlation_rows: float = 0.0

    def __post_init__(self) -> None:
        check = Checker(self)
        x_px = check.array("x_px", np.float64, (None, None))
        shape = x_px.shape if x_px.ndim == 2 else (0, 0)
        for name in ("x_std_px", "margin", "rest_px"):
            check.array(name, np.float64, shape)
        product = check.array("product", np.int16, shape)
        seen = check.array("seen", np.bool_, shape)
        check.array("ambiguous", np.bool_, shape)
        check.array("peak_stripe", np.int16, (None,))
        check.require(self.correlation_rows >= 0, "correlation_rows is negative")
        if x_px.shape == product.shape == seen.shape:
            empty = np.isnan(x_px)
            unlike = np.count_nonzero((product == NOTHING) != empty)
            check.require(unlike == 0, "product is −1 exactly where x_px is NaN")
            check.require(np.count_nonzero(seen & empty) == 0, "seen where x_px is NaN")
        check.finish()

    @property
    def stripe_count(self) -> int:
        """Number of stripes."""
        return int(self.x_px.shape[0])

    @property
    def rows(self) -> int:
        """Number of image rows."""
        return int(self.x_px.shape[1])
