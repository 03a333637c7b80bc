"""Stripe coding by window tracking (section 3.3), made safe.

The paper follows each stripe with a small window from the belt to where it is interrupted, numbers belt
segments from left to right, and gives what is left, in order, to the interrupted stripes. Two of its steps
are unsafe: a follower walks from belt to product wherever the surface rises gently, and a stripe whose body
is hidden shifts the number of every body to its right. So here, by default,

* fragments are cut where they join or leave a *rest line*, and a point is belt only if it lies on its own;
* what the paper does once for the whole image, by order, is done for every image row: where a row shows as
  many bodies as there is room for between two known stripes, each is certain. A segment takes the stripe
  that its rows agree on. Where they leave a choice, its peaks are refused as ambiguous.

``belt: interruption`` does it the paper's way, to show what that gives.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, UNCODED, Peaks, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Coder
from roemetry_kernels.coding.bridging import BridgingOptions, bridged
from roemetry_kernels.coding.consistency import drop_doubles, keep_order, refuse_unexplained_gaps
from roemetry_kernels.coding.ordering import vote_by_order
from roemetry_kernels.coding.refusing import refuse_bare_lines, refuse_uncodable
from roemetry_kernels.coding.rest_lines import (
    RestLines,
    calibrated_rest_lines,
    missing_stripes,
    reasons_of,
    rest_lines_of_frame,
    unknown_rest_lines,
)
from roemetry_kernels.coding.tracing import trace_fragments
from roemetry_kernels.compiling import kernel
from roemetry_paper.belt import Belt, belt_of
from roemetry_paper.literal_tracking import literal_codes


class WindowTrackingOptions(BridgingOptions):
    """Windows, gaps and areas of the tracking."""

    belt: Literal["rest-line", "interruption"] = Field(
        default="rest-line",
        description="what makes a point belt: lying on its stripe's rest line, or (the paper, literally) "
        "being traced before the first interruption",
    )
    stripe_count: int | None = Field(
        default=None, ge=1, description="stripes to expect; default: as the calibration says, else as seen"
    )
    belt_window_px: int = Field(
        default=3,
        ge=1,
        le=99,
        description="width of the window on the belt, px; used by `belt: interruption` alone",
    )
    body_window_px: int = Field(default=14, ge=1, le=99, description="width of the window on the body, px")
    smallest_area_px: int = Field(default=10, ge=1, description="fragments with fewer peaks are noise")
    hidden: Literal["anywhere", "facing-light"] = Field(
        default="anywhere",
        description="where bodies may be hidden or lost. facing-light: only on the flank that faces the "
        "light, where the camera looks past an overhang; so stripes are counted from the shadow's side",
    )
    margin_min: float = Field(
        default=0.1,
        ge=0,
        le=1,
        description="share of rows by which the best stripe must beat the second best",
    )


_END_ROWS = 12
"""Rows at the image's ends within which a belt segment must begin: a skein never reaches so far."""
_DARK_ROWS_MAX = 20
"""Rows on end without a peak: as long a gap as is bridged."""
_PIECES_MAX = 400
"""Pieces without a belt to number them by: more is noise."""
_PIECES_SHARE_MIN = 0.25
"""Of all peaks: where less lies in traced pieces, it is noise."""
_AGREEMENT_MIN = {"anywhere": 0.9, "facing-light": 0.75}
"""Of the rows that vote. Counted from the shadow's side each row that has lost a peak is off by one, and an
extractor loses one in up to a fifth of a flank's rows. A stripe that is lost in three rows of four shifts
those behind it, and nothing tells."""
_VOTERS_MIN = 3
"""Rows that vote: fewer are chance."""
_VOTING_SHARE_MIN = 0.5
"""Of a segment's rows: where most cannot vote, something is seen twice and something hidden."""
_PASSES_MAX = 12
"""Passes; each settles what the one before made certain, until nothing changes."""
_UNBOUNDED_PX = 1e6
"""No bound, px."""


