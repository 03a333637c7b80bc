"""Stripe coding by window tracking (section 3.3), made safe.

The paper follows each stripe with a small window from the belt to where it is interrupted, numbers belt
segments from left to right, and gives what is left, in order, to the interrupted stripes. Two of its steps
are unsafe: a follower walks from belt to product wherever the surface rises gently, and a stripe whose body
is hidden shifts the number of every body to its right. So here

* fragments are cut where they join or leave a *rest line*, and a point is belt only if it lies on its own;
* what the paper does once for the whole image, by order, is done for every image row: where a row shows as
  many bodies as there is room for between two known stripes, each is certain. A segment takes the stripe
  that its rows agree on. Where they leave a choice, its peaks are refused as ambiguous.

Assumed: on an opaque surface that is lit and seen from above, stripes keep their order along a row, and each
has bare belt at both its ends. Where bodies may be hidden is an option (`hidden`). It refuses where order
leaves a choice. It can be wrong where a stripe is seen twice in a row (an overhang, a reflection), and for a
flat top at the height that displaces a stripe by one spacing, where something else hides the stripe that is
missing beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, UNLABELLED, Peaks, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Coder
from roemetry_kernels.bridging import BridgingOptions, bridged
from roemetry_kernels.compiling import kernel
from roemetry_kernels.consistency import (
    keep_order,
    refuse_bare_lines,
    refuse_uncodable,
    refuse_unexplained_gaps,
)
from roemetry_kernels.rest_lines import (
    RestLines,
    calibrated_rest_lines,
    missing_stripes,
    reasons_of,
    rest_lines_of_frame,
    unknown_rest_lines,
)
from roemetry_kernels.tracing import cut_at_rest_lines, trace_fragments

_BODY_WINDOW_PX = 14
"""Width of the window in which a stripe goes on from row to row on a body: the paper's (section 3.3)."""


class WindowTrackingOptions(BridgingOptions):
    """Windows, gaps and areas of the tracking."""

    stripe_count: int | None = Field(
        default=None, ge=1, description="stripes to expect; default: as the calibration says, else as seen"
    )
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
_UNBOUNDED_PX = 1e6  # no bound
_CLEARLY_LONGER = 3  # times as many rows: which of two segments in one row is the stripe is then plain


class WindowTracking(Coder[WindowTrackingOptions]):
    """Follows, cuts, numbers by order, refuses doubt, bridges short gaps."""

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
            refuse_dark_rows(peaks)
        fragment, fragments = trace_fragments(peaks.row_start, peaks.x_px, _BODY_WINDOW_PX / 2)
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
        """Give (peak,) stripe or UNLABELLED or AMBIGUOUS, (peak,) margin, and what to say of it."""
        line = rest.line
        # what is certainly belt anchors everything else
        belt = belt_of(peaks, fragment, fragments, line, rest.x_px.shape[0])
        refuse_bare_lines(belt.live.size > 0, rest.x_px.shape[0])
        small = np.bincount(fragment, minlength=fragments) < self.options.smallest_area_px
        # belt is kept however short: it is known by its place, not by its length
        noise = small[belt.fragment] & ~belt.anchored
        low, high = _displacements(rest, belt.live, calibration)
        rest_live = np.ascontiguousarray(rest.x_px[belt.live])
        light = _light_side(calibration) if self.options.hidden == "facing-light" else 0
        label, margin = self._settle(peaks, belt, noise, rest_live, low, high, light)
        # back from the index among the lit stripes to the calibration's number
        stripe = np.where(label >= 0, belt.live[np.maximum(label, 0)], label)
        # at most one peak a stripe and row, then order along the row, then gaps that nothing explains
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
        # many small pieces, or most peaks in none: speckle on a plain image
        if big.size > _PIECES_MAX or rows[big].sum() < _PIECES_SHARE_MIN * len(peaks):
            raise StageError(
                f"{big.size} pieces were traced, with {rows[big].sum() / len(peaks):.0%} of the peaks: "
                "that is noise, not stripes",
                hint="raise the extractor's threshold",
            )
        number = np.full(fragments, UNLABELLED, np.int64)
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
        """From the belt to what order decides: (segment,) live stripe, UNLABELLED or AMBIGUOUS; margin."""
        # noise neither votes nor takes room between known stripes
        used = np.where(noise[belt.segment], -1, belt.segment)
        # belt is known from the start; each pass uses what the one before has settled
        label = belt.known
        margin = np.where(belt.anchored, 1.0, np.nan)
        for _ in range(_PASSES_MAX):
            votes, voters = vote_by_order(
                peaks.row_start, peaks.x_px, used, label, rest_px, low_px, high_px, light
            )
            agreement = _AGREEMENT_MIN[self.options.hidden]
            settled, gained = _decided(votes, voters, belt.rows, label, self.options.margin_min, agreement)
            # the vote by which a segment was settled stays, even if later passes see fewer voters
            margin = np.where(settled, gained, margin)
            found = belt.continued(np.where(settled, votes.argmax(axis=1), label))
            if (found == label).all():
                break
            label = found
        # what was given up after all has no margin
        margin[label < 0] = np.nan
        # undecided segments are refused, not guessed
        return np.where(noise, UNLABELLED, np.where(label >= 0, label, AMBIGUOUS)), margin


