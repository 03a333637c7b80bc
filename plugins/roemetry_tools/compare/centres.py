"""An extractor's peaks against true stripe centres."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roemetry.records import Peaks, StripeTruth
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_tools.compare.points import REACH_PX, nearest

_BINS = 3000
_EDGES = np.linspace(-REACH_PX, REACH_PX, _BINS + 1)


def _no_counts() -> Integers:
    return np.zeros(_BINS, np.int64)


@dataclass(frozen=True, eq=False, slots=True)
class CentreScore:
    """How peaks lie beside true centres; scores of images add up.

    A peak and a true centre belong together if each is the other's nearest in the row, within 3 px.

    Attributes
    ----------
    true
        True centres looked for.
    matched
        Those that a peak belongs to.
    peaks
        Peaks found; on a part of the image only those that belong to a true centre.
    sum_px, sum_px2
        Sums of the errors, found minus true along the row, px, and of their squares, px².
    counts
        (bin,) errors counted in bins of 0.002 px from −3 to 3 px.
    """

    true: int = 0
    matched: int = 0
    peaks: int = 0
    sum_px: float = 0.0
    sum_px2: float = 0.0
    counts: Integers = field(default_factory=_no_counts)

    def __add__(self, other: CentreScore) -> CentreScore:
        return CentreScore(
            self.true + other.true,
            self.matched + other.matched,
            self.peaks + other.peaks,
            self.sum_px + other.sum_px,
            self.sum_px2 + other.sum_px2,
            self.counts + other.counts,
        )

    def quantile_px(self, share: float) -> float:
        """Give the error that this share of the errors lies below, px; NaN without errors."""
        if self.matched == 0:
            return float("nan")
        below = np.concatenate([[0], np.cumsum(self.counts)])
        filled = np.flatnonzero(np.diff(below))
        place = min(share * below[-1], float(below[-1]))
        one = int(filled[min(np.searchsorted(below[filled + 1], place), filled.size - 1)])
        part = (place - below[one]) / (below[one + 1] - below[one])
        return float(_EDGES[one] + part * (_EDGES[one + 1] - _EDGES[one]))


def score_centres(peaks: Peaks, truth: StripeTruth) -> tuple[CentreScore, CentreScore]:
    """Score the peaks of one image against all true centres, and against those on products alone.

    Parameters
    ----------
    peaks
        What was found.
    truth
        What is true, in the same image.
    """
    stripe, row = np.nonzero(np.isfinite(truth.x_px))
    x_px = truth.x_px[stripe, row]
    of_truth = nearest(row, x_px, peaks.row, peaks.x_px)
    of_peak = nearest(peaks.row, peaks.x_px, row, x_px)
    matched = of_truth >= 0
    matched[matched] = of_peak[of_truth[matched]] == np.flatnonzero(matched)
    error = peaks.x_px[of_truth[matched]] - x_px[matched]
    on_product = truth.on_product[stripe, row]
    return (
        _score(error, int(matched.size), len(peaks)),
        _part(error, on_product, matched),
    )


def _part(error: Floats, wanted: Flags, matched: Flags) -> CentreScore:
    mine = error[wanted[matched]]
    return _score(mine, int(wanted.sum()), int(mine.size))


def _score(error: Floats, true: int, peaks: int) -> CentreScore:
    counts = np.histogram(error, _EDGES)[0].astype(np.int64)
    return CentreScore(true, int(error.size), peaks, float(error.sum()), float((error**2).sum()), counts)
