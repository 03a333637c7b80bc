"""Which dot is which, on the empty belt and on boards, before anything is known of the projector.

On the belt the whole matrix is seen: its dots are followed from neighbour to neighbour, columns from left
to right and dots in a column from the top, and must be as many as the pattern has. On boards parts of it
are seen, displaced. If light comes from one point, the right numbering of one board's dots makes all lines
from the belt's dot to the board's meet in that point, and seen from it the dots of all other boards lie on
dots of the belt, too. A numbering that is off by a column makes lines meet as well, if the board is level,
but in a point from which boards at other heights do not fit. So every offset of every board is tried, and
judged by all.

It fails where boards are all at one height (refused: two numberings fit alike), and where the matrix is
turned by more than 45° in the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records.arrays import Floats, Integers

_NEAR = 0.3  # of the step to a neighbour: what lies so near to where it is expected is that neighbour
_FULL = 0.97  # share of the matrix that must be seen on the empty belt
_ON_DOT = 0.15
"""Of the spacing: a dot that lies so near to one of the belt, seen from the projector, is the same."""
_FITS = 0.6  # share of the boards' dots that must lie on dots of the belt: half lie there by chance at 0.35
_OTHER = 0.85  # of the best point's share, that another point may have at most
_PAIRS_MIN = 20  # dots of a board by which an offset is tried
_MEET_MM = 1.0  # lines that pass their common point by more than this do not meet
_OTHER_NUMBERS = 0.1
"""Share of the dots that another point numbers otherwise, from which on it is another numbering."""


def followed(xy_px: Floats) -> Integers:
    """Give (n, 2) column and line of dots (n, 2), from 0; −1 of what does not hang together with the rest."""
    from scipy.spatial import cKDTree

    found = np.full((len(xy_px), 2), -1)
    if len(xy_px) < 4:
        return found
    tree = cKDTree(xy_px)
    near = tree.query(xy_px, min(9, len(xy_px)))[1][:, 1:]
    way = xy_px[near] - xy_px[:, None]
    length = np.hypot(way[..., 0], way[..., 1])
    steps = []
    for axis in (0, 1):
        # ahead along this axis rather than across it
        ahead = way[..., axis] > np.abs(way[..., 1 - axis])
        nearest = np.where(ahead, length, np.inf).argmin(axis=1)
        some = ahead.any(axis=1)
        if not some.any():
            return found
        steps.append(np.median(way[some, nearest[some]], axis=0))
    basis = np.array(steps)
    # from the middle outwards
    start = int(tree.query(np.median(xy_px, axis=0))[1])
    at = {start: (0, 0)}
    own = {start: basis}
    waiting = [start]
    while waiting:
        here = waiting.pop(0)
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            step = own[here][axis]
            away, other = tree.query(xy_px[here] + sign * step)
            if away > _NEAR * np.hypot(*step) or other in at:
                continue
            at[other] = (at[here][0] + sign * (axis == 0), at[here][1] + sign * (axis == 1))
            turned = own[here].copy()
            # steps follow the perspective: half the old one, half the new
            turned[axis] = 0.5 * (step + sign * (xy_px[other] - xy_px[here]))
            own[other] = turned
            waiting.append(other)
    who, place = np.array(list(at)), np.array(list(at.values()))
    # of two dots at one place the first counts
    _, first = np.unique(place, axis=0, return_index=True)
    found[who[first]] = place[first] - place.min(axis=0)
    return found


def on_belt(xy_px: Floats, columns: int, lines: int, name: str) -> Integers:
    """Number the dots on the empty belt: (n, 2) column and line, −1 of what is none.

    Raises
    ------
    CalibrationError
        The dots that are seen are not the pattern's: of another number, or swapped.
    """
    at = followed(xy_px)
    seen = at[at[:, 0] >= 0]
    if not len(seen):
        raise CalibrationError(f"{name}: no dots are seen", hint="is the laser on?")
    across, down = (int(n) for n in seen.max(axis=0) + 1)
    expected = f"the pattern has {columns} columns of {lines} dots"
    if (across, down) == (lines, columns) and lines != columns:
        raise CalibrationError(
            f"{name}: {across} columns of {down} dots are seen, {expected}: are columns and lines "
            "swapped, or is the image turned?",
            hint="columns run down the image: exchange `stripes` and `lines`, or set turn_deg",
        )
    if (across, down) != (columns, lines) or len(seen) < _FULL * columns * lines:
        raise CalibrationError(
            f"{name}: {len(seen)} dots in {across} columns of {down} are seen, {expected}",
            hint="is this the right pattern? Is the belt empty, all of the pattern in view, no dot saturated "
            "or too faint for the extractor?",
        )
    return at


def numbered_on_boards(
    belt_mm: Floats, belt_at: Integers, boards_mm: Sequence[Floats], boards_px: Sequence[Floats]
) -> tuple[list[Integers], Floats]:
    """Number the dots on boards by those on the belt.

    Of the belt's dots (n, 3) places, whose Z is 0, and (n, 2) column and line are given; of each board's
    (m, 3) places in the same frame, and (m, 2) where they are seen. Gives of each board (m, 2) column and
    line, −1 of what is no dot, and the point the light comes from, (3,).

    Raises
    ------
    CalibrationError
        No point of light explains the boards' dots, or two do.
    """
    count = belt_at.max(axis=0) + 1
    index = np.full(count, -1)
    index[belt_at[:, 0], belt_at[:, 1]] = np.arange(len(belt_at))
    points: list[Floats] = []
    for place, seen in zip(boards_mm, boards_px, strict=True):
        at = followed(seen)
        on = at[:, 0] >= 0
        at, place = at[on], place[on]
        if len(at) < _PAIRS_MIN:
            continue
        high = at.max(axis=0)
        for offset in product(range(-high[0], count[0]), range(-high[1], count[1])):
            moved = at + np.array(offset)
            inside = ((moved >= 0) & (moved < count)).all(axis=1)
            if inside.sum() < max(_PAIRS_MIN, len(at) // 2):
                continue
            pair = index[moved[inside, 0], moved[inside, 1]]
            point = _meeting(belt_mm[pair[pair >= 0]], place[inside][pair >= 0])
            if point is not None:
                points.append(point)
    everywhere = np.concatenate(boards_mm) if boards_mm else np.empty((0, 3))
    to_lattice = _Lattice(belt_mm, belt_at)
    found = [to_lattice.of(point, everywhere) for point in points]
    shares = np.array([near.mean() for _, near in found])
    if not points or shares.max() < _FITS:
        most = f"{shares.max():.0%}" if len(shares) else "none"
        raise CalibrationError(
            "the dots on the boards are not those on the empty belt: from no place of the projector do they "
            f"lie on dots of the belt (at best {most} of them)",
            hint="did projector or camera move between the images? Does all light come from one projector?",
        )
    best, near = found[int(shares.argmax())]
    for other, others_near in (found[n] for n in np.flatnonzero(shares > _OTHER * shares.max())):
        both = near & others_near
        # another numbering differs on many dots
        if not both.any() or (best[both] != other[both]).any(axis=1).mean() >= _OTHER_NUMBERS:
            raise CalibrationError(
                "the dots on the boards can be numbered in two ways",
                hint="take boards at more different heights, and tilted",
            )
    ends = np.cumsum([len(place) for place in boards_mm])[:-1]
    return np.split(best, ends), points[int(shares.argmax())]


def _meeting(belt_mm: Floats, board_mm: Floats) -> Floats | None:
    """Give the point in which lines from belt to board meet above both; None if they do not."""
    way = board_mm - belt_mm
    some = np.linalg.norm(way, axis=1) > 1e-3
    if some.sum() < _PAIRS_MIN:
        return None
    point, off_mm = nearest_point(belt_mm[some], way[some])
    # light comes from above the board
    good = point[2] > board_mm[:, 2].max() and float(np.median(off_mm)) < _MEET_MM
    return point if good else None


def nearest_point(start_mm: Floats, way: Floats) -> tuple[Floats, Floats]:
    """Give the point nearest to lines through (n, 3) places along (n, 3) ways, and (n,) how far each passes.

    NaN where the lines are parallel.
    """
    way = way / np.linalg.norm(way, axis=1)[:, None]
    # what lies across each line
    across = np.eye(3) - way[:, :, None] * way[:, None, :]
    matrix = across.sum(axis=0)
    if np.linalg.cond(matrix) > 1e8:
        return np.full(3, np.nan), np.full(len(way), np.nan)
    point = np.linalg.solve(matrix, (across @ start_mm[:, :, None]).sum(axis=0)[:, 0])
    return point, np.linalg.norm((across @ (point - start_mm)[:, :, None])[..., 0], axis=1)


class _Lattice:
    """From places on the belt to columns and lines, by a cubic through the numbered dots."""

    def __init__(self, belt_mm: Floats, at: Integers) -> None:
        self._middle = belt_mm[:, :2].mean(axis=0)
        self._reach = np.abs(belt_mm[:, :2] - self._middle).max()
        powers = self._powers(belt_mm[:, :2])
        self._coefficients = np.linalg.lstsq(powers, at.astype(np.float64), rcond=None)[0]
        self._count = at.max(axis=0) + 1

    def of(self, light_mm: Floats, place_mm: Floats) -> tuple[Integers, np.ndarray]:
        """Give (n, 2) the dot whose ray from a point passes nearest, and whether it passes near."""
        share = light_mm[2] / (light_mm[2] - place_mm[:, 2])
        on_belt = light_mm[:2] + (place_mm[:, :2] - light_mm[:2]) * share[:, None]
        found = self._powers(on_belt) @ self._coefficients
        at = np.rint(found)
        near = (np.abs(found - at) < _ON_DOT).all(axis=1)
        near &= ((at >= 0) & (at < self._count)).all(axis=1)
        return np.where(near[:, None], at, -1).astype(np.int64), near

    def _powers(self, place_mm: Floats) -> Floats:
        x, y = ((place_mm - self._middle) / self._reach).T
        return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])
