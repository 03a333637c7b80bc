"""Coding of a single line: the brightest path through the peaks, with a belt or without one.

Model. One plane of light makes at most one peak a row; the others are reflections, lamps and glare. The line
is the path through the rows of least

    Σ (1 − a/a_row) + Σ step + Σ skipped rows,

where a is a peak's amplitude and a_row that of its row's brightest; a step costs its slope in units of 4 px
a row, up to that of a jump, for the line breaks at a product's edge; and a row may be left out. Dynamic
programming, forwards and backwards, gives the best path and, for each of its peaks, by how much the best path
through another peak of its row is dearer: its margin (as in `ordered`).

A calibration from a belt tells where the belt's line lies, and what lies beside it is product. Where there is
no belt (a turntable, a wall; `Calibration.reference`), or no calibration, all that is seen is one product.

Fails where a reflection is as bright as the line and as smooth for longer than the line is seen; then its
margin is small and it is refused.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, UNLABELLED, Peaks, StripeMap
from roemetry.records.arrays import Floats, Integers
from roemetry.records.calibration import ON_BELT, Calibration
from roemetry.stages import Capabilities, Coder
from roemetry_kernels.bridging import BridgingOptions, bridged
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.consistency import refuse_uncodable
from roemetry_kernels.rest_lines import calibrated_rest_lines, reasons_of, unknown_rest_lines

_LOOK_BACK_ROWS = 5
"""Longer gaps cost what a jump and the rows cost, wherever the line goes on."""
_STEEP_PX = 4.0
"""A line that moves by so much from row to row, 76° from upright, costs as much as one that is not seen."""
_JUMP = 1.5
"""A break of the line costs as much as one and a half rows on peaks that brighter ones outshine."""
_SKIP = 0.8
"""A row without the line: a peak of less than a fifth of its row's brightest is rather left out."""
_ROUNDED = 1e-5
"""Above what is rounded in a sum of costs, and far below what peaks differ by: of frames that lie one below
the other some 15,000 rows are left out, and their sums forwards and backwards come out 1e-8 apart."""
_LINE_ROWS_MIN = 10
"""Fewer are no line."""


class SingleOptions(BridgingOptions):
    """Gaps, sizes and doubt."""

    margin_min: float = Field(
        default=0.1, ge=0, le=1, description="peaks with a smaller margin are refused as ambiguous"
    )


