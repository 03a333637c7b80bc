"""Stripe coding by order alone, row by row: the fastest, and as right as order is.

On an opaque surface lit and seen from above stripes keep their order along a row. Where a row shows every
stripe, order decides. Where some are missing or some peaks are false, the cheapest alignment is taken: small
steps of the surface from stripe to stripe, few stripes left out, belt on its own rest line.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, Peaks, StripeMap
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry.stages import Coder
from roemetry_kernels.coding.bridging import BridgingOptions, bridged
from roemetry_kernels.coding.refusing import refuse_bare_lines, refuse_uncodable, required_calibration
from roemetry_kernels.coding.rest_lines import calibrated_rest_lines, missing_stripes, reasons_of
from roemetry_kernels.coding.row_order import DEAREST, order_rows, refuse_doubtful


class OrderedOptions(BridgingOptions):
    """Gaps, sizes and doubt."""

    margin_min: float = Field(
        default=0.2, ge=0, le=1, description="peaks with a smaller margin are refused as ambiguous"
    )


_LIVE_ROWS_MIN = 15
_STEP_MAX_PX = 7.0
_CODED_SHARE_MIN = 0.4


class Ordered(Coder[OrderedOptions]):
    """Aligns each row's peaks with the stripes, without looking at other rows."""

    Options = OrderedOptions

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
        coded = refuse_doubtful(
            peaks.row,
            peaks.x_px,
            stripe,
            dearer,
            live.size,
            _STEP_MAX_PX,
            self.options.margin_min * DEAREST,
            AMBIGUOUS,
        )
        coded /= len(peaks)
        if coded < _CODED_SHARE_MIN:
            raise StageError(
                f"only {coded:.0%} of the peaks are in an order that stripes can have: "
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
