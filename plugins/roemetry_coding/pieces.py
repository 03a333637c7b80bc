"""Numbers without a calibration: broken stripes are joined, and counted from left to right.

Nothing is known here but order and direction. A piece of a stripe takes a number where a neighbour at a
regular distance and the end of a stripe that points at it say the same, and keeps none where they differ.
What comes out are numbers of this image, from the first stripe on that is seen: no planes of light.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, UNCODED, Peaks, Reason, StripeMap
from roemetry.records.calibration import Calibration
from roemetry.stages import Capabilities, Coder, StageOptions
from roemetry_coding.piece_numbers import numbers_of, pieces_of
from roemetry_kernels.bridging import bridged
from roemetry_kernels.consistency import keep_order, refuse_uncodable
from roemetry_kernels.rest_lines import unknown_rest_lines
from roemetry_kernels.tracing import trace_fragments


class PiecesOptions(StageOptions):
    """Steps, breaks and doubt."""

    step_max_px: float = Field(
        default=7.0, gt=0, le=50, description="largest step of a stripe from row to row, px"
    )
    smallest_piece_rows: int = Field(
        default=10, ge=3, description="traced pieces with fewer peaks are noise, rows"
    )
    longest_break_rows: int = Field(
        default=120, ge=0, description="longest break over which a stripe is known again by direction, rows"
    )
    longest_gap_rows: int = Field(
        default=20, ge=0, description="longest gap along a stripe that is bridged by a straight line, rows"
    )
    margin_min: float = Field(
        default=0.3, ge=0, le=1, description="pieces with a smaller margin are refused as ambiguous"
    )


_PIECES_MAX = 400  # more pieces are noise, not broken stripes
_PIECES_SHARE_MIN = 0.5  # of all peaks: where less lies in pieces, it is noise
_NUMBERED_SHARE_MIN = 0.25  # of the peaks in pieces: with less numbered, the rest cannot be told from it


_NO_BELT = "there is no calibration to know the belt from: all that is numbered counts as one product"


class Pieces(Coder[PiecesOptions]):
    """Joins broken stripes and counts them, where direction and order agree; the numbers are relative."""

    Options = PiecesOptions
    capabilities = Capabilities(relative_numbers=True)
    expected_failures = MappingProxyType(
        {
            "check_a_missing_stripe_shifts_nothing": "how many stripes a wide gap lacks is not known without "
            "a calibration: what lies beyond it is refused",
            "check_a_hidden_body_shifts_nothing": "bodies moved aside beside a stripe that is left over are "
            "in doubt, and with them so much of seven stripes that the frame is refused",
            "check_an_untouched_stripe_is_belt": _NO_BELT,
            "check_a_bare_belt_has_no_product": _NO_BELT,
            "check_a_smooth_wedge_is_product": _NO_BELT,
            "check_rest_lines_are_the_calibrations": _NO_BELT,
        }
    )

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame.

        Parameters
        ----------
        peaks
            From any extractor.
        calibration
            Must be None: these numbers are none of its planes.

        Raises
        ------
        StageError
            A calibration is given; no peak at all; hundreds of pieces, or less than half of the peaks on any;
            less than a quarter of the peaks on pieces that stand side by side in order.
        """
        options = self.options
        if calibration is not None:
            raise StageError(
                "the coder `pieces` counts stripes from the first that is seen in the image: its numbers are "
                f"not those of the calibration's {calibration.stripe_count} planes, and no height follows",
                hint="with a calibration use the coder `planes`; for numbers alone leave the calibration out",
            )
        refuse_uncodable(peaks, None)
        fragment, _ = trace_fragments(peaks.row_start, peaks.x_px, options.step_max_px)
        rows = np.bincount(fragment)
        big = rows >= options.smallest_piece_rows
        share = rows[big].sum() / len(peaks)
        if big.sum() > _PIECES_MAX or share < _PIECES_SHARE_MIN:
            raise StageError(
                f"{int(big.sum())} pieces were traced, of {share:.0%} of the peaks: that is noise, "
                "not stripes",
                hint="raise the extractor's threshold",
            )
        pieces = pieces_of(peaks, fragment, options.smallest_piece_rows)
        numbers = numbers_of(pieces, options.longest_break_rows, options.margin_min)
        stripe = np.full(len(peaks), UNCODED, np.int64)
        margin = np.full(len(peaks), np.nan)
        for part, number, sure in zip(pieces.peaks, numbers.number, numbers.margin, strict=True):
            stripe[part] = number if number >= 0 else AMBIGUOUS
            margin[part] = sure
        stripe = keep_order(peaks, stripe)
        numbered = np.count_nonzero(stripe >= 0) / len(peaks)
        if numbered < _NUMBERED_SHARE_MIN:
            raise StageError(
                f"only {numbered:.0%} of the peaks are on pieces that stand side by side in an order that is "
                "sure: stripes were not counted",
                hint="stripes must run from top to bottom (source.turn_deg); look at the image",
            )
        count = int(stripe.max(initial=0)) + 1
        return bridged(
            peaks,
            stripe,
            margin,
            unknown_rest_lines(count, peaks),
            longest_gap_rows=options.longest_gap_rows,
            smallest_product_points=1,
            reasons=[_said(pieces.count, numbers.number, count)],
        )


def _said(pieces: int, number: np.ndarray, stripes: int) -> Reason:
    """Say what the numbers are, and how much they say."""
    return Reason(
        "relative-numbers",
        f"there is no calibration: stripes are counted from the first that is seen, {stripes} of them; which "
        f"plane of light made them is not known, nor what is belt. {int((number >= 0).sum())} of {pieces} "
        "pieces are numbered",
    )