def _light_side(calibration: Calibration | None) -> int:
    """−1 where the light comes from the left in the image, 1 from the right, 0 where that is not known."""
    if calibration is None:
        return 0
    side = np.sign(calibration.displacement_px_per_mm)
    # planes on both sides of the camera: no side is in shadow for all
    return int(side[0]) if (side == side[0]).all() else 0


@kernel
def vote_by_order(
    row_start: Integers,
    x_px: Floats,
    segment: Integers,
    label: Integers,
    rest_px: Floats,
    displacement_min_px: Floats,
    displacement_max_px: Floats,
    light: int,
) -> tuple[Integers, Integers]:
    """Let each row vote on which stripes each segment may be.

    On an opaque surface lit and seen from above, stripes keep their order along a row. Between a peak of the
    known stripe a and one of the known stripe b, k unknown peaks in order can only be stripes between a
    and b, the j-th of them no less than a + 1 + j and no more than b − (k − j). Where k fills the room, each
    is certain.

    Where bodies hide on the flank that faces the light alone, they are counted from the shadow's side: the
    camera stands on that side of the light, so whatever is lit there is also seen, and those that are missing
    are missing on the side of the light. Glints on that flank do not matter then. A peak that the extractor
    misses on the shadow's side shifts the row's votes: rows that disagree settle nothing.

    Parameters
    ----------
    row_start, x_px
        Peaks by row, px.
    segment
        (peak,) segment of each peak; −1 leaves the peak out.
    label
        (segment,) known stripe of a segment, −1 unknown.
    rest_px
        (stripe, row) rest lines of the stripes that may be chosen, px.
    displacement_min_px, displacement_max_px
        (stripe,) range of possible displacements from the rest line, px.
    light
        Counted from the shadow's side: −1 where the light comes from the left, 1 from the right; else 0.

    Returns
    -------
    tuple
        (segment, stripe) rows in which the segment may be the stripe; (segment,) rows that voted.
        A row that contradicts itself does not vote.
    """
    stripes = rest_px.shape[0]
    segments = label.shape[0]
    votes = np.zeros((segments, stripes), np.int64)
    voters = np.zeros(segments, np.int64)
    for row in range(row_start.shape[0] - 1):
        # left of the first peak there is stripe −1, right of the last one `stripes`: both ends of the row are
        # known
        left = -1
        p = row_start[row]
        end = row_start[row + 1]
        while p < end:
            # the block of unknown peaks p … q − 1 that ends at the next known one
            q, unknown = p, 0
            while q < end and (segment[q] < 0 or label[segment[q]] < 0):
                if segment[q] >= 0:
                    unknown += 1
                q += 1
            right = stripes if q == end else label[segment[q]]
            if right <= left:
                break  # known stripes out of order: this row contradicts itself from here on
            # more unknown peaks than stripes between: one of them is false, and nothing says which
            if 0 < unknown <= right - left - 1:
                j = 0
                for u in range(p, q):
                    s = segment[u]
                    if s < 0:
                        continue
                    voters[s] += 1
                    # the j-th of k: at least j stripes to its left in the room, and k − 1 − j to its right
                    first, last = left + 1 + j, right - (unknown - j)
                    # light from the left: what is missing lies on the left, so peaks are counted from the
                    # right
                    if light < 0:
                        first = last
                    elif light > 0:
                        last = first
                    for stripe in range(first, last + 1):
                        # order allows it; its place must, too
                        off = x_px[u] - rest_px[stripe, row]
                        if displacement_min_px[stripe] <= off <= displacement_max_px[stripe]:
                            votes[s, stripe] += 1
                    j += 1
            left = right
            p = q + 1
    return votes, voters


