"""Numbers for traced pieces: a piece takes one where direction and order say the same."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_coding.piece_sides import Pieces

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
_THROUGH_ROWS = 10
"""A stripe goes through beside a break if it is seen so far above and below it, rows."""


class Numbers(NamedTuple):
    """What was found.

    Attributes
    ----------
    number
        (piece,) from 0, left to right; −1 where nothing was decided.
    margin
        (piece,) how much better than the next number, 0 to 1; NaN where there is no number.
    """

    number: Integers
    margin: Floats


def numbers_of(pieces: Pieces, reach_rows: int, margin_min: float) -> Numbers:
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
        growth = _best_growth(pieces, reach_rows, margin_min, doubted, loose)
        of_breaks = {piece for pair in growth.doubtful_breaks() for piece in pair}
        of_itself = growth.loose() - of_breaks
        if not of_breaks and not of_itself:
            break
        doubted |= of_breaks
        loose |= of_itself
    number = growth.number - growth.number.min(initial=_FAR, where=growth.given)
    return Numbers(np.where(growth.given, number, -1), np.where(growth.given, growth.margin, np.nan))


_FAR = np.iinfo(np.int64).max


def _best_growth(
    pieces: Pieces, reach_rows: int, margin_min: float, doubted: set[int], loose: set[int]
) -> _Growth:
    """Let numbers spread from the longest stripe, or from another it did not reach if that gives more."""
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
        self, pieces: Pieces, reach_rows: int, margin_min: float, doubted: set[int], loose: set[int]
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
                ready, key=lambda one: (not self._skips(one[0][3]), one[0][2], one[0][1])
            )
            self._give(self.groups[best], number, margin, breaks)
            waiting.remove(best)

    def _give(self, group: list[int], number: int, margin: float, breaks: list[tuple[int, int]]) -> None:
        self.number[group], self.margin[group], self.given[group] = number, margin, True
        self.breaks += breaks

    def _verdict(self, group: list[int]) -> tuple[int, float, int, list[tuple[int, int]]] | None:
        """Give number, margin, rows side by side with what is numbered, and the breaks bridged; or None."""
        sides = list(self._sides(group))
        if not sides or len({number for number, *_ in sides}) > 1:
            return None
        number = sides[0][0]
        rows = sum(rows for _, rows, *_ in sides)
        if rows < _SIDE_ROWS or not self._in_order(group, number):
            return None
        bridged, facing, bad = self._breaks(group, number)
        if bad or (facing and not bridged) or (not bridged and rows < _ALONE_ROWS):
            return None
        mine = sum((r - 1.0) ** 2 for _, _, r, _ in sides) + sum(o**2 for o, *_ in bridged)
        one_off = sum((1.0 - abs(r - 1.0)) ** 2 for _, _, r, _ in sides) + sum(
            (1.0 - abs(o)) ** 2 for o, *_ in bridged
        )
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
            (
                first,
                pieces.off[:, first],
                pieces.faces[:, first],
                pieces.gap[:, first],
                pieces.border_top[first],
                0,
            ),
            (last, pieces.off[last], pieces.faces[last], pieces.gap[last], pieces.border_bottom[last], 1),
        ):
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
        left_over = ends & (pieces.bottom.row <= below + _THROUGH_ROWS)
        left_over |= tops & (pieces.top.row >= above - _THROUGH_ROWS)
        if not (left_over & mine).any():
            return False
        for group in self.groups:
            if self.given[group[0]] and self.number[group[0]] == number:
                first, last = pieces.top.row[group].min(), pieces.bottom.row[group].max()
                if first <= above - _THROUGH_ROWS and last >= below + _THROUGH_ROWS:
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


def _groups(pieces: Pieces) -> list[list[int]]:
    """Put together what goes through."""
    group = list(range(pieces.count))
    for upper, lower in zip(*np.nonzero(pieces.through), strict=True):
        was, now = group[lower], group[upper]
        group = [now if g == was else g for g in group]
    return [[k for k in range(pieces.count) if group[k] == g] for g in sorted(set(group))]
