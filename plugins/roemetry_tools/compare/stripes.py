"""Peaks, labels and products of one image beside the truth of its stripes, row by row.

A found point and a true centre of a stripe belong together where each is the other's nearest in its row,
within 3 px. From that follow how far an extractor's centres are off, what became of a coder's labels, and
which measured product is which true one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator

from roemetry.records import AMBIGUOUS, Frame, Peaks, Reason, StripeMap, StripeTruth
from roemetry.records.arrays import Flags, Floats, Integers

REACH_PX = 3.0
"""Farther than this from a stripe's true centre, px, a point is not taken for a point of that stripe."""


def truth_in(frame: Frame, truth: StripeTruth, turn_deg: int = 0) -> StripeTruth | Reason:
    """Give the truth, which is of the image turned by the data set's `turn_deg`, in the turned image.

    Or why that cannot be: half a turn maps centres of rows on centres of rows. A quarter makes rows of
    columns, and where a stripe crosses those is not in the truth.
    """
    rows, columns = frame.size
    further = (frame.turn_deg - turn_deg) % 360
    if further in (90, 270):
        return Reason(
            "truth-other-turn",
            f"the image is turned by {frame.turn_deg}°, and the truth of its stripes is given for the rows "
            f"of the image turned by {turn_deg}°, as the data set's turn_deg says",
        )
    if truth.x_px.shape[1] != rows:
        return Reason(
            "truth-other-size", f"the image has {rows} rows, the truth of its stripes {truth.x_px.shape[1]}"
        )
    if further == 0:
        return truth
    return StripeTruth(
        columns - 1 - truth.x_px[::-1, ::-1],
        truth.on_product[::-1, ::-1],
        truth.xyz_mm[::-1, ::-1],
        truth.product[::-1, ::-1],
    )


def nearest(row: Integers, x_px: Floats, other_row: Integers, other_x_px: Floats) -> Integers:
    """(point,) index of the nearest other point of its row within `REACH_PX`, −1 where there is none."""
    if row.size == 0 or other_row.size == 0:
        return np.full(row.shape, -1, np.int64)
    low = min(float(x_px.min()), float(other_x_px.min()))
    high = max(float(x_px.max()), float(other_x_px.max()))
    apart = high - low + 4.0 * REACH_PX  # rows laid end to end, so far apart that they cannot meet
    here, there = row * apart + x_px, other_row * apart + other_x_px
    order = np.argsort(there, kind="stable")
    place = np.searchsorted(there[order], here)
    left = order[np.clip(place - 1, 0, order.size - 1)]
    right = order[np.clip(place, 0, order.size - 1)]
    near = np.where(np.abs(there[left] - here) <= np.abs(there[right] - here), left, right)
    within = (other_row[near] == row) & (np.abs(other_x_px[near] - x_px) <= REACH_PX)
    return np.where(within, near, -1)


_BINS = 3000
"""Of the histogram of errors: 0.002 px wide, a tenth of the best extractor's scatter."""
_EDGES = np.linspace(-REACH_PX, REACH_PX, _BINS + 1)


def _counts(held: Sequence[Sequence[int]]) -> Integers:
    """(bin,) counts, from the bins that hold something and what they hold."""
    counts = np.zeros(_BINS, np.int64)
    place, number = np.array(held, np.int64).reshape(2, -1)
    counts[place] = number
    return counts