@kernel
def doubtful_by_order(row_start: Integers, segment: Integers, label: Integers, stripes: int) -> Flags:
    """Mark known peaks whose rows show too many peaks on one side and too few on the other.

    If a body lies on its right neighbour's rest line and is taken for it, then to its left one stripe is
    missing and to its right there is one peak too many. In such a row every known peak between the place
    with too many and the nearest place with too few may be off by one.

    Parameters
    ----------
    row_start
        (row + 1,) where each row's peaks begin.
    segment
        (peak,) segment of each peak; −1 leaves the peak out.
    label
        (segment,) known stripe of a segment, −1 unknown.
    stripes
        Number of stripes that may be chosen.

    Returns
    -------
    ndarray
        (peak,) True for a known peak that may be another stripe.
    """
    doubtful = np.zeros(segment.shape[0], np.bool_)
    most = 0
    for row in range(row_start.shape[0] - 1):
        most = max(most, row_start[row + 1] - row_start[row])
    # one place more than peaks: the block behind the last known one
    peak = np.empty(most + 1, np.int64)  # the known peaks of a row
    spare = np.empty(most + 1, np.int64)  # room left in the block before each known peak, and after the last
    for row in range(row_start.shape[0] - 1):
        count, unknown, left = 0, 0, -1
        for p in range(row_start[row], row_start[row + 1]):
            s = segment[p]
            if s < 0:
                continue
            if label[s] < 0:
                unknown += 1
                continue
            # negative where the block holds more unknown peaks than stripes are missing
            spare[count] = label[s] - left - 1 - unknown
            peak[count] = p
            count += 1
            left, unknown = label[s], 0
        spare[count] = stripes - left - 1 - unknown
        for block in range(count + 1):
            # a block with too many peaks: a neighbour that lies between it and a block with room may be
            # mislabelled
            if spare[block] >= 0:
                continue
            # to the left and to the right, the nearest block that has room; full ones only pass the doubt on
            other = block - 1
            while other >= 0 and spare[other] <= 0:
                other -= 1
            if other >= 0:
                doubtful[peak[other:block]] = True
            other = block + 1
            while other <= count and spare[other] <= 0:
                other += 1
            if other <= count:
                doubtful[peak[block:other]] = True
    return doubtful


def drop_doubles(peaks: Peaks, stripe: Integers, line: Integers, segment_rows: Integers) -> Integers:
    """Leave each stripe at most one peak a row.

    Where a row shows a stripe on the belt and on the product, the product's edge runs through that row and
    both are right: the brighter one stays. Of two others the one of the clearly longer segment stays and
    the other is refused; where neither is clearly longer, both are.

    Parameters
    ----------
    peaks
        The frame's peaks.
    stripe
        (peak,) stripe, `UNLABELLED` or `AMBIGUOUS`.
    line
        (peak,) rest line each peak lies on, −1 for none.
    segment_rows
        (peak,) length of the segment each peak is of, rows.
    """
    labelled = np.flatnonzero(stripe >= 0)
    # one number for row and stripe, so that doubles are neighbours after sorting; the longer segment first
    cell = peaks.row[labelled] * (int(stripe.max(initial=0)) + 1) + stripe[labelled]
    order = np.lexsort((-segment_rows[labelled], cell))
    sorted_cell, sorted_peak = cell[order], labelled[order]
    result = stripe.copy()
    for k in np.flatnonzero(sorted_cell[1:] == sorted_cell[:-1]):
        longer, shorter = sorted_peak[k], sorted_peak[k + 1]
        # exactly one of the two lies on the stripe's own rest line: the edge of the product in this row
        if (line[longer] == stripe[longer]) != (line[shorter] == stripe[shorter]):
            darker = shorter if peaks.amplitude[shorter] <= peaks.amplitude[longer] else longer
            result[darker] = UNLABELLED
            continue
        result[shorter] = AMBIGUOUS
        if segment_rows[longer] < _CLEARLY_LONGER * segment_rows[shorter]:
            result[longer] = AMBIGUOUS
    return result


