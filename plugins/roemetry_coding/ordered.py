"""Stripe coding by order alone, row by row: the fastest, and as right as order is.

Model. On an opaque surface lit and seen from above stripes keep their order along a row. Where a row shows
every stripe and the surface goes on from each to the next, order decides. Else the labels k of the row's
peaks are those of least cost, with labels rising from left to right and heights z within range:

    Σ min(|z_i − z_j|, 1) + 0.6 · stripes left out + 1.6 · peaks left out − 0.3 · peaks on their rest line

over peaks i, j side by side, where z counts in label heights (what displaces a stripe by one spacing).
Dynamic programming, forwards and backwards, finds it exactly; a peak's margin is by how much the best row in
which it has another verdict is dearer. Peaks that stand alone along their stripe are refused.

Assumed: an image row is nearly an epipolar line, and rows are independent. It fails where a stripe is hidden
on a body whose stripes on either side lie about a label height apart: two numberings then cost nearly the
same, and whole runs may be wrong; and a flat top one label height high with a hidden stripe beside it is
taken for bare belt. `planes` looks at all rows at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, Peaks, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Coder
from roemetry_kernels.bridging import BridgingOptions, bridged
from roemetry_kernels.compiling import inlined, kernel
from roemetry_kernels.consistency import refuse_bare_lines, refuse_uncodable, required_calibration
from roemetry_kernels.rest_lines import calibrated_rest_lines, missing_stripes, reasons_of


class OrderedOptions(BridgingOptions):
    """Gaps, sizes and doubt."""

    margin_min: float = Field(
        default=0.2, ge=0, le=1, description="peaks with a smaller margin are refused as ambiguous"
    )


_LIVE_ROWS_MIN = 15  # rows with a peak on its rest line that show a stripe to be lit: fewer are stray peaks
_STEP_MAX_PX = 7.0  # px from row to row: half the paper's body window
_LABELLED_SHARE_MIN = 0.4  # of the peaks: where less finds a stripe, order alone does not explain the image


class Ordered(Coder[OrderedOptions]):
    """Aligns each row's peaks with the stripes, without looking at other rows."""

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame.

        Parameters
        ----------
        peaks
            From any extractor.
        calibration
            Gives rest lines, displacements and the range of heights; without it order has no beginning.

        Raises
        ------
        StageError
            No calibration; no peak at all; peaks of another image size than the calibration's; rest lines
            that cross, or with nothing on any of them; the belt's stripes more than a pixel beside them;
            fewer than two peaks in five in an order that stripes can have.
        """
        refuse_uncodable(peaks, calibration)
        calibration = required_calibration(calibration, "ordered", "it tells which stripe a row begins with")
        rest = calibrated_rest_lines(peaks, calibration)
        # stripes without light on the belt are none that a row can lack
        live = rest.on_line >= _LIVE_ROWS_MIN
        refuse_bare_lines(bool(live.any()), live.size)
        low_mm, high_mm = calibration.height_range_mm
        stripe, dearer = order_rows(
            peaks.row_start,
            peaks.x_px,
            rest.by_row_px,
            live,
            calibration.displacement_px_per_mm,
            low_mm,
            high_mm,
            rest.tolerance_px,
        )
        labelled = refuse_doubtful(
            peaks.row,
            peaks.x_px,
            stripe,
            dearer,
            live.size,
            _STEP_MAX_PX,
            self.options.margin_min * DEAREST,
            AMBIGUOUS,
        )
        labelled /= len(peaks)
        if labelled < _LABELLED_SHARE_MIN:
            raise StageError(
                f"only {labelled:.0%} of the peaks are in an order that stripes can have: "
                "that is noise, not stripes",
                hint="raise the extractor's threshold, or look at the image",
            )
        margin: Floats = dearer / DEAREST
        return bridged(
            peaks,
            stripe,
            margin,
            rest,
            longest_gap_rows=self.options.longest_gap_rows,
            smallest_product_points=self.options.smallest_product_points,
            reasons=reasons_of(rest) + missing_stripes(np.flatnonzero(live), live.size),
        )


Places = NDArray[np.uint64]

_FAR = 1e9  # dearer than any path: none has been found yet
_STEP_MAX = 1.0
"""A step of the surface between two stripes costs at most this, in label heights."""
_SKIP = 0.6
"""A stripe that is not seen costs this."""
_FALSE = 1.6
"""A peak that is no stripe costs this."""
_REST = 0.3
"""A peak on the belt, on its own rest line, gains this."""
_LOOK_BACK = 3  # peaks before a peak that may be its neighbour: those between are false
DEAREST = 2.0 * _SKIP
"""A verdict is dearer than another by this at most: one stripe put in another place and one left out."""


@kernel
def order_rows(
    row_start: Integers,
    x_px: Floats,
    rest_by_row_px: Floats,
    live: Flags,
    px_per_mm: Floats,
    height_min_mm: float,
    height_max_mm: float,
    tolerance_px: float,
) -> tuple[Integers, Floats]:
    """Give each row's peaks strictly increasing stripes at the least cost.

    The cost, in heights that a displacement of one stripe spacing stands for: the surface's step from each
    peak to the next, up to one; for each stripe left out; for each peak left out; a gain on the belt.

    Parameters
    ----------
    row_start, x_px
        Peaks by row, px.
    rest_by_row_px
        (row, stripe) rest lines, px, increasing with the stripe.
    live
        (stripe,) False for stripes that are not there at all.
    px_per_mm
        (stripe,) displacement per height, px/mm.
    height_min_mm, height_max_mm
        Heights there may be, mm.
    tolerance_px
        How far from its rest line a peak still is belt, px.

    Returns
    -------
    tuple
        (peak,) stripe, −1 for a peak left out; and (peak,) cost by which the row would be dearer if this peak
        had another verdict.
    """
    # labels are the stripes that are there; a dead one takes no place in the order
    of_label = np.flatnonzero(live)
    labels = of_label.size
    most = 0
    for row in range(row_start.shape[0] - 1):
        most = max(most, row_start[row + 1] - row_start[row])
    stripe = np.full(x_px.shape[0], -1, np.int64)
    margin = np.zeros(x_px.shape[0])
    if labels == 0 or most == 0:
        return stripe, margin
    # Displacements there may be, and the way that higher points go: the same in every row.
    low, high, way = np.empty(labels), np.empty(labels), np.empty(labels)
    for i in range(labels):
        steep = px_per_mm[of_label[i]]
        one, other = steep * height_min_mm, steep * height_max_mm
        low[i], high[i] = min(one, other) - tolerance_px, max(one, other) + tolerance_px
        way[i] = 1.0 if steep > 0.0 else -1.0
    width = np.uint64(labels)
    height, own = np.empty(most * labels), np.empty(most * labels)
    forward, backward = np.empty(most * labels), np.empty(most * labels)
    first, after = np.empty(most, np.uint64), np.empty(most, np.uint64)
    skipped, false = np.arange(labels) * _SKIP, np.arange(most) * _FALSE  # by their number
    lines = _of_labels(rest_by_row_px, of_label)
    for row in range(row_start.shape[0] - 1):
        begin, at = row_start[row], row * labels
        count = row_start[row + 1] - begin
        # rows without peaks have nothing to say
        if count == 0:
            continue
        # mean distance of this row's lines: a step by so much is what a wrong label makes
        spacing = 1.0
        if labels > 1:
            spacing = (lines[at + labels - 1] - lines[at]) / (labels - 1)
        # nearly all rows of bare belt and of smooth bodies: no search is needed
        if count == labels and _in_full(
            x_px, np.uint64(begin), lines, np.uint64(at), np.uint64(count), low, high, way, 0.5 * spacing
        ):
            for k in range(np.uint64(count)):
                stripe[np.uint64(begin) + k] = of_label[k]
                margin[np.uint64(begin) + k] = DEAREST
            continue
        for k in range(np.uint64(count)):
            # A peak lies farther off to the right from each next line: what it may be stands in a row.
            x, beyond, upto = x_px[np.uint64(begin) + k], 0, 0
            for i in range(np.uint64(labels)):
                off = x - lines[np.uint64(at) + i]
                beyond += off > high[i]
                upto += off >= low[i]
            first[k], after[k] = beyond, max(beyond, upto)
            for i in range(first[k], after[k]):
                off = x - lines[np.uint64(at) + i]
                # displacement towards higher points, in label heights
                height[k * width + i] = way[i] * off / spacing
                own[k * width + i] = -_REST if abs(off) <= tolerance_px else 0.0
        _least(height, own, first, after, count, labels, skipped, false, forward, backward)
        _verdicts(
            forward, backward, own, first, after, count, labels, of_label, np.uint64(begin), stripe, margin
        )
    return stripe, margin


@inlined
def _of_labels(rest_by_row_px: Floats, of_label: Integers) -> Floats:
    """Give the rest lines of the stripes that are there, row after row."""
    if of_label.size == rest_by_row_px.shape[1]:
        return rest_by_row_px.reshape(-1)
    return rest_by_row_px[:, of_label].copy().reshape(-1)


@inlined
def _in_full(
    x_px: Floats, begin: int, lines: Floats, at: int, count: int, low: Floats, high: Floats, way: Floats,
    step_px: float,
) -> bool:  # fmt: skip
    """Say whether all stripes are there and the surface goes from each to the next without a large step."""
    # All are looked at, also after one that is not: a branch at each would be guessed wrong.
    other: Any = np.uint64(0)
    # bodies and belt alike: what counts is the change from stripe to stripe
    before = way[0] * (x_px[begin] - lines[at])
    for k in range(count):
        off = x_px[begin + k] - lines[at + k]
        towards = way[k] * off
        other |= np.uint64(off < low[k]) | np.uint64(off > high[k])
        other |= np.uint64(abs(towards - before) > step_px)
        before = towards
    whole: bool = other == 0
    return whole


@inlined
def _least(
    height: Floats, own: Floats, first: Places, after: Places, count: int, labels: int,
    skipped: Floats, false: Floats, forward: Floats, backward: Floats,
) -> None:  # fmt: skip
    """Write the least cost of all up to, and from, each peak with each stripe, both with its own.

    Stripes that a peak may be are those from `first` up to `after`.
    """
    zero, one, look_back, width = np.uint64(0), np.uint64(1), np.uint64(_LOOK_BACK), np.uint64(labels)
    peaks = np.uint64(count)
    k: Any
    for k in range(peaks):
        for i in range(first[k], after[k]):
            here = height[k * width + i]
            # as the row's first: all stripes and peaks before it are left out
            best = skipped[i] + false[k]
            for q in range(k - look_back if k > look_back else zero, k):
                for j in range(first[q], min(after[q], i)):
                    # a step costs its size, up to a broken surface; stripes and peaks between are left out
                    step = min(abs(here - height[q * width + j]), _STEP_MAX)
                    left_out = skipped[i - j - one] + false[k - q - one]
                    best = min(best, forward[q * width + j] + step + left_out)
            forward[k * width + i] = best + own[k * width + i]
    for done in range(peaks):
        k = peaks - one - done
        for i in range(first[k], after[k]):
            here = height[k * width + i]
            best = skipped[width - one - i] + false[peaks - one - k]
            for q in range(k + one, min(peaks, k + one + look_back)):
                for j in range(max(first[q], i + one), after[q]):
                    step = min(abs(here - height[q * width + j]), _STEP_MAX)
                    left_out = skipped[j - i - one] + false[q - k - one]
                    best = min(best, backward[q * width + j] + step + left_out)
            backward[k * width + i] = best + own[k * width + i]


@inlined
def _verdicts(
    forward: Floats, backward: Floats, own: Floats, first: Places, after: Places, count: int, labels: int,
    of_label: Integers, begin: int, stripe: Integers, margin: Floats,
) -> None:  # fmt: skip
    """Walk back along the cheapest row, and compare each of its peaks with the next best verdict."""
    # no peak labelled at all
    whole = labels * _SKIP + count * _FALSE
    width = np.uint64(labels)
    for k in range(np.uint64(count)):
        for i in range(first[k], after[k]):
            at = k * width + i
            whole = min(whole, forward[at] + backward[at] - own[at])
    for k in range(np.uint64(count)):
        mine: Any = -1
        best, second = _FAR, _FAR
        for i in range(first[k], after[k]):
            at = k * width + i
            cost = forward[at] + backward[at] - own[at]
            if cost < best:
                best, second, mine = cost, best, np.int64(i)
            else:
                second = min(second, cost)
        # only peaks on the cheapest path; elsewhere the cheapest stripe of a peak may be of another path
        if mine >= 0 and best <= whole + 1e-9:
            stripe[begin + k] = of_label[mine]
            margin[begin + k] = min(second - best, DEAREST)


@kernel
def refuse_doubtful(
    row: Integers, x_px: Floats, stripe: Integers, dearer: Floats, stripes: int, step_max_px: float,
    dearer_min: float, refused: int,
) -> int:  # fmt: skip
    """Refuse labelled peaks that another verdict suits as well or that stand alone; gives how many are left.

    Parameters
    ----------
    row, x_px, stripe
        (peak,) sorted by row; `stripe` below 0 is not labelled; changed.
    dearer
        (peak,) see `order_rows`.
    stripes
        Number of stripes.
    step_max_px
        A peak stands alone without a peak of its stripe within the next three rows up or down, not farther
        away than this from row to row, px.
    dearer_min
        Another verdict suits as well if it is dearer by less.
    refused
        What is written for a refused peak.
    """
    # the last peak of each stripe: within three rows it bears the next one out
    last = np.full(stripes, -1, np.int64)
    found = np.zeros(row.shape[0], np.bool_)
    for p in range(row.shape[0]):
        s = stripe[p]
        if s < 0:
            continue
        q = last[s]
        if q >= 0 and 0 < row[p] - row[q] <= 3 and abs(x_px[p] - x_px[q]) <= step_max_px * (row[p] - row[q]):
            found[p] = found[q] = True
        last[s] = p
    labelled = 0
    for p in range(row.shape[0]):
        if stripe[p] >= 0 and not (found[p] and dearer[p] >= dearer_min):
            stripe[p] = refused
        labelled += stripe[p] >= 0
    return labelled