@dataclass(frozen=True, eq=False, slots=True)
class CentreScore:
    """How peaks lie beside true centres; scores of images add up.

    A peak and a true centre belong together if each is the other's nearest in the row, within 3 px.
    """

    true: int = 0
    """True centres looked for."""
    matched: int = 0
    """Those that a peak belongs to."""
    peaks: int = 0
    """Peaks found; on a part of the image only those that belong to a true centre."""
    sum_px: float = 0.0
    sum_px2: float = 0.0
    """sum_px, sum_px2: sums of the errors, found minus true along the row, px, and of their squares, px²."""
    counts: Annotated[NDArray[np.int64], PlainValidator(_counts)] = field(
        default_factory=lambda: np.zeros(_BINS, np.int64)
    )
    """(bin,) errors counted in bins of 0.002 px from −3 to 3 px."""

    def __add__(self, other: CentreScore) -> CentreScore:
        return CentreScore(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))

    @property
    def held(self) -> tuple[list[int], list[int]]:
        """Bins that hold something, of one image a tenth of all, and what they hold."""
        place = np.flatnonzero(self.counts)
        return place.tolist(), self.counts[place].tolist()

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel between processes with what the bins hold."""
        return _unpacked, (self.true, self.matched, self.peaks, self.sum_px, self.sum_px2, self.held)

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

    @property
    def robust_std_px(self) -> float:
        """Half of the middle 68 % of the errors, px."""
        return (self.quantile_px(0.84135) - self.quantile_px(0.15865)) / 2


def _unpacked(
    true: int, matched: int, peaks: int, sum_px: float, sum_px2: float, held: Sequence[Sequence[int]]
) -> CentreScore:
    return CentreScore(true, matched, peaks, sum_px, sum_px2, _counts(held))


def score_centres(peaks: Peaks, truth: StripeTruth) -> tuple[CentreScore, CentreScore]:
    """Score the peaks of one image against all true centres, and against those on products alone."""
    stripe, row = np.nonzero(np.isfinite(truth.x_px))
    x_px = truth.x_px[stripe, row]
    of_truth = nearest(row, x_px, peaks.row, peaks.x_px)
    of_peak = nearest(peaks.row, peaks.x_px, row, x_px)
    matched = of_truth >= 0
    matched[matched] = of_peak[of_truth[matched]] == np.flatnonzero(matched)
    error = peaks.x_px[of_truth[matched]] - x_px[matched]
    on_product = truth.on_product[stripe, row]
    mine = error[on_product[matched]]
    return (
        _score(error, int(matched.size), len(peaks)),
        _score(mine, int(on_product.sum()), int(mine.size)),
    )


def _score(error: Floats, true: int, peaks: int) -> CentreScore:
    counts = np.histogram(error, _EDGES)[0].astype(np.int64)
    return CentreScore(true, int(error.size), peaks, float(error.sum()), float((error**2).sum()), counts)


@dataclass(frozen=True, slots=True)
class CodingScore:
    """What became of the true points on products, and wrong labels anywhere; scores of images add up."""

    visible: int = 0
    """True points on products, lit and seen. The four that follow add up to it."""
    right: int = 0
    """With a seen point of their own stripe, to which they are the nearest true centre, within 3 px."""
    wrong: int = 0
    """Not right, and with a seen point of another stripe, to which they are the nearest."""
    refused: int = 0
    """With a peak within 3 px, which the coder gave to no stripe."""
    unseen: int = 0
    """Without any peak within 3 px."""
    ambiguous: int = 0
    """Of the refused, those whose peak was called ambiguous."""
    wrong_points: int = 0
    """Seen points, on products and belt, whose nearest true centre within 3 px is another stripe's."""
    longest_wrong_run: int = 0
    """Most of these in rows that follow each other on one stripe."""

    def __add__(self, other: CodingScore) -> CodingScore:
        added = {one.name: getattr(self, one.name) + getattr(other, one.name) for one in fields(self)}
        longest = max(self.longest_wrong_run, other.longest_wrong_run)
        return CodingScore(**{**added, "longest_wrong_run": longest})


def score_coding(stripes: StripeMap, peaks: Peaks, truth: StripeTruth) -> CodingScore:
    """Score the coding of one image; `stripes` are as many as `truth` has, counted alike."""
    true_stripe, true_row = np.nonzero(np.isfinite(truth.x_px))
    true_x_px = truth.x_px[true_stripe, true_row]
    stripe, row = np.nonzero(stripes.seen)
    near = nearest(row, stripes.x_px[stripe, row], true_row, true_x_px)
    known = near >= 0
    is_right = known & (true_stripe[near] == stripe)
    is_wrong = known & ~is_right
    right, wrong = np.zeros(true_row.size, np.bool_), np.zeros(true_row.size, np.bool_)
    right[near[is_right]] = True
    wrong[near[is_wrong]] = True
    peak = nearest(true_row, true_x_px, peaks.row, peaks.x_px)
    ambiguous = peak >= 0
    ambiguous[ambiguous] = stripes.peak_stripe[peak[ambiguous]] == AMBIGUOUS
    visible = truth.on_product[true_stripe, true_row]
    left = visible & ~right & ~wrong
    wrong_map = np.zeros(stripes.seen.shape, np.bool_)
    wrong_map[stripe[is_wrong], row[is_wrong]] = True
    return CodingScore(
        visible=int(visible.sum()),
        right=int((visible & right).sum()),
        wrong=int((visible & ~right & wrong).sum()),
        refused=int((left & (peak >= 0)).sum()),
        unseen=int((left & (peak < 0)).sum()),
        ambiguous=int((left & ambiguous).sum()),
        wrong_points=int(is_wrong.sum()),
        longest_wrong_run=max((longest_run(line) for line in wrong_map), default=0),
    )


def longest_run(mask: Flags) -> int:
    """Length of the longest run of True in a line."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def by_place(stripes: StripeMap, truth: StripeTruth) -> dict[int, int]:
    """Give the true product on which most of a measured one's points lie, by the measured one's number.

    Each of both at most once; more common points come first. Products without common points are missing.
    Which stripe a point was given to does not count.
    """
    row, true_row = np.indices(stripes.x_px.shape)[1], np.indices(truth.x_px.shape)[1]
    mine, theirs = (stripes.product > 0) & stripes.seen, truth.product > 0
    found = nearest(row[mine], stripes.x_px[mine], true_row[theirs], truth.x_px[theirs])
    near = found >= 0
    pairs = np.column_stack([stripes.product[mine][near], truth.product[theirs][found[near]]])
    if not pairs.size:
        return {}
    which, shared = np.unique(pairs, axis=0, return_counts=True)
    matched: dict[int, int] = {}
    for index in np.argsort(-shared, kind="stable"):
        measured, true = (int(number) for number in which[index])
        if measured not in matched and true not in matched.values():
            matched[measured] = true
    return matched
