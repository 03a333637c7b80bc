"""Sub-pixel crossings of image rows by stripes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Checker, Floats, Integers
from roemetry.records.reasons import Reason

SATURATED = 1
EDGE = 2
WIDE = 4


@dataclass(frozen=True, eq=False, slots=True)
class Peaks:
    """Where stripes cross image rows, sorted by row, then by x.

    Attributes
    ----------
    image_size
        Rows and columns of the frame.
    row
        (peak,) image row.
    x_px
        (peak,) position along the row, px, pixel centres are whole numbers.
    x_std_px
        (peak,) standard uncertainty of `x_px`, px; NaN where it is not modelled.
    amplitude
        (peak,) height above the background, grey levels.
    background
        (peak,) grey level beside the stripe.
    width_px
        (peak,) full width at half of the amplitude, px.
    flags
        (peak,) sum of `SATURATED`, `EDGE` (too near the image border), `WIDE` (wider than a stripe is).
    correlation_rows
        How far the errors of `x_px` reach along a stripe: the standard deviation, rows, of the Gaussian that
        white noise would have to be smoothed with to have their autocorrelation exp(−Δ²/(4ℓ²)); 0 where
        rows err independently.
    reasons
        What a reader of the numbers must know about the extraction.
    row_start
        (row + 1,) where each row's peaks begin: those of row r are ``row_start[r]:row_start[r + 1]``.
    """

    image_size: tuple[int, int]
    row: Integers
    x_px: Floats
    x_std_px: Floats
    amplitude: Floats
    background: Floats
    width_px: Floats
    flags: NDArray[np.uint8]
    correlation_rows: float = 0.0
    reasons: tuple[Reason, ...] = ()
    row_start: Integers = field(init=False)

    def __post_init__(self) -> None:
        check = Checker(self)
        row = check.array("row", np.int64, (None,))
        n = row.shape[0] if row.ndim == 1 else 0
        x_px = check.array("x_px", np.float64, (n,))
        for name in ("x_std_px", "amplitude", "background", "width_px"):
            check.array(name, np.float64, (n,))
        check.array("flags", np.uint8, (n,))
        check.require(self.correlation_rows >= 0, "correlation_rows is negative")
        rows, columns = self.image_size
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
        start = np.searchsorted(row, np.arange(rows + 1))
        start.flags.writeable = False
        object.__setattr__(self, "row_start", start)

    def __len__(self) -> int:
        return int(self.row.shape[0])