class WindowTracking(Coder[WindowTrackingOptions]):
    """Follows, cuts, numbers by order, refuses doubt, bridges short gaps."""

    Options = WindowTrackingOptions

    def code(self, peaks: Peaks, calibration: Calibration | None) -> StripeMap:
        """Code the peaks of one frame.

        Parameters
        ----------
        peaks
            From any extractor.
        calibration
            Gives the rest lines, the number of stripes and the side of displacement; None for pixels only.

        Raises
        ------
        StageError
            No peak at all; not the expected number of stripes; no stripe where the calibration has one; peaks
            of another image size than the calibration's; more than 20 rows on end without any stripe.
        """
        options = self.options
        refuse_uncodable(peaks, calibration)
        if (
            calibration is not None
            and options.stripe_count is not None
            and options.stripe_count != calibration.stripe_count
        ):
            raise StageError(
                f"the recipe expects {options.stripe_count} stripes, "
                f"the calibration has {calibration.stripe_count}",
                hint="leave stripe_count out, or calibrate with all stripes",
            )
        if calibration is not None:
            _refuse_dark_rows(peaks)
        fragment, fragments = trace_fragments(peaks.row_start, peaks.x_px, options.body_window_px / 2)
        rest = (
            calibrated_rest_lines(peaks, calibration)
            if calibration is not None
            else rest_lines_of_frame(peaks, fragment, fragments, options.stripe_count, _END_ROWS)
        )
        reasons: list[Reason] = []
        if rest is not None:
            reasons += reasons_of(rest)
        if rest is None:
            rest, stripe, margin = self._pieces(peaks, fragment, fragments)
            reasons.append(_NO_BELT)
        elif options.belt == "interruption":
            stripe, margin = literal_codes(
                peaks, rest.x_px, options.belt_window_px, options.body_window_px, options.smallest_area_px
            )
            reasons.append(_LITERAL)
        else:
            stripe, margin, said = self._from_belt(peaks, rest, fragment, fragments, calibration)
            reasons += said
        return bridged(
            peaks,
            stripe,
            margin,
            rest,
            longest_gap_rows=options.longest_gap_rows,
            smallest_product_points=options.smallest_product_points,
            reasons=reasons,
        )

    def _from_belt(
        self,
        peaks: Peaks,
        rest: RestLines,
        fragment: Integers,
        fragments: int,
        calibration: Calibration | None,
    ) -> tuple[Integers, Floats, list[Reason]]:
        """Give (peak,) stripe or UNCODED or AMBIGUOUS, (peak,) margin, and what to say of it."""
        line = rest.line
        belt = belt_of(peaks, fragment, fragments, line, rest.x_px.shape[0])
        refuse_bare_lines(belt.live.size > 0, rest.x_px.shape[0])
        small = np.bincount(fragment, minlength=fragments) < self.options.smallest_area_px
        noise = small[belt.fragment] & ~belt.anchored
        low, high = _displacements(rest, belt.live, calibration)
        rest_live = np.ascontiguousarray(rest.x_px[belt.live])
        label, margin = self._settle(peaks, belt, noise, rest_live, low, high, _light_side(calibration))
        stripe = np.where(label >= 0, belt.live[np.maximum(label, 0)], label)
        of_peak = drop_doubles(peaks, stripe[belt.segment], line, belt.rows[belt.segment])
        of_peak = keep_order(peaks, of_peak)
        displacement = (
            np.full(rest.x_px.shape[0], np.nan) if calibration is None else calibration.displacement_px_per_mm
        )
        of_peak, gaps = refuse_unexplained_gaps(
            peaks, of_peak, line, rest.x_px, displacement, self.options.longest_gap_rows
        )
        return of_peak, margin[belt.segment], missing_stripes(belt.live, rest.x_px.shape[0]) + gaps

    def _pieces(self, peaks: Peaks, fragment: Integers, fragments: int) -> tuple[RestLines, Integers, Floats]:
        """Give each traced piece a number of its own, left to right: nothing says which are one stripe."""
        rows = np.bincount(fragment, minlength=fragments)
        place = np.bincount(fragment, weights=peaks.x_px, minlength=fragments) / rows
        big = np.flatnonzero(rows >= self.options.smallest_area_px)
        if not big.size:
            raise StageError("what was found in the image is too small to be stripes")
        if big.size > _PIECES_MAX or rows[big].sum() < _PIECES_SHARE_MIN * len(peaks):
            raise StageError(
                f"{big.size} pieces were traced, of {rows[big].sum() / len(peaks):.0%} of the peaks: "
                "that is noise, not stripes",
                hint="raise the extractor's threshold",
            )
        number = np.full(fragments, UNCODED, np.int64)
        number[big[np.argsort(place[big])]] = np.arange(big.size)
        return unknown_rest_lines(big.size, peaks), number[fragment], np.full(len(peaks), np.nan)

    def _settle(
        self,
        peaks: Peaks,
        belt: Belt,
        noise: Flags,
        rest_px: Floats,
        low_px: Floats,
        high_px: Floats,
        light: int,
    ) -> tuple[Integers, Floats]:
        """From the belt to all that order decides: (segment,) live stripe, UNCODED or AMBIGUOUS; margin."""
        used = np.where(noise[belt.segment], -1, belt.segment)
        label = belt.known
        margin = np.where(belt.anchored, 1.0, np.nan)
        for _ in range(_PASSES_MAX):
            votes, voters = vote_by_order(peaks.row_start, peaks.x_px, used, label, rest_px, low_px, high_px)
            if light and self.options.hidden == "facing-light":
                votes = vote_from_shadow(
                    peaks.row_start, peaks.x_px, used, label, rest_px, low_px, high_px, light
                )
            agreement = _AGREEMENT_MIN[self.options.hidden]
            settled, gained = _decided(votes, voters, belt.rows, label, self.options.margin_min, agreement)
            margin = np.where(settled, gained, margin)
            found = belt.continued(np.where(settled, votes.argmax(axis=1), label))
            if (found == label).all():
                break
            label = found
        margin[label < 0] = np.nan
        return np.where(noise, UNCODED, np.where(label >= 0, label, AMBIGUOUS)), margin


