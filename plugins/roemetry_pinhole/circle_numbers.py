"""Which circle is which on the empty belt and on boards, and from where they come.

On the belt all circles are seen, so in the rows through their middle there are two curves for each, in
order. Boards show parts of them. A circle's light comes from the projector: seen from there, what falls
on a board would have fallen on the belt, on a circle of the belt. So places of the projector are tried,
the points of all boards carried on to the belt, and the place from which they fall on the belt's circles
is the right one; the circle that each falls on is its number.

It fails where the belt is not empty or circles leave the view, so that no row shows all curves; and where the
projector stands farther from the camera than it is looked for (`_ASIDE`, `_UP`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records import Peaks
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.tracing import trace_fragments

_STEP_PX = 3.0  # from row to row, by which a curve that goes on moves
_LEAST_ROWS = 12  # of a curve on the belt: shorter ones are dirt
_MIDDLE_ROWS_MIN = 8  # in which as many curves are seen
_HARMONICS = 2  # of a circle's radius round the middle: on the belt circles are ellipses, nearly circles
_TRIED = 300  # points of boards that are carried to the belt for each place
_ASIDE, _UP = 0.6, (0.4, 1.6)
"""Over the camera's height: how far beside the camera, and how high, projectors are looked for."""
_STEPS, _LEVELS = 25, 7  # places along each side, and heights
_FINER = (0.5, 0.2, 0.08)  # of the first step: then the search goes on around the best
_OFF_MAX = 0.12  # mean distance from the nearest circle, spacings: by chance it is 0.19
_NUMBERED_OFF_MAX = 0.3  # of a point that is numbered


def on_belt(peaks: Peaks, use: Flags, circles: int, name: str) -> Integers:
    """Give (peak,) the half circle, from left to right, of each peak of the empty belt; −1 of none.

    Raises
    ------
    CalibrationError
        Another number of curves is seen in the rows through the circles' middle.
    """
    fragment, count = trace_fragments(peaks.row_start, peaks.x_px, _STEP_PX)
    long = use & (np.bincount(fragment, minlength=count)[fragment] >= _LEAST_ROWS)
    in_row = np.bincount(peaks.row[long], minlength=peaks.image_size[0])
    # as many as some rows show: those through the middle show all
    often = np.flatnonzero(np.bincount(in_row) >= _MIDDLE_ROWS_MIN)
    most = int(often.max(initial=0))
    if most != 2 * circles:
        raise CalibrationError(
            f"{name}: up to {most} curves are seen in a row, {circles} circles make {2 * circles}",
            hint="is the number of circles right, are all seen on both sides, and is the belt empty?",
        )
    at = np.flatnonzero(long)
    rank = np.arange(at.size) - np.searchsorted(peaks.row[at], peaks.row[at])
    full = in_row[peaks.row[at]] == most
    votes = np.zeros((count, most), np.int64)
    np.add.at(votes, (fragment[at[full]], rank[full]), 1)
    # a curve with different ranks is no one half
    one = votes.max(axis=1) == votes.sum(axis=1)
    half = np.where(one & (votes.sum(axis=1) > 0), votes.argmax(axis=1), -1)
    return np.where(long, half[fragment], -1)


