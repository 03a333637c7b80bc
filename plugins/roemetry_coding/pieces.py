"""Numbers without a calibration: broken stripes are joined, and counted from left to right.

Model. Nothing is known here but order and direction: stripes on an opaque surface do not cross, and mostly go
on as they were going. Traces are cut where they step aside or turn. The distance d of neighbours, square to
them, is fitted over the image (log d linear in column and row, since most pairs are neighbours). A piece
takes the number n where every numbered neighbour at 0.7 to 1.4 d says n, all in its rows stands on the right
side, and the end of a stripe n points at it, no other nearly as well. Its margin compares that with the next
number, over r, distances to neighbours, and o, offsets of ends, in spacings:

    margin = 1 − √(Σ (r − 1)² + Σ o²) / √(Σ (1 − |r − 1|)² + Σ (1 − |o|)²),    no more than its neighbours'

Assumed: stripes run from top to bottom, and neighbours stand at regular distances. What comes out are numbers
of this image, from the first stripe on that is seen: no planes of light. It fails, by refusing, where a body
moves stripes aside by much of a spacing: order and direction then contradict each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, UNLABELLED, Peaks, Reason, StripeMap
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.stages import Capabilities, Coder, StageOptions
from roemetry_kernels.bridging import bridged
from roemetry_kernels.consistency import keep_order, refuse_uncodable
from roemetry_kernels.rest_lines import unknown_rest_lines
from roemetry_kernels.tracing import trace_fragments


class PiecesOptions(StageOptions):
    """Gaps and doubt."""

    longest_gap_rows: int = Field(
        default=20, ge=0, description="longest gap along a stripe that is bridged by a straight line, rows"
    )
    margin_min: float = Field(
        default=0.3, ge=0, le=1, description="pieces with a smaller margin are refused as ambiguous"
    )


_STEP_MAX_PX = 7.0  # of a stripe from row to row: the next stripe lies farther off
_PIECE_ROWS_MIN = 10  # traced pieces with fewer peaks are noise
_BREAK_ROWS_MAX = 120  # over which a stripe is known again by its direction
_PIECES_MAX = 400  # more pieces are noise, not broken stripes
_PIECES_SHARE_MIN = 0.5  # of all peaks: where less lies in pieces, it is noise
_NUMBERED_SHARE_MIN = 0.25  # of the peaks in pieces: with less numbered, the rest cannot be told from it


_NO_BELT = "there is no calibration to know the belt from: all that is numbered counts as one product"


class Pieces(Coder[PiecesOptions]):
    """Joins broken stripes and counts them, where direction and order agree; the numbers are relative."""

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
                "the coder `pieces` numbers stripes from the first one seen in the image: its numbers are "
                f"not those of the calibration's {calibration.stripe_count} planes, so heights cannot be "
                "computed",
                hint="with a calibration use the coder `planes`; for numbers alone leave the calibration out",
            )
        refuse_uncodable(peaks, None)
        fragment, _ = trace_fragments(peaks.row_start, peaks.x_px, _STEP_MAX_PX)
        rows = np.bincount(fragment)
        big = rows >= _PIECE_ROWS_MIN
        share = rows[big].sum() / len(peaks)
        if big.sum() > _PIECES_MAX or share < _PIECES_SHARE_MIN:
            raise StageError(
                f"{int(big.sum())} pieces were traced, with {share:.0%} of the peaks: that is noise, "
                "not stripes",
                hint="raise the extractor's threshold",
            )
        pieces = pieces_of(peaks, fragment, _PIECE_ROWS_MIN)
        numbers = numbers_of(pieces, _BREAK_ROWS_MAX, options.margin_min)
        stripe = np.full(len(peaks), UNLABELLED, np.int64)
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
        f"there is no calibration: {stripes} stripes are numbered from the first one seen; their laser "
        f"planes and the belt are not known. {int((number >= 0).sum())} of {pieces} pieces are numbered",
    )


_SIDE_ROWS, _ALONE_ROWS = 15, 30
"""Rows on which two must stand side by side to be neighbours; and where nothing but that speaks."""
_NEXT_MIN, _NEXT_MAX = 0.7, 1.4
"""Distance of two neighbours, spacings."""
_POINTS_AT = 0.4
"""A break is bridged to what begins within so much of where it should, spacings."""
_RIVAL = 0.15
"""Another end is a rival if it points no worse by more, spacings."""
_CONTESTS = 1.0
"""A piece without a number contests a break if it points so near to one of its ends, spacings."""
_GOES_ON_ROWS = 12
"""A stripe goes through beside a break if it is seen so far above and below it, rows: as far as a break
that is no break may be long."""


class Numbers(NamedTuple):
    """What was found."""

    number: Integers
    """(piece,) from 0, left to right; −1 where nothing was decided."""
    margin: Floats
    """(piece,) how much better than the next number, 0 to 1; NaN where there is no number."""


def numbers_of(pieces: TracedPieces, reach_rows: int, margin_min: float) -> Numbers:
    """Number pieces from the longest on, as far as direction and order agree.

    Parameters
    ----------
    pieces
        See there.
    reach_rows
        Longer breaks are not bridged by direction, rows.
    margin_min
        What has a smaller margin is not numbered, and nothing is numbered by it.
    """
    doubted: set[int] = set()
    loose: set[int] = set()
    while True:
        # grown anew without what was in doubt: numbers that leaned on it must find other support
        growth = _best_growth(pieces, reach_rows, margin_min, doubted, loose)
        of_breaks = {piece for pair in growth.doubtful_breaks() for piece in pair}
        of_itself = growth.loose() - of_breaks
        if not of_breaks and not of_itself:
            break
        doubted |= of_breaks
        loose |= of_itself
    # from 0 on: the seed's own number was arbitrary
    number = growth.number - growth.number.min(initial=_FAR, where=growth.given)
    return Numbers(np.where(growth.given, number, -1), np.where(growth.given, growth.margin, np.nan))


_FAR = np.iinfo(np.int64).max


def _best_growth(
    pieces: TracedPieces, reach_rows: int, margin_min: float, doubted: set[int], loose: set[int]
) -> _Growth:
    """Let numbers spread from the longest stripe, or from another it did not reach if that gives more."""
    # a piece that was reached once is no seed again: it would give the same growth
    tried = doubted | loose
    best = None
    while best is None or len(tried) < pieces.count:
        growth = _Growth(pieces, reach_rows, margin_min, doubted, loose)
        growth.grow(tried)
        tried |= set(np.flatnonzero(growth.given).tolist())
        if best is None or growth.peaks > best.peaks:
            best = growth
        if (
            not growth.given.any()
            or sum(pieces.peaks[k].size for k in range(pieces.count) if k not in tried) <= best.peaks
        ):
            return best
    return best


class _Growth:
    """Numbers that spread from the longest stripe to its neighbours."""

    def __init__(
        self, pieces: TracedPieces, reach_rows: int, margin_min: float, doubted: set[int], loose: set[int]
    ) -> None:
        self.pieces, self.reach_rows, self.margin_min = pieces, reach_rows, margin_min
        self.doubted, self.refused = doubted, doubted | loose
        self.number = np.zeros(pieces.count, np.int64)
        self.margin = np.zeros(pieces.count)
        self.given = np.zeros(pieces.count, np.bool_)
        self.breaks: list[tuple[int, int]] = []
        self._next = {0: pieces.through, 1: pieces.through.T}
        self.groups = _groups(pieces)

    @property
    def peaks(self) -> int:
        """How many peaks have a number."""
        return sum(self.pieces.peaks[k].size for k in np.flatnonzero(self.given))

    def grow(self, not_from: set[int]) -> None:
        """Give numbers until nothing more can be decided, from the longest that is none of `not_from` on."""
        size = [sum(self.pieces.peaks[k].size for k in group) for group in self.groups]
        sure = [g for g, group in enumerate(self.groups) if not self.refused.intersection(group)]
        waiting = sorted(sure, key=lambda g: -size[g])
        first = next((g for g in waiting if not not_from.intersection(self.groups[g])), None)
        if first is None:
            return
        waiting.remove(first)
        self._give(self.groups[first], 0, 1.0, [])
        while True:
            ready = [(say, g) for g in waiting if (say := self._verdict(self.groups[g])) is not None]
            if not ready:
                return
            (number, margin, _, breaks), best = max(
                # breaks that no unnumbered piece fits come first, then the number with most rows, then the
                # surest
                ready,
                key=lambda one: (not self._skips(one[0][3]), one[0][2], one[0][1]),
            )
            self._give(self.groups[best], number, margin, breaks)
            waiting.remove(best)

    def _give(self, group: list[int], number: int, margin: float, breaks: list[tuple[int, int]]) -> None:
        self.number[group], self.margin[group], self.given[group] = number, margin, True
        self.breaks += breaks

    def _verdict(self, group: list[int]) -> tuple[int, float, int, list[tuple[int, int]]] | None:
        """Give number, margin, rows side by side with what is numbered, and the breaks bridged; or None."""
        sides = list(self._sides(group))
        # every neighbour must say the same number
        if not sides or len({number for number, *_ in sides}) > 1:
            return None
        number = sides[0][0]
        rows = sum(rows for _, rows, *_ in sides)
        if rows < _SIDE_ROWS or not self._in_order(group, number):
            return None
        bridged, facing, bad = self._breaks(group, number)
        if bad or (facing and not bridged) or (not bridged and rows < _ALONE_ROWS):
            return None
        # squared misfits of this number, and of the next one: distances of neighbours should be 1, offsets 0
        mine = sum((r - 1.0) ** 2 for _, _, r, _ in sides) + sum(o**2 for o, *_ in bridged)
        one_off = sum((1.0 - abs(r - 1.0)) ** 2 for _, _, r, _ in sides) + sum(
            (1.0 - abs(o)) ** 2 for o, *_ in bridged
        )
        # no surer than the surest neighbour that it leans on
        margin = min(1.0 - (mine / max(one_off, 1e-9)) ** 0.5, max(m for *_, m in sides))
        if margin < self.margin_min:
            return None
        return number, float(margin), rows, [pair for _, pair in bridged]

    def _skips(self, breaks: list[tuple[int, int]]) -> bool:
        """Say whether a piece without a number would fit into one of these breaks: that one comes first."""
        off = np.abs(self.pieces.off) <= _POINTS_AT
        return any(bool((off[upper] & off[:, lower] & ~self.given).any()) for upper, lower in breaks)

    def _sides(self, group: list[int]) -> Iterator[tuple[int, int, float, float]]:
        """Give the number that each neighbour says, its rows, how far it stands, spacings, and its margin."""
        for mine in group:
            for (left, right), side in self.pieces.sides.items():
                other = right if left == mine else left
                if mine not in (left, right) or not self.given[other]:
                    continue
                if side.along and side.rows >= _SIDE_ROWS // 2 and _NEXT_MIN <= side.spacings <= _NEXT_MAX:
                    step = -1 if left == mine else 1
                    yield int(self.number[other]) + step, side.rows, side.spacings, float(self.margin[other])

    def _in_order(self, group: list[int], number: int) -> bool:
        """Say whether all that is numbered and shares a row stands on the side its number says."""
        left = self.pieces.left_of[:, group].any(axis=1) & self.given
        right = self.pieces.left_of[group].any(axis=0) & self.given
        return bool((self.number[left] < number).all() and (self.number[right] > number).all())

    def _breaks(
        self, group: list[int], number: int
    ) -> tuple[list[tuple[float, tuple[int, int]]], bool, bool]:
        """Look above and below a group.

        Gives the breaks to the same number that direction bears out; whether an open end of any number faces
        the group; and whether direction speaks for another one.
        """
        found: list[tuple[float, tuple[int, int]]] = []
        facing = bad = False
        pieces = self.pieces
        first = min(group, key=lambda k: int(pieces.top.row[k]))
        last = max(group, key=lambda k: int(pieces.bottom.row[k]))
        for mine, off, faces, gap, border, taken in (
            (first, pieces.off[:, first], pieces.faces[:, first], pieces.gap[:, first],
             pieces.border_top[first], 0),
            (last, pieces.off[last], pieces.faces[last], pieces.gap[last], pieces.border_bottom[last], 1),
        ):  # fmt: skip
            if border:
                continue
            facing |= bool(faces[list(self.doubted)].any())
            open_end = self.given & ~self._next[taken].any(axis=1) & faces
            used = [pair[taken] for pair in self.breaks]
            open_end[used] = False
            at = np.flatnonzero(open_end)
            if not at.size:
                continue
            facing = True
            own = [k for k in at if self.number[k] == number and 0 < gap[k] <= self.reach_rows]
            if not own:
                continue
            k = min(own, key=lambda k: abs(off[k]))
            pair = (int(k), mine) if taken == 0 else (mine, int(k))
            others = [abs(off[j]) for j in at if self.number[j] != number]
            if abs(off[k]) > _POINTS_AT or min(others, default=np.inf) < abs(off[k]) + _RIVAL:
                bad = True
            else:
                found.append((float(off[k]), pair))
        return found, facing, bad

    def doubtful_breaks(self) -> set[tuple[int, int]]:
        """Give the bridged breaks that a neighbour without a continuation makes doubtful.

        If all stripes between two are moved aside by one spacing, each goes on where its neighbour ended, and
        one is left over. So a front of breaks must reach from stripe to stripe until one goes through.
        """
        pieces = self.pieces
        ends = self.given & ~pieces.border_bottom & ~pieces.through.any(axis=1)
        ends[[upper for upper, _ in self.breaks]] = False
        tops = self.given & ~pieces.border_top & ~pieces.through.any(axis=0)
        tops[[lower for _, lower in self.breaks]] = False
        doubt = {
            pair
            for pair in self.breaks
            if any(self._left_over(pair, int(self.number[pair[0]]) + step, ends, tops) for step in (-1, 1))
            or self._contested(pair)
        }
        while True:  # along the front, from break to break of neighbours
            more = {
                pair
                for pair in self.breaks
                if pair not in doubt and any(self._beside(pair, other) for other in doubt)
            }
            if not more:
                return doubt
            doubt |= more

    def _contested(self, pair: tuple[int, int]) -> bool:
        """Say whether a piece without a number, as long as one that counts, begins or ends in a break."""
        pieces = self.pieces
        # of the pieces without a number that are as long as those that count
        other = ~self.given & (np.array([part.size for part in pieces.peaks]) >= _ALONE_ROWS)
        begins = np.abs(pieces.off[pair[0]]) <= _CONTESTS
        ends = np.abs(pieces.off[:, pair[1]]) <= _CONTESTS
        near = pieces.gap[pair[0], pair[1]] + pieces.spacing_px[pair[1]]
        begins &= pieces.gap[pair[0]] <= near
        ends &= pieces.gap[:, pair[1]] <= near
        return bool((other & (begins | ends)).any())

    def loose(self) -> set[int]:
        """Give pieces that neither the border nor a bridged break ties, and which others face unexplained.

        Such a piece may be another stripe's, moved aside: what it broke off from is in sight.
        """
        pieces = self.pieces
        uppers, lowers = ({pair[side] for pair in self.breaks} for side in (0, 1))
        unknown = ~self.given
        found: set[int] = set()
        for group in self.groups:
            if not self.given[group[0]]:
                continue
            tied = any(
                pieces.border_top[k] or pieces.border_bottom[k] or k in uppers or k in lowers for k in group
            )
            faced = (pieces.faces[:, group].any(axis=1) | pieces.faces[group].any(axis=0)) & unknown
            if faced.any() and not tied:
                found.update(group)
        return found

    def _left_over(self, pair: tuple[int, int], number: int, ends: Flags, tops: Flags) -> bool:
        """Say whether a stripe neither goes through beside a break nor breaks there, and has an end over.

        That end lies above the break, or its beginning below it.
        """
        pieces = self.pieces
        above, below = int(pieces.bottom.row[pair[0]]), int(pieces.top.row[pair[1]])
        mine = self.number == number
        left_over = ends & (pieces.bottom.row <= below + _GOES_ON_ROWS)
        left_over |= tops & (pieces.top.row >= above - _GOES_ON_ROWS)
        if not (left_over & mine).any():
            return False
        for group in self.groups:
            if self.given[group[0]] and self.number[group[0]] == number:
                first, last = pieces.top.row[group].min(), pieces.bottom.row[group].max()
                if first <= above - _GOES_ON_ROWS and last >= below + _GOES_ON_ROWS:
                    return False
        return not any(self.number[other[0]] == number and self._beside(pair, other) for other in self.breaks)

    def _beside(self, one: tuple[int, int], other: tuple[int, int]) -> bool:
        """Say whether two breaks are neighbours.

        Of stripes side by side, at most a spacing of rows apart, the end of one facing the other's beginning.
        """
        if abs(int(self.number[one[0]] - self.number[other[0]])) != 1:
            return False
        pieces = self.pieces
        above = max(int(pieces.bottom.row[one[0]]), int(pieces.bottom.row[other[0]]))
        below = min(int(pieces.top.row[one[1]]), int(pieces.top.row[other[1]]))
        if above - below > pieces.spacing_px[one[1]]:
            return False
        return bool(pieces.faces[one[0], other[1]] or pieces.faces[other[0], one[1]])


def _groups(pieces: TracedPieces) -> list[list[int]]:
    """Put together what goes through."""
    group = list(range(pieces.count))
    for upper, lower in zip(*np.nonzero(pieces.through), strict=True):
        was, now = group[lower], group[upper]
        group = [now if g == was else g for g in group]
    return [[k for k in range(pieces.count) if group[k] == g] for g in sorted(set(group))]


SLOPE_ROWS = 12
"""Rows at an end that say where it points."""
_THROUGH_ROWS, _THROUGH_OFF, _THROUGH_TURN = 12, 0.05, math.radians(20.0)
"""A break that is no break: rows, how far beside where both ends point, spacings, and its turn, rad."""
_CUT_ROWS, _STEP_ASIDE_PX = 6, 2.5
"""A trace that steps aside by so much is cut there; rows on either side that say where it goes."""
_FIT_ROUNDS, _FIT_WITHIN = 12, 0.4
"""Fit of the spacing: rounds, and the logarithm beyond which a distance is not that of neighbours."""
_FIT_PAIRS_MIN = 50  # distances of neighbours: from fewer no spacing is fitted
_TURN_MAX = math.radians(45.0)
"""What turns by more is not taken for the same stripe, nor for its neighbour, rad."""
# rows that the two may share, and spacings that they may lie apart, where one goes on in the other
_OVERLAP_ROWS, _FACES = 15, 1.5
_BORDER_SPACINGS = 0.5  # an end so near to the image's side may be a stripe that leaves it
_BORDER_ROWS = 3  # the same at top and bottom: extractors leave out the first and last row


class Ends(NamedTuple):
    """First and last peak of each piece, and where it points there: columns a row."""

    row: Integers
    x_px: Floats
    slope: Floats


class Side(NamedTuple):
    """Two pieces side by side with nothing between.

    On how many rows, how far apart, spacings, and whether they run the same way.
    """

    rows: int
    spacings: float
    along: bool


@dataclass(frozen=True, eq=False, slots=True)
class TracedPieces:
    """All traced pieces of a frame."""

    peaks: list[Integers]
    """Of each piece, its peaks' numbers, from top to bottom."""
    top: Ends
    bottom: Ends
    """top, bottom: its two ends."""
    sides: dict[tuple[int, int], Side]
    """By (piece, piece to its right): neighbours."""
    left_of: Flags
    """(piece, piece) True where the first stands left of the second on some row."""
    off: Floats
    """(piece, piece) how far beside the place to which both point the second begins, below the first's end,
    spacings, signed; infinite where it does not begin below."""
    gap: Integers
    """(piece, piece) rows from the first's end to the second's beginning."""
    faces: Flags
    """(piece, piece) True where the second begins below the first's end, or up to `_OVERLAP_ROWS` above, and
    no further than `_FACES` spacings beside it."""
    through: Flags
    """(piece, piece) True where the second goes on from the first with hardly a break."""
    border_top: Flags
    border_bottom: Flags
    """border_top, border_bottom: (piece,) True where the end lies at the image's border: the stripe goes on
    outside."""
    spacing_px: Floats
    """(piece,) how far neighbours are from each other where it begins, square to them, px."""

    @property
    def count(self) -> int:
        """Number of pieces."""
        return len(self.peaks)


