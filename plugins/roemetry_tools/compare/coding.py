"""A coder's labels against true stripes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roemetry.records import AMBIGUOUS, Peaks, StripeMap, StripeTruth
from roemetry.records.arrays import Flags
from roemetry_tools.compare.points import nearest


@dataclass(frozen=True, slots=True)
class CodingScore:
    """What became of the true points on products, and wrong labels anywhere; scores of images add up.

    Attributes
    ----------
    visible
        True points on products, lit and seen. The four that follow add up to it.
    right
        With a seen point of their own stripe, to which they are the nearest true centre, within 3 px.
    wrong
        Not right, and with a seen point of another stripe, to which they are the nearest.
    refused
        With a peak within 3 px, which the coder gave to no stripe.
    unseen
        Without any peak within 3 px.
    ambiguous
        Of the refused, those whose peak was called ambiguous.
    wrong_points
        Seen points, on products and belt, whose nearest true centre within 3 px is another stripe's.
    longest_wrong_run
        Most of these in rows that follow each other on one stripe.
    """

    visible: int = 0
    right: int = 0
    wrong: int = 0
    refused: int = 0
    unseen: int = 0
    ambiguous: int = 0
    wrong_points: int = 0
    longest_wrong_run: int = 0

    def __add__(self, other: CodingScore) -> CodingScore:
        return CodingScore(
            self.visible + other.visible,
            self.right + other.right,
            self.wrong + other.wrong,
            self.refused + other.refused,
            self.unseen + other.unseen,
            self.ambiguous + other.ambiguous,
            self.wrong_points + other.wrong_points,
            max(self.longest_wrong_run, other.longest_wrong_run),
        )


def score_coding(stripes: StripeMap, peaks: Peaks, truth: StripeTruth) -> CodingScore:
    """Score the coding of one image.

    Parameters
    ----------
    stripes
        What the coder said; as many stripes as `truth` has, counted alike.
    peaks
        What it was given.
    truth
        What is true, in the same image.
    """
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