class Single(Coder[SingleOptions]):
    """Follows one line through all rows."""

    capabilities = Capabilities(relative_numbers=True)  # of several stripes it follows one
    expected_failures = MappingProxyType(
        dict.fromkeys(
            (
                "check_a_dome_is_labelled_whole",
                "check_a_mirrored_rig_is_labelled_alike",
                "check_a_missing_stripe_shifts_nothing",
                "check_a_smooth_wedge_is_product",
                "check_a_grazed_tail_is_product",
                "check_what_is_not_seen_is_marked",
            ),
            "the kit's rig projects seven stripes, of which this coder follows one",
        )
        | dict.fromkeys(
            (
                "check_an_untouched_stripe_is_belt",
                "check_a_bare_belt_has_no_product",
                "check_rest_lines_are_the_calibrations",
            ),
            "without a calibration of its one line there is no belt",
        )
    )

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame.

        Parameters
        ----------
        peaks
            From any extractor.
        calibration
            Of one stripe, or None.

        Raises
        ------
        StageError
            The calibration has several stripes; no peak at all; peaks of another image size than the
            calibration's; fewer than ten rows show a line; the belt's line more than a pixel beside the
            calibrated one.
        """
        refuse_uncodable(peaks, calibration)
        if calibration is not None and calibration.stripe_count != 1:
            raise StageError(
                f"the calibration has {calibration.stripe_count} stripes, and `single` follows one",
                hint="choose ordered or planes for several stripes",
            )
        path, dearer = brightest_path(peaks.row_start, peaks.x_px, np.maximum(peaks.amplitude, 0.0))
        if path.sum() < _LINE_ROWS_MIN:
            # a straggler of some rows is no line
            raise StageError(
                f"a line is seen in {int(path.sum())} rows, {_LINE_ROWS_MIN} are the least",
                hint="lower the extractor's threshold, or look at the image: is the laser on?",
            )
        # a skipped row and a jump are the most that any other verdict costs
        margin = np.clip(dearer / (_SKIP + _JUMP), 0.0, 1.0)
        stripe = np.where(path, np.where(margin < self.options.margin_min, AMBIGUOUS, 0), UNLABELLED)
        # beside a belt all else is product; without one there is nothing to compare with
        on_belt = calibration is not None and calibration.reference == ON_BELT
        if calibration is not None and on_belt:
            rest = calibrated_rest_lines(peaks, calibration)
        else:
            rest = unknown_rest_lines(1, peaks)
        return bridged(
            peaks,
            stripe.astype(np.int64),
            np.asarray(margin),
            rest,
            longest_gap_rows=self.options.longest_gap_rows,
            smallest_product_points=self.options.smallest_product_points,
            reasons=reasons_of(rest),
        )

    def rows_apart(self) -> int:
        """Give the gap that is neither bridged nor looked across: one longer break."""
        return max(self.options.longest_gap_rows, _LOOK_BACK_ROWS) + 1


@float_kernel
def brightest_path(row_start: Integers, x_px: Floats, amplitude: Floats) -> tuple[Integers, Floats]:
    """Find the cheapest path through the rows.

    Parameters
    ----------
    row_start, x_px, amplitude
        Of the peaks: where each row's begin; px; grey levels, not below 0.

    Returns
    -------
    tuple
        (peak,) 1 on the path, else 0; and (peak,) by how much the best path through another peak of the row
        is dearer, at most a skipped row and a jump, for those on the path, else 0.
    """
    rows, count = row_start.size - 1, x_px.size
    own = np.empty(count)
    for row in range(rows):
        begin, end = row_start[row], row_start[row + 1]
        if begin == end:
            continue
        # never 0: a row of peaks without amplitude divides by it
        brightest = 1e-12
        for p in range(begin, end):
            brightest = max(brightest, amplitude[p])
        for p in range(begin, end):
            # 0 for the brightest of its row, whatever the row's exposure
            own[p] = 1.0 - amplitude[p] / brightest
    forward = _least(row_start, x_px, own, False)
    backward = _least(row_start, x_px, own, True)
    through = np.empty(count)
    for row in range(rows):
        for p in range(row_start[row], row_start[row + 1]):
            through[p] = forward[p] + backward[p] - own[p]
    best = through.min() if count else 0.0
    path, dearer = np.zeros(count, np.int64), np.zeros(count)
    for row in range(rows):
        begin, end = row_start[row], row_start[row + 1]
        mine = -1
        for p in range(begin, end):
            # within rounding of the best: sums forwards and backwards add in another order
            if through[p] <= best + _ROUNDED and mine < 0:
                mine = p
        if mine < 0:
            continue
        # leaving the row out is always possible
        second = best + _SKIP + _JUMP
        for p in range(begin, end):
            if p != mine:
                second = min(second, through[p])
        path[mine], dearer[mine] = 1, second - best
    return path, dearer


@float_kernel
def _least(row_start: Integers, x_px: Floats, own: Floats, backwards: bool) -> Floats:
    """Give for each peak the least cost of all rows up to it, itself included; backwards, from it on."""
    rows = row_start.size - 1
    cost, cheapest = np.empty(own.size), np.full(rows, np.inf)
    so_far = 0.0  # the least of any path that ends in a row before those looked back at, up to this row
    earlier = 0.0  # the same without the row before
    for done in range(rows):
        row = rows - 1 - done if backwards else done
        # from anywhere before: a jump
        jumped = so_far + (0.0 if done == 0 else _JUMP)
        for p in range(row_start[row], row_start[row + 1]):
            best = jumped
            for back in range(1, min(_LOOK_BACK_ROWS, done) + 1):
                if back == 2 and earlier + _SKIP - _ROUNDED >= best:
                    break  # nearly always: no path over an earlier row is as cheap
                other = row + back if backwards else row - back
                # not even the cheapest peak of that row, and a level step, would be better
                if cheapest[other] + (back - 1) * _SKIP >= best:
                    continue
                for q in range(row_start[other], row_start[other + 1]):
                    # slope over the rows between; capped, for an edge breaks the line
                    step = min(abs(x_px[p] - x_px[q]) / (back * _STEEP_PX), _JUMP)
                    best = min(best, cost[q] + step + (back - 1) * _SKIP)
            cost[p] = best + own[p]
        for p in range(row_start[row], row_start[row + 1]):
            cheapest[row] = min(cheapest[row], cost[p])
        # the best path so far either skips this row or ends in it
        least = min(so_far + _SKIP, cheapest[row])
        earlier, so_far = so_far, least
    return cost