_NO_BELT = Reason(
    "no-belt",
    "there is no calibration, and no belt at the image's top and bottom by which to number the stripes: each "
    "traced piece has a number of its own; which pieces form one stripe, and what is belt, is not known",
)


def refuse_dark_rows(peaks: Peaks) -> None:
    """Refuse an image in which a block of rows shows no stripe at all: the belt is lit beside products."""
    # rows with any peak; the image's ends count as lit, which makes gaps there one shorter
    lit = np.flatnonzero(np.diff(peaks.row_start))
    gaps = np.diff(np.concatenate([[0], lit, [peaks.image_size[0] - 1]]))
    if gaps.max() > _DARK_ROWS_MAX + 1:
        at = int(gaps.argmax())
        first = int(lit[at - 1]) + 1 if at else 0
        raise StageError(
            f"{int(gaps.max()) - 1} consecutive rows show no stripe at all, from row {first}",
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
    # with one stripe there is no second best
    if votes.shape[1] > 1:
        ranked = np.partition(votes, -2, axis=1)
        best, second = ranked[:, -1], ranked[:, -2]
    else:
        best, second = votes[:, 0], np.zeros_like(voters)
    share = np.maximum(voters, 1)
    margin = (best - second) / share
    settled = (
        (label < 0)
        # few voters, or few of the segment's rows: not believed
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
    # D grows as 1 / (1 − h/W); at both ends of the calibrated heights
    ends = np.stack([per_mm * height / (1.0 - height * near) for height in calibration.height_range_mm])
    return ends.min(axis=0) - rest.tolerance_px, ends.max(axis=0) + rest.tolerance_px


_BELT_END_ROWS = 12
"""Rows at the image's ends within which a belt segment must begin: a product never reaches so far."""
_BELT_ROWS_MIN = 6
"""Rows of a run on a rest line: a body that crosses the line stays on it for fewer."""
_FLICKER_ROWS = 3
"""Rows that may be missing from a run: speckle takes single peaks."""
_DOUBTFUL_ROWS_MIN = 3
"""Rows whose order speaks against a run before it is cut: single rows have false peaks."""
_LIVE_ROWS_MIN = 15
"""Rows of a run amid the image by which a stripe without ends counts as lit."""
_BELT_PASSES_MAX = 4
"""Passes of cutting; each finds what the one before laid bare."""


@dataclass(frozen=True, eq=False, slots=True)
class Belt:
    """Traces cut into segments where they join or leave a rest line."""

    segment: Integers
    """(peak,) segment of each peak. Segments of one trace are numbered in the order of its rows."""
    fragment: Integers
    rows: Integers
    """fragment, rows: (segment,) the trace a segment is a piece of; its length, rows."""
    anchored: Flags
    """(segment,) True for what is certainly belt."""
    on_line: Flags
    """(segment,) True for a piece that lies on some rest line."""
    live: Integers
    """(live,) stripes that have belt, or may have; the others are dead."""
    known: Integers
    """(segment,) index into `live` of an anchored segment's stripe, −1 for the others."""

    def continued(self, label: Integers) -> Integers:
        """Settle pieces on a rest line amid the image by what their trace is before and after them.

        Parameters
        ----------
        label
            (segment,) index into `live`, −1 unknown, `AMBIGUOUS` given up.

        Returns
        -------
        ndarray
            (segment,) labels. A piece between two pieces of one stripe is that stripe: the trace crosses
            the rest line of another. A piece whose trace is another stripe on the one side it is known is
            given up: it may be either.
        """
        # segments of one trace are numbered down the rows, so the pieces before and after are k − 1 and k + 1
        found = label.copy()
        for k in np.flatnonzero(self.on_line & ~self.anchored):
            before = self._neighbour(label, int(k), int(k) - 1)
            after = self._neighbour(label, int(k), int(k) + 1)
            # the same stripe on both sides: only the rest line of another was crossed
            if before >= 0 and before == after:
                found[k] = before
            elif label[k] >= 0 and max(before, after) >= 0 and label[k] not in (before, after):
                # the order says one stripe, the trace another: neither is believed
                found[k] = AMBIGUOUS
        return found

    def _neighbour(self, label: Integers, here: int, there: int) -> int:
        inside = 0 <= there < label.size and self.fragment[there] == self.fragment[here]
        return int(label[there]) if inside else -1


def belt_of(peaks: Peaks, fragment: Integers, fragments: int, line: Integers, stripes: int) -> Belt:
    """Cut traces at rest lines and find the belt.

    A run on a rest line is certainly belt if it reaches the image's top or bottom and no row speaks
    against it. A body at a displacement of one stripe spacing lies on its neighbour's rest line, often right
    where that neighbour's belt ends; then its rows show a peak too many on one side and one too few on the
    other, and there the run is cut.

    Parameters
    ----------
    peaks
        The frame's peaks.
    fragment, fragments
        (peak,) trace of each peak, and their number.
    line
        (peak,) rest line each peak lies on, −1 for none.
    stripes
        Number of rest lines.
    """
    doubted = np.zeros(len(peaks), np.bool_)
    for _ in range(_BELT_PASSES_MAX):
        # a doubted peak is cut from its run by a line number that no anchor can have
        # `line + stripes` still tells the line (modulo) but anchors nothing
        cut_line = np.where(doubted & (line >= 0), line + stripes, line)
        segment, segment_line = cut_at_rest_lines(
            fragment, cut_line, fragments, _BELT_ROWS_MIN, _FLICKER_ROWS
        )
        rows = np.bincount(segment, minlength=segment_line.size)
        anchored = _anchored(peaks, segment, np.where(segment_line < stripes, segment_line, -1))
        live = _live(segment_line, anchored, rows, stripes)
        # anchored lines are all live, so the search finds each
        known = np.where(anchored, np.searchsorted(live, segment_line), -1)
        # a peak is doubted once; the next pass works with what that leaves
        doubtful = doubtful_by_order(peaks.row_start, segment, known, live.size) & ~doubted
        often = np.bincount(segment[doubtful], minlength=rows.size) >= _DOUBTFUL_ROWS_MIN
        doubtful &= often[segment]
        if not doubtful.any():
            break
        doubted |= doubtful
    of = np.empty(rows.size, np.int64)
    of[segment] = fragment
    return Belt(segment, of, rows, anchored, segment_line >= 0, live, known)


def _live(segment_line: Integers, anchored: Flags, rows: Integers, stripes: int) -> Integers:
    """Give the stripes that may be lit: with belt, or with a longer run on their rest line amid the image.

    Such a run may be another's body; but a stripe whose ends are missing must not be given to another.
    """
    if not anchored.any():
        return np.empty(0, np.int64)
    # doubted runs count, too: their stripe may be lit although this run is not its belt
    line = segment_line % stripes
    mine = (segment_line >= 0) & (anchored | (rows >= _LIVE_ROWS_MIN))
    return np.unique(line[mine])


def _anchored(peaks: Peaks, segment: Integers, line: Integers) -> Flags:
    """Say which segments on a rest line reach the image's top or bottom, if need be over a flicker."""
    count = line.size
    # first and last row of each segment
    first = np.full(count, peaks.image_size[0], np.int64)
    last = np.full(count, -1, np.int64)
    np.minimum.at(first, segment, peaks.row)
    np.maximum.at(last, segment, peaks.row)
    anchored = np.zeros(count, np.bool_)
    for number in np.unique(line[line >= 0]):
        mine = np.flatnonzero(line == number)
        # from the image's top down, each run no farther than a flicker below the one before
        downwards = mine[np.argsort(first[mine])]
        reached = _BELT_END_ROWS
        for k in downwards:
            if first[k] > reached:
                break
            anchored[k] = True
            reached = last[k] + _FLICKER_ROWS + 1
        # and from the bottom up
        reached = peaks.image_size[0] - 1 - _BELT_END_ROWS
        for k in downwards[::-1]:
            if last[k] < reached:
                break
            anchored[k] = True
            reached = first[k] - _FLICKER_ROWS - 1
    return anchored