def pieces_of(peaks: Peaks, fragment: Integers, rows_min: int) -> TracedPieces:
    """Give the pieces of at least `rows_min` peaks, and how they lie to each other.

    Parameters
    ----------
    peaks
        The frame's peaks.
    fragment
        (peak,) traced fragment.
    rows_min
        Shorter fragments are no pieces.
    """
    order = np.argsort(fragment, kind="stable")
    whole = np.split(order, np.flatnonzero(np.diff(fragment[order])) + 1)
    parts = [part for one in whole for part in _cut(one, peaks.x_px[one])]
    kept = [part for part in parts if part.size >= rows_min]
    slope = np.zeros(len(peaks))
    of = np.full(len(peaks), -1, np.int64)
    for number, part in enumerate(kept):
        of[part] = number
        slope[part] = _slopes(peaks.row[part], peaks.x_px[part])
    top, bottom = _ends(peaks, kept, at_end=False), _ends(peaks, kept, at_end=True)
    mine = np.flatnonzero(of >= 0)
    pairs = _pairs(peaks.row[mine], peaks.x_px[mine], slope[mine], of[mine])
    spacing = _spacing(pairs)
    off, gap, faces = _offs(top, bottom, spacing)
    through = (gap > 0) & (gap <= _THROUGH_ROWS + 1) & (np.abs(off) <= _THROUGH_OFF)
    through &= np.abs(np.arctan(bottom.slope)[:, None] - np.arctan(top.slope)[None, :]) <= _THROUGH_TURN
    # only where neither end has another candidate
    through &= (through.sum(axis=1, keepdims=True) == 1) & (through.sum(axis=0, keepdims=True) == 1)
    return TracedPieces(
        kept, top, bottom, _sides(pairs, spacing), _left_of(peaks.row[mine], of[mine], len(kept)), off, gap,
        faces, through, _at_border(top, peaks.image_size, spacing),
        _at_border(bottom, peaks.image_size, spacing), _spacing_at(spacing, top.x_px, top.row),
    )  # fmt: skip


