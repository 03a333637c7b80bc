"""Peaks against truth: errors, what was missed, what is not there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.extraction.drawing import Stripes
from roemetry.records.arrays import Floats

HIT_PX = 2.0


@dataclass(frozen=True)
class Found:
    """Positions that a method gave; `std_px` NaN where it states none."""

    row: Floats
    x_px: Floats
    std_px: Floats


@dataclass(frozen=True)
class Hits:
    """Errors and stated uncertainties at the (stripe, row) of the truth, NaN where missed; and the rest.

    A peak within 2 px of a lit stripe's centre is a hit; of several the nearest. All others are false. Rows
    inside a gap are neither missed nor found.
    """

    error_px: Floats
    std_px: Floats
    lit: int
    false: int

    @property
    def missed(self) -> int:
        """How many lit crossings have no peak."""
        return self.lit - int(np.isfinite(self.error_px).sum())


def hits(truth: Stripes, found: Found) -> Hits:
    """Match peaks to the truth; a method may give rows between whole ones."""
    rows = truth.x_px.shape[1]
    error = np.full(truth.x_px.shape, np.nan)
    std = np.full(truth.x_px.shape, np.nan)
    lit = int(truth.lit.sum())
    if not len(found.row):
        return Hits(error, std, lit, 0)
    row = np.clip(found.row, 0, rows - 1)
    below = np.minimum(np.floor(row).astype(int), max(rows - 2, 0))
    part = row - below
    above = np.minimum(below + 1, rows - 1)
    centre = truth.x_px[:, below] * (1.0 - part) + truth.x_px[:, above] * part
    off = found.x_px - centre
    stripe = np.abs(off).argmin(axis=0)
    off = off[stripe, np.arange(off.shape[1])]
    nearest_row = np.rint(row).astype(int)
    hit = np.flatnonzero((np.abs(off) <= HIT_PX) & truth.lit[stripe, nearest_row])
    hit = hit[np.argsort(-np.abs(off[hit]), kind="stable")]  # the nearest is written last, and stays
    error[stripe[hit], nearest_row[hit]] = off[hit]
    std[stripe[hit], nearest_row[hit]] = found.std_px[hit]
    return Hits(error, std, lit, len(found.row) - int(np.isfinite(error).sum()))


def rms(values: NDArray[np.float64]) -> float:
    """Give the root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