class BeltCircles(NamedTuple):
    """The circles on the belt: radius by the direction from their middle."""

    middle_mm: Floats
    radius: Floats
    """(circle, 1 + 2 harmonics) of 1, cos θ, sin θ, cos 2θ, …, mm."""

    @classmethod
    def through(cls, xy_mm: Floats, half: Integers, circles: int) -> BeltCircles:
        """Fit them to labelled points (n, 2) of the belt."""
        # between both halves of the smallest circle
        inner = (half == circles - 1) | (half == circles)
        sides = [xy_mm[inner & (half == one)].mean(axis=0) for one in (circles - 1, circles)]
        middle = 0.5 * (sides[0] + sides[1])
        number = np.where(half >= circles, half - circles, circles - 1 - half)
        away = xy_mm - middle
        shape = _harmonics(np.arctan2(away[:, 1], away[:, 0]))
        far = np.hypot(away[:, 0], away[:, 1])
        radius = [
            np.linalg.lstsq(shape[number == k], far[number == k], rcond=None)[0] for k in range(circles)
        ]
        return cls(middle, np.array(radius))

    def number(self, xy_mm: Floats) -> Floats:
        """Give (n,) which circle places lie on, 0 the smallest; between two of them a broken number."""
        away = xy_mm - self.middle_mm
        radius = _harmonics(np.arctan2(away[..., 1], away[..., 0])) @ self.radius.T
        far = np.hypot(away[..., 0], away[..., 1])[..., None]
        gap = np.diff(radius, axis=-1)
        # each gap counts as far as it lies within: a number that rises evenly between circles
        steps = (far - radius[..., :-1]) / gap
        low, high = np.full(gap.shape[-1], 0.0), np.full(gap.shape[-1], 1.0)
        low[0], high[-1] = -np.inf, np.inf  # beyond the smallest and the largest spacings go on
        return np.asarray(np.clip(steps, low, high).sum(axis=-1))


def on_boards(belt: BeltCircles, points_mm: Floats, height_mm: float) -> tuple[Floats, Integers]:
    """Give where the light comes from, belt frame, mm, and (point,) circles of points (n, 3); −1 of none.

    Parameters
    ----------
    belt
        The circles on the belt.
    points_mm
        Of all boards, belt frame.
    height_mm
        Of the camera over the belt.

    Raises
    ------
    CalibrationError
        From no place the points of boards fall on circles of the belt.
    """
    # spread evenly over all boards
    some = points_mm[np.unique(np.linspace(0, len(points_mm) - 1, _TRIED).astype(np.int64))]
    aside, level = 2.0 * _ASIDE * height_mm / (_STEPS - 1), (_UP[1] - _UP[0]) * height_mm / (_LEVELS - 1)
    step = np.array([aside, aside, level])
    side = (np.arange(_STEPS) - _STEPS // 2) * aside
    up = np.linspace(*_UP, _LEVELS) * height_mm
    place, off = _best(belt, some, np.stack(np.meshgrid(side, side, up), axis=-1).reshape(-1, 3))
    around = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 3), axis=-1).reshape(-1, 3)
    for finer in _FINER:
        place, off = _best(belt, some, place + around * finer * step)
    if off > _OFF_MAX:
        raise CalibrationError(
            f"circles on boards do not lie where circles of the belt would be: they are off by {off:.2f} of "
            "the distance between two, wherever the light may come from",
            hint="were all images taken with this projector, which has not moved, and is the board described "
            "rightly?",
        )
    number = belt.number(_carried(points_mm, place))
    nearest = np.rint(number)
    known = (np.abs(number - nearest) < _NUMBERED_OFF_MAX) & (nearest >= 0) & (nearest < len(belt.radius))
    return place, np.where(known, nearest, -1).astype(np.int64)


def _best(belt: BeltCircles, points: Floats, places: Floats) -> tuple[Floats, float]:
    off = np.empty(len(places))
    for n, place in enumerate(places):
        number = belt.number(_carried(points, place))
        nearest = np.clip(np.rint(number), 0, len(belt.radius) - 1)
        # capped: what is no circle's light must not decide
        off[n] = np.minimum(np.abs(number - nearest), 0.25).mean()
    best = int(off.argmin())
    return places[best], float(off[best])


def _carried(points: Floats, place: Floats) -> Floats:
    """Give (n, 2) where light from a place that falls on points would meet the belt."""
    # similar triangles from the light through the point
    share = points[:, 2] / (place[2] - points[:, 2])
    return np.asarray(points[:, :2] + (points[:, :2] - place[:2]) * share[:, None])


def _harmonics(angle: Floats) -> Floats:
    parts = [np.ones_like(angle)]
    for n in range(1, _HARMONICS + 1):
        parts += [np.cos(n * angle), np.sin(n * angle)]
    return np.stack(parts, axis=-1)