class _Pairs(NamedTuple):
    """Peaks next to each other in a row.

    Their pieces, the middle between them, their distance square to the stripes, px, and the angle, rad.
    """

    left: Integers
    right: Integers
    row: Integers
    x_px: Floats
    square_px: Floats
    turn: Floats


def _cut(part: Integers, x_px: Floats) -> list[Integers]:
    """Cut a trace where it steps aside from where it was going on both sides, or turns sharply."""
    if part.size <= 2 * _CUT_ROWS:
        return [part]
    window = np.lib.stride_tricks.sliding_window_view(x_px, _CUT_ROWS)
    at = np.arange(_CUT_ROWS) - 0.5 * (_CUT_ROWS - 1)
    mean, slope = window.mean(axis=1), window @ (at / (at**2).sum())
    above, below = slice(0, -_CUT_ROWS), slice(_CUT_ROWS, None)  # windows that end and begin at a step
    between = 0.5 * _CUT_ROWS * (slope[above] + slope[below])
    # step between two windows beyond what their slopes explain, square to the stripe
    aside = np.abs(mean[below] - mean[above] - between) / np.sqrt(1.0 + (between / _CUT_ROWS) ** 2)
    turn = np.abs(np.arctan(slope[above]) - np.arctan(slope[below]))
    worst = np.maximum(aside / _STEP_ASIDE_PX, turn / _TURN_MAX)
    # where it is worst of its surroundings, so that one step makes one cut
    at_step = (worst > 1.0) & (worst >= np.roll(worst, 1)) & (worst > np.roll(worst, -1))
    return np.split(part, np.flatnonzero(at_step) + _CUT_ROWS)


