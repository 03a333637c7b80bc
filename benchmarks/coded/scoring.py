"""What a coder said against what is true, peak by peak."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from benchmarks.coded.samples import Sample
from roemetry.records import AMBIGUOUS, StripeMap
from roemetry.records.arrays import Integers
from roemetry_tools.compare.stripes import REACH_PX, longest_run, nearest

_TALL_MM = 1.0


@dataclass(frozen=True)
class Score:
    """Counts, which add up over samples; wrong means the nearest true centre within 3 px is another's."""

    visible: int = 0
    """True crossings on products, lit and seen, whether or not a peak of them is left."""
    unseen: int = 0
    """Of these, without a peak within 3 px."""
    right: int = 0
    mistaken: int = 0
    refused: int = 0
    """right, mistaken, refused: of the others: their peak carries their number; another's; none."""
    ambiguous: int = 0
    """Of the refused, called ambiguous."""
    labelled: int = 0
    """All peaks, of product and belt, that were given a number and lie within 3 px of a true centre."""
    wrong: int = 0
    """Of these, wrong."""
    shared: int = 0
    """Of the wrong, with light of the stripe whose number they carry within 6 px: two stripes, one peak."""
    invented: int = 0
    """Peaks with a number and no true centre within 3 px."""
    as_belt: int = 0
    """Product points at least 1 mm high with the right number, taken for belt."""
    as_product: int = 0
    """Points of the belt with the right number, taken for product."""
    longest_wrong_run: int = 0
    """Rows that follow each other on one stripe, all wrong; the largest counts."""
    products: int = 1
    products_wrong: int = 0
    """products, products_wrong: samples; samples with a wrong run of more than 3 rows."""
    frames_refused: int = 0
    """Samples that the coder refused as a whole."""

    def __add__(self, other: Score) -> Score:
        sums = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)}
        sums["longest_wrong_run"] = max(self.longest_wrong_run, other.longest_wrong_run)
        return Score(**sums)

    @property
    def labelled_share(self) -> float:
        """Share with a number, of the product's points that have a peak."""
        return (self.right + self.mistaken) / max(self.visible - self.unseen, 1)

    @property
    def wrong_share(self) -> float:
        """Wrong, of all peaks with a number, on product and belt."""
        return self.wrong / max(self.labelled, 1)


def score(stripes: StripeMap | None, sample: Sample, least_margin: float = 0.0) -> Score:
    """Score a coder's answer; None is a frame that was refused.

    Parameters
    ----------
    stripes
        What the coder said.
    sample
        What it was given.
    least_margin
        Labels with less margin are taken as refused.
    """
    true, peaks = sample.crossings, sample.peaks
    at = nearest(true.row, true.x_px, peaks.row, peaks.x_px)  # peak of each crossing
    seen = true.on_product & (at >= 0)
    counts = {"visible": int(true.on_product.sum()), "unseen": int((true.on_product & (at < 0)).sum())}
    if stripes is None:
        return Score(**counts, refused=int(seen.sum()), frames_refused=1)
    given, said = verdicts(stripes, sample, least_margin)
    of = nearest(peaks.row, peaks.x_px, true.row, true.x_px)  # crossing of each peak
    known = of >= 0
    is_wrong = known & (given >= 0) & (true.stripe[of] != given)
    is_right = known & (given >= 0) & (true.stripe[of] == given)
    on_product = known & true.on_product[of]
    refused = seen & (given[at] < 0)
    point_right = seen & (given[at] == true.stripe)
    map_wrong = np.zeros(stripes.seen.shape, np.bool_)
    map_wrong[given[is_wrong], peaks.row[is_wrong]] = True
    run = max((longest_run(line) for line in map_wrong), default=0)
    product = np.full(given.size, -1, np.int64)
    product[given >= 0] = stripes.product[given[given >= 0], peaks.row[given >= 0]]
    tall = on_product & (true.xyz_mm[of, 2] >= _TALL_MM)
    return Score(
        **counts,
        right=int(point_right.sum()),
        mistaken=int((seen & ~refused & ~point_right).sum()),
        refused=int(refused.sum()),
        ambiguous=int((refused & (said[at] == AMBIGUOUS)).sum()),
        labelled=int((known & (given >= 0)).sum()),
        wrong=int(is_wrong.sum()),
        shared=_shared(given, np.flatnonzero(is_wrong), sample),
        invented=int((~known & (given >= 0)).sum()),
        as_belt=int((tall & is_right & (product == 0)).sum()),
        as_product=int((known & ~on_product & is_right & (product > 0)).sum()),
        longest_wrong_run=run,
        products_wrong=int(run > 3),
    )


def _shared(given: Integers, wrong: Integers, sample: Sample) -> int:
    """Count the wrong peaks near which the stripe of their number is, too."""
    true, peaks, count = sample.crossings, sample.peaks, 0
    for k in wrong:
        own = (true.row == peaks.row[k]) & (true.stripe == given[k])
        count += bool((np.abs(true.x_px[own] - peaks.x_px[k]) <= 2.0 * REACH_PX).any())
    return count


def verdicts(stripes: StripeMap, sample: Sample, least_margin: float = 0.0) -> tuple[Integers, Integers]:
    """Give each peak's number (−1 for none), and what the coder said of it, `AMBIGUOUS` included."""
    said = stripes.peak_stripe.astype(np.int64)
    given = np.maximum(said, -1)
    if least_margin > 0.0:
        has = given >= 0
        margin = np.full(given.size, np.nan)
        margin[has] = stripes.margin[given[has], sample.peaks.row[has]]
        given = np.where(margin < least_margin, -1, given)
    return given, said
