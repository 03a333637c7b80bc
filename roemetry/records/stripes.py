"""Where stripes cross image rows, and which plane of light made each crossing, on belt or product."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Checker, Flags, Floats, Integers, Labels
from roemetry.records.display import Shown
from roemetry.records.light import Dots
from roemetry.records.reasons import Reason

SATURATED = 1
EDGE = 2
WIDE = 4


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Peaks(Shown):
    """Where stripes cross image rows, sorted by row, then by x."""

    image_size: tuple[int, int]
    row: Integers
    x_px: Floats
    """(peak,) position along the row, px, pixel centres are whole numbers."""
    x_std_px: Floats
    """(peak,) standard uncertainty of `x_px`, px; NaN where it is not modelled."""
    amplitude: Floats
    """(peak,) height above the background, grey levels."""
    background: Floats
    """(peak,) grey level beside the stripe."""
    width_px: Floats
    """(peak,) full width at half of the amplitude, px."""
    flags: NDArray[np.uint8]
    """(peak,) sum of `SATURATED`, `EDGE` (too near the image border), `WIDE` (wider than a stripe is)."""
    correlation_rows: float = 0.0
    """How far the errors of `x_px` reach along a stripe: the standard deviation, rows, of the Gaussian that
    white noise would have to be smoothed with to have their autocorrelation exp(−Δ²/(4ℓ²)); 0 where rows
    err independently."""
    reasons: tuple[Reason, ...] = ()
    """What a reader of the numbers must know about the extraction."""
    dots: Dots | None = None
    """(peak,) of dots, each in the row its centre lies in; None: peaks of lines, in the middle of a row."""
    across: Peaks | None = None
    """Of a grid: peaks of the lines across, in the image turned by 90° counter-clockwise, where they cross
    rows as other lines do; None: there is one family of lines."""
    family: Integers | None = None
    """(peak,) of lines in two families that stand between each other, by colour: 0 of the first line's
    and every second one's, 1 of the others'; None: there is one family, or it is not known."""
    row_start: Integers = field(init=False)
    """(row + 1,) where each row's peaks begin: those of row r are ``row_start[r]:row_start[r + 1]``."""

    def __post_init__(self) -> None:
        check = Checker(self)
        row = check.array("row", np.int64, (None,))
        n = row.shape[0] if row.ndim == 1 else 0
        x_px = check.array("x_px", np.float64, (n,))
        for name in ("x_std_px", "amplitude", "background", "width_px"):
            check.array(name, np.float64, (n,))
        check.array("flags", np.uint8, (n,))
        check.require(self.correlation_rows >= 0, "correlation_rows is negative")
        check.require(self.dots is None or self.dots.y_px.shape == (n,), "dots and x_px differ in number")
        if self.family is not None:
            check.array("family", np.int64, (n,))
        rows, columns = self.image_size
        turned = self.across is None or self.across.image_size == (columns, rows)
        check.require(turned, "peaks across are not those of the turned image")
        if row.ndim == 1 and x_px.shape == row.shape and n:
            check.require(bool(row[0] >= 0 and row[-1] < rows), f"row is outside 0…{rows - 1}")
            before, after = row[:-1], row[1:]
            in_order = (after > before) | ((after == before) & (x_px[1:] > x_px[:-1]))
            check.require(bool(in_order.all()), "peaks are not sorted by row, then x")
            check.require(
                bool(x_px.min() >= -0.5 and x_px.max() <= columns - 0.5),
                f"x_px is outside −0.5…{columns - 0.5}, or not a number",
            )
        check.finish()
        start = np.zeros(rows + 1, np.int64)
        np.cumsum(np.bincount(row, minlength=rows), out=start[1:])
        start.flags.writeable = False
        object.__setattr__(self, "row_start", start)

    def __len__(self) -> int:
        return int(self.row.shape[0])

    def some(self, which: Integers | Flags, **changed: Any) -> Peaks:
        """Give some of the peaks of lines, by their numbers or a mask; `changed` fields instead of theirs.

        `across`, a grid's other family, stays whole. Not for dots, which have covariances of their own.
        """
        names = ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags")
        kept = {name: getattr(self, name)[which] for name in names}
        family = None if self.family is None else self.family[which]
        return replace(self, **{**kept, "family": family, **changed})


BELT = 0
NOTHING = -1

UNLABELLED = -1
AMBIGUOUS = -2


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class StripeMap(Shown):
    """Peaks with their stripe, dense over (stripe, row); stripes count from 0, left to right on the belt."""

    x_px: Floats
    """(stripe, row) position along the row, px; NaN where nothing is known."""
    x_std_px: Floats
    """(stripe, row) standard uncertainty of `x_px`, px; NaN where it is not modelled."""
    product: Labels
    """(stripe, row) `BELT` (0), a product's number (1…n), or `NOTHING` (−1) where `x_px` is NaN."""
    seen: Flags
    """(stripe, row) True where a peak was seen, False where `x_px` is bridged or NaN."""
    margin: Floats
    """(stripe, row) how much better this label is than the second best, 0 (no better) to 1 (no other is
    possible); NaN where it is not modelled."""
    ambiguous: Flags
    """(stripe, row) True where a peak may belong to this stripe but may as well belong to another: `x_px` is
    NaN there unless the stripe has another, certain peak in that row."""
    rest_px: Floats
    """(stripe, row) where the stripe would lie on the bare belt, px; NaN where no rest line is known."""
    peak_stripe: Labels
    """(peak,) stripe of each peak of the `Peaks` this was made from; `UNLABELLED` (−1) for what is no stripe,
    `AMBIGUOUS` (−2) for what may be several."""
    reasons: tuple[Reason, ...] = ()
    correlation_rows: float = 0.0
    """How far the errors of `x_px` reach along a stripe: the standard deviation, rows, of the Gaussian that
    white noise would have to be smoothed with to have their autocorrelation exp(−Δ²/(4ℓ²)); 0 where rows
    err independently."""
    dots: Dots | None = None
    """(stripe, row) of dots, each in the row its centre lies in; None: the stripes are lines. `x_std_px` is
    then the error of x alone that moves the point as much as the whole error of the dot does."""
    across: StripeMap | None = None
    """Of a grid: the lines across, in the image turned by 90° counter-clockwise; None: there are none."""
    circles: bool = False
    """True where the stripes are left and right halves of circles: they end where rows do not tell where they
    are, also on a product."""

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
        check.require(self.dots is None or self.dots.y_px.shape == shape, "dots and x_px differ in shape")
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