def _slopes(row: Integers, x_px: Floats) -> Floats:
    """Columns a row along a piece, over `SLOPE_ROWS`."""
    at = np.arange(row.size)
    before, after = np.maximum(at - SLOPE_ROWS // 2, 0), np.minimum(at + SLOPE_ROWS // 2, row.size - 1)
    slope: Floats = (x_px[after] - x_px[before]) / np.maximum(row[after] - row[before], 1)
    return slope


def _ends(peaks: Peaks, kept: list[Integers], *, at_end: bool) -> Ends:
    tip = -1 if at_end else 0
    part = slice(-SLOPE_ROWS, None) if at_end else slice(0, SLOPE_ROWS)
    slope = [
        float(np.polyfit(peaks.row[k[part]] - peaks.row[k[tip]], peaks.x_px[k[part]], 1)[0])
        if k.size > 2
        else 0.0
        for k in kept
    ]
    at = np.array([k[tip] for k in kept], np.int64)
    return Ends(peaks.row[at], peaks.x_px[at], np.array(slope, np.float64))


def _pairs(row: Integers, x_px: Floats, slope: Floats, of: Integers) -> _Pairs:
    k = np.flatnonzero(np.diff(row) == 0)
    lean = np.sqrt(1.0 + np.clip(slope[k] * slope[k + 1], 0.0, None))
    middle = 0.5 * (x_px[k] + x_px[k + 1])
    turn = np.abs(np.arctan(slope[k]) - np.arctan(slope[k + 1]))
    return _Pairs(of[k], of[k + 1], row[k], middle, (x_px[k + 1] - x_px[k]) / lean, turn)


def _spacing(pairs: _Pairs) -> Floats:
    """Fit the logarithm of the distance of neighbours over the image: most pairs are neighbours."""
    if not pairs.row.size:
        return np.zeros(3)
    log = np.log(np.maximum(pairs.square_px, 1e-3))
    fit = np.array([np.median(log), 0.0, 0.0])
    if log.size < _FIT_PAIRS_MIN:
        return fit
    terms = np.column_stack([np.ones(log.size), pairs.x_px, pairs.row])
    for _ in range(_FIT_ROUNDS):
        # robust: pairs over a missing stripe are log 2 = 0.69 off, beyond the limit
        near = np.abs(log - terms @ fit) < _FIT_WITHIN
        if near.sum() < _FIT_PAIRS_MIN:
            break
        fit = np.linalg.lstsq(terms[near], log[near], rcond=None)[0]
    return fit


def _spacing_at(spacing: Floats, x_px: Floats, row: NDArray[np.generic]) -> Floats:
    at: Floats = np.exp(np.clip(spacing[0] + spacing[1] * x_px + spacing[2] * row, -3.0, 12.0))
    return at


def _sides(pairs: _Pairs, spacing: Floats) -> dict[tuple[int, int], Side]:
    ratio = pairs.square_px / _spacing_at(spacing, pairs.x_px, pairs.row)
    order = np.lexsort((pairs.right, pairs.left))
    left, right, ratio, turn = pairs.left[order], pairs.right[order], ratio[order], pairs.turn[order]
    cuts = np.flatnonzero((np.diff(left) != 0) | (np.diff(right) != 0)) + 1
    return {
        (int(left[k[0]]), int(right[k[0]])): Side(
            int(k.size), float(np.median(ratio[k])), bool(np.median(turn[k]) <= _TURN_MAX)
        )
        for k in np.split(np.arange(left.size), cuts)
        if k.size
    }


def _left_of(row: Integers, of: Integers, count: int) -> Flags:
    """Say who stands left of whom, at any distance."""
    found = np.zeros((count, count), np.bool_)
    for step in range(1, row.size):
        same = row[step:] == row[:-step]
        if not same.any():
            break
        found[of[:-step][same], of[step:][same]] = True
    return found


def _offs(top: Ends, bottom: Ends, spacing: Floats) -> tuple[Floats, Integers, Flags]:
    """Give (upper, lower) offsets, spacings, rows from end to beginning, and whether they face each other."""
    gap = top.row[None, :] - bottom.row[:, None]
    slope = 0.5 * (bottom.slope[:, None] + top.slope[None, :])
    beside = (bottom.x_px[:, None] + slope * gap - top.x_px[None, :]) / np.sqrt(1.0 + slope**2)
    off = beside / _spacing_at(spacing, top.x_px, top.row)[None, :]
    turn = np.abs(np.arctan(bottom.slope)[:, None] - np.arctan(top.slope)[None, :])
    faces = (gap > -_OVERLAP_ROWS) & (np.abs(off) <= _FACES)
    return np.where((gap > 0) & (turn <= _TURN_MAX), off, np.inf), gap, faces


def _at_border(ends: Ends, size: tuple[int, int], spacing: Floats) -> Flags:
    reach = _BORDER_SPACINGS * _spacing_at(spacing, ends.x_px, ends.row)
    beside = (ends.x_px < reach) | (ends.x_px > size[1] - 1 - reach)
    border: Flags = beside | (ends.row < _BORDER_ROWS) | (ends.row >= size[0] - _BORDER_ROWS)
    return border
