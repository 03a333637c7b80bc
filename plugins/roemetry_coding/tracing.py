"""Stripe coding by tracing: each stripe is followed from the belt, over gaps, by direction and curvature.

Peaks are joined into traces by where the trace is going, not by where it was. Traces that end are joined to
those that begin where the first would have come. What then hangs together with belt has that belt's stripe;
what does not is numbered by order between the stripes that are known.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, Peaks, StripeMap
from roemetry.records.calibration import Calibration
from roemetry.stages import Coder
from roemetry_kernels.coding.bridging import BridgingOptions, bridged
from roemetry_kernels.coding.consistency import refuse_bare_lines, refuse_uncodable, required_calibration
from roemetry_kernels.coding.rest_lines import calibrated_rest_lines, missing_stripes, reasons_of
from roemetry_kernels.coding.trace_linking import coded_traces


class TracingOptions(BridgingOptions):
    """Gaps, sizes and doubt."""

    step_max_px: float = Field(
        default=3.5, gt=0, le=50, description="largest distance of a peak from where its trace was going, px"
    )
    longest_gap_rows: int = Field(
        default=20, ge=0, description="longest gap that a trace is followed over, and that is bridged, rows"
    )
    smallest_trace_rows: int = Field(default=6, ge=1, description="traces with fewer peaks are noise, rows")
    margin_min: float = Field(
        default=0.6, ge=0, le=1, description="peaks with a smaller margin are refused as ambiguous"
    )


_LIVE_ROWS_MIN = 15
_CODED_SHARE_MIN = 0.4


class Tracing(Coder[TracingOptions]):
    """Follows stripes with sub-pixel prediction, over gaps, and numbers them from the belt."""

    Options = TracingOptions

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame.

        Parameters
        ----------
        peaks
            From any extractor.
        calibration
            Gives rest lines, displacements and the range of heights.

        Raises
        ------
        StageError
            No calibration; no peak at all; peaks of another image size than the calibration's; rest lines
            that cross, or with nothing on any of them; the belt's stripes more than a pixel beside them;
            fewer than two peaks in five on traces that could be numbered.
        """
        options = self.options
        refuse_uncodable(peaks, calibration)
        calibration = required_calibration(calibration, "tracing", "it tells which belt a trace comes from")
        rest = calibrated_rest_lines(peaks, calibration)
        live = rest.on_line >= _LIVE_ROWS_MIN
        refuse_bare_lines(bool(live.any()), live.size)
        low_mm, high_mm = calibration.height_range_mm
        stripe, margin, coded = coded_traces(
            peaks.row_start,
            peaks.row,
            peaks.x_px,
            options.step_max_px,
            options.longest_gap_rows,
            rest.x_px,
            rest.line,
            live,
            rest.tolerance_px,
            calibration.displacement_px_per_mm,
            low_mm,
            high_mm,
            options.smallest_trace_rows,
            options.margin_min,
            AMBIGUOUS,
        )
        coded /= len(peaks)
        if coded < _CODED_SHARE_MIN:
            raise StageError(
                f"only {coded:.0%} of the peaks lie on traces that could be numbered: that is noise, or the "
                "calibration is another rig's",
                hint="raise the extractor's threshold, or look at the image",
            )
        return bridged(
            peaks,
            stripe,
            margin,
            rest,
            longest_gap_rows=options.longest_gap_rows,
            smallest_product_points=options.smallest_product_points,
            reasons=reasons_of(rest) + missing_stripes(np.flatnonzero(live), live.size),
        )