def _light_side(calibration: Calibration | None) -> int:
    """−1 where the light comes from the left in the image, 1 from the right, 0 where that is not known."""
    if calibration is None:
        return 0
    side = np.sign(calibration.displacement_px_per_mm)
    return int(side[0]) if (side == side[0]).all() else 0


@kernel
def vote_from_shadow(
    row_start: Integers,
    x_px: Floats,
    segment: Integers,
    label: Integers,
    rest_px: Floats,
    displacement_min_px: Floats,
    displacement_max_px: Floats,
    light: int,
) -> Integers:
    """Let each row vote on the one stripe that each segment is, counted from the shadow's side.

    The camera stands on the shadow's side of the light, so whatever is lit there is also seen. Hidden
    stripes lie on the flank that faces the light, where the camera looks past an overhang. Between two known
    stripes the unknown peaks are therefore the last ones on the shadow's side, and those that are missing
    are missing on the side of the light; glints on that flank do not matter either. Arguments as of
    `vote_by_order`; `light` is −1 where it comes from the left. A peak that the extractor misses on the
    shadow's side shifts the row's votes: rows that disagree settle nothing.

    Returns
    -------
    ndarray, shape (segment, stripe)
        Rows in which the segment is the stripe.
    """
    stripes = rest_px.shape[0]
    votes = np.zeros((label.shape[0], stripes), np.int64)
    for row in range(row_start.shape[0] - 1):
        left, p, end = -1, row_start[row], row_start[row + 1]
        while p < end:
            q, unknown = p, 0
            while q < end and (segment[q] < 0 or label[segment[q]] < 0):
                if segment[q] >= 0:
                    unknown += 1
                q += 1
            right = stripes if q == end else label[segment[q]]
            if right <= left:
                break
            if 0 < unknown <= right - left - 1:
                stripe = right - unknown if light < 0 else left + 1
                for u in range(p, q):
                    if segment[u] < 0:
                        continue
                    off = x_px[u] - rest_px[stripe, row]
                    if displacement_min_px[stripe] <= off <= displacement_max_px[stripe]:
                        votes[segment[u], stripe] += 1
                    stripe += 1
            left = right
            p = q + 1
    return votes


_LITERAL = Reason(
    "literal-coding",
    "coded the paper's way, by interruption and order: a hidden body shifts codes without notice",
)


_NO_BELT = Reason(
    "no-belt",
    "there is no calibration, and no belt at the image's top and bottom to number the stripes by: each "
    "traced piece has a number of its own; which pieces are one stripe is not known, nor what is belt",
)


def _refuse_dark_rows(peaks: Peaks) -> None:
    """Refuse an image in which a block of rows shows no stripe at all: the belt is lit beside products."""
    lit = np.flatnonzero(np.diff(peaks.row_start))
    gaps = np.diff(np.concatenate([[0], lit, [peaks.image_size[0] - 1]]))
    if gaps.max() > _DARK_ROWS_MAX + 1:
        at = int(gaps.argmax())
        first = int(lit[at - 1]) + 1 if at else 0
        raise StageError(
            f"{int(gaps.max()) - 1} rows on end show no stripe at all, from row {first}",
            hint="the image is damaged, or the laser was off or covered for a part of it",
        )


def _decided(
    votes: Integers,
    voters: Integers,
    rows: Integers,
    label: Integers,
    margin_min: float,
    agreement_min: float,
) -> tuple[Flags, Floats]:
    """Say which unknown segments their rows agree on, and by which margin.

    A row with more peaks than stripes does not vote. Where most rows of a segment are such, the few that
    vote are not believed: something is seen twice, and something else is hidden.
    """
    if votes.shape[1] > 1:
        ranked = np.partition(votes, -2, axis=1)
        best, second = ranked[:, -1], ranked[:, -2]
    else:
        best, second = votes[:, 0], np.zeros_like(voters)
    share = np.maximum(voters, 1)
    margin = (best - second) / share
    settled = (
        (label < 0)
        & (voters >= np.maximum(_VOTERS_MIN, _VOTING_SHARE_MIN * rows))
        & (best >= agreement_min * voters)
        & (margin >= margin_min)
    )
    return settled, margin


def _displacements(rest: RestLines, live: Integers, calibration: Calibration | None) -> tuple[Floats, Floats]:
    """Range of displacements each live stripe may have, px; without a calibration any."""
    if calibration is None:
        return np.full(live.size, -_UNBOUNDED_PX), np.full(live.size, _UNBOUNDED_PX)
    per_mm = calibration.displacement_px_per_mm[live]
    view = calibration.view
    # nearer to the camera a millimetre is seen larger
    near = 0.0 if view is None or view.telecentric else 1.0 / float(view.camera_mm[2])
    ends = np.stack([per_mm * height / (1.0 - height * near) for height in calibration.height_range_mm])
    return ends.min(axis=0) - rest.tolerance_px, ends.max(axis=0) + rest.tolerance_px
