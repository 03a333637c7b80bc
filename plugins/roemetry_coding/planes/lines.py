"""The image sorted along epipolar lines, on which stripes keep their order; and the traces that cross them.

Model. A plane through the camera's and the projector's centre cuts the image in an epipolar line, and every
plane of light in a ray. Along that line the stripes of an opaque surface appear in their order, whatever the
lens and the viewing angle; along an image row they do so only nearly (Hartley and Zisserman, Multiple View
Geometry, 2nd edition, chapter 9). Let u be the cotangent of the angle between a line of sight and the base
from camera to projector. On line e the line of sight at u meets plane of light k at the height

    z = (α u + β) / (γ u + δ),        u = (δ z − β) / (α − γ z),

with four numbers for each line and plane: meeting a ray with a plane is a projective map of the line. Lines
are spaced by the angle that one image row takes up in the middle of the image, so there are about as many as
rows.

A trace (peaks joined from row to row) crosses many lines and has one entry on each: its peak nearest there.
Entries of one trace on neighbouring lines are tied: another stripe from one line to the next costs
`tie_whole` within a piece, `tie_cut` where the trace was cut, and up to `tie_gap` over a gap if the two ends
point at each other. Ends of belt and of a body that do are tied little more than at a cut: the rim of a round
body may stand as high all round as displaces a stripe by one spacing, and then each of its stripes goes on
from its neighbour's belt. That is one coincidence, not one for each stripe.

Assumes camera and planes of light in one frame, belt at z = 0. Without a projector's centre the planes'
common point nearest to the camera stands for it; with parallel planes, a telecentric view or no view at all,
image rows are taken, and heights from rest lines and displacements: right for a distant camera. Fails where
the image shows the projector or a lens folds the lines: then rows are taken as well.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.records import Peaks
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.calibration import Calibration
from roemetry.records.view import View
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.lens import camera_of, rays_through

_LINES_MAX_FACTOR = 4
"""More lines than so many times the rows: the base points nearly along the view; rows are taken instead."""
_BORDER_PX = 0.5
"""The image ends half a pixel beyond the centres of its outermost pixels, px."""
_PARALLEL = 1e-3
"""Planes, or base and view, within so many radians of parallel have no stable common point."""
GAP_ROWS = 20
"""Longest gap along a trace that is tied over, rows."""
OVERLAP_ROWS = 4
"""On lines over so many rows both what lies before an edge and what lies behind it may be seen: light spreads
over it by some two rows from either side."""
_TIE_LOOSE = 1.8
"""What even two ends that hardly point at each other are tied by: little more than a cut."""
_END_PX = (1.5, 0.25)
"""How far an end may point past the other, px, and how much more for each row of the gap: a trace's slope
over six rows is known to about 0.25 px a row."""
_SLOPE_LINES = 6
"""Lines that an end's slope is taken over; of wider lines these are more rows, and the slope is surer."""


class EpipolarLines(NamedTuple):
    """Peaks and planes of light on the epipolar lines of an image."""

    line: Floats
    u: Floats
    """line, u: (peak,) place across the lines, counted in lines from 0 (not rounded), and along them; u
    increases with the stripe."""
    plane: Floats
    """(line, stripe, 4) α, β, γ, δ, see above, mm."""
    lean: Floats
    """(peak,) how far the line of sight goes towards higher stripes for each millimetre down."""
    enters: Floats
    leaves: Floats
    """enters, leaves: (stripe,) lines on which the rest lines enter and leave the image."""
    u_min: Floats
    u_max: Floats
    """u_min, u_max: (line,) where each line enters and leaves the image; NaN where it does not cross it."""

    def every(self, apart: int) -> EpipolarLines:
        """Leave every so many lines; places are counted in these."""
        if apart == 1:
            return self
        plane, u_min, u_max = (
            np.ascontiguousarray(one[::apart]) for one in (self.plane, self.u_min, self.u_max)
        )
        line, enters, leaves = (one / apart for one in (self.line, self.enters, self.leaves))
        return EpipolarLines(line, self.u, plane, self.lean, enters, leaves, u_min, u_max)


class Entries(NamedTuple):
    """Peaks as they stand on the sight lines: a trace has one entry on each line it crosses."""

    start: Integers
    """(line + 1,) where each line's entries begin; they are sorted by u."""
    peak: Integers
    u: Floats
    """peak, u: (entry,) the peak, and its place on the line."""
    before: Integers
    after: Integers
    """before, after: (entry,) the entry of the same trace on the line before and after, −1 for none."""
    tie: Floats
    """(entry,) what it costs to have another stripe than the entry before."""
    apart: int = 1
    """Image rows from one line to the next, about."""


def epipolar_lines(peaks: Peaks, calibration: Calibration, rest_px: Floats) -> EpipolarLines:
    """Sort peaks along epipolar lines, or along image rows where the calibration knows no centres.

    Parameters
    ----------
    peaks
        The frame's peaks.
    calibration
        Its `view` gives camera and planes; without one, or with a telecentric one, rows are taken, and
        heights from rest lines and displacements.
    rest_px
        (stripe, row) rest lines, px.
    """
    view = calibration.view
    if view is not None and not view.telecentric:
        sight = _sight_of(view)
        if sight is not None:
            found = _epipolar(peaks, sight, rest_px)
            if found is not None:
                return found
    return _rows(peaks, calibration, rest_px)


@kernel
def entries_of(
    trace: Integers, piece: Integers, loose: Flags, belt: Flags, lines: EpipolarLines, u_per_px: float,
    ties: tuple[float, float, float], apart: int,
) -> Entries:  # fmt: skip
    """Put every trace once on each line that it crosses, and tie it to itself across lines.

    Parameters
    ----------
    trace, piece
        (peak,) trace; and which piece of the trace between cuts.
    loose
        (peak,) True where a piece may change its stripe from row to row.
    belt
        (peak,) True where a piece follows a rest line, or was cut off from one that does.
    lines
        The peaks' places.
    u_per_px
        Change of u for a pixel.
    ties
        Cost of a change of stripe within a piece, at a cut, and over a gap.
    apart
        Image rows from one line to the next, about.
    """
    line, u, count_lines = lines.line, lines.u, lines.plane.shape[0]
    peaks = trace.shape[0]
    before, after = _neighbours(trace)
    # each peak answers for the lines nearer to it than to its trace's neighbours
    low = np.empty(peaks, np.int64)
    high = np.empty(peaks, np.int64)
    count = np.zeros(count_lines + 1, np.int64)
    for p in range(peaks):
        # half way to the trace's neighbours, or half a line beyond its ends
        a = line[p] - 0.5 if before[p] < 0 else 0.5 * (line[p] + line[before[p]])
        b = line[p] + 0.5 if after[p] < 0 else 0.5 * (line[p] + line[after[p]])
        # a trace that runs back across the lines: ends are open on the other side
        if (before[p] >= 0 and line[before[p]] > line[p]) or (after[p] >= 0 and line[after[p]] < line[p]):
            a = line[p] + 0.5 if before[p] < 0 else a
            b = line[p] - 0.5 if after[p] < 0 else b
        if a > b:
            a, b = b, a
        low[p] = max(0, int(np.ceil(a)))
        high[p] = min(count_lines - 1, int(np.ceil(b)) - 1)
        # number of entries of each line, for the arrays
        for e in range(low[p], high[p] + 1):
            count[e + 1] += 1
    start = np.cumsum(count)
    size = start[-1]
    peak = np.empty(size, np.int64)
    place = np.empty(size)
    fill = start[:-1].copy()
    for p in range(peaks):
        for e in range(low[p], high[p] + 1):
            k = fill[e]
            # insertion by u; traces come row by row, so most are in order already
            while k > start[e] and place[k - 1] > u[p]:
                place[k], peak[k] = place[k - 1], peak[k - 1]
                k -= 1
            place[k], peak[k] = u[p], p
            fill[e] += 1
    up, down, tie = _tied(start, peak, place, trace, piece, loose, belt, u_per_px, ties, apart)
    return Entries(start, peak, place, up, down, tie, apart)


def _rows(peaks: Peaks, calibration: Calibration, rest_px: Floats) -> EpipolarLines:
    rows, columns = peaks.image_size
    # z = (x − rest) / displacement: the projective map without its denominator
    per_px = np.broadcast_to(1.0 / calibration.displacement_px_per_mm[:, None], rest_px.shape).T
    zero, one = np.zeros_like(per_px), np.ones_like(per_px)
    # as fresh arrays, like those of epipolar lines: for other layouts every kernel would be compiled again
    plane = np.ascontiguousarray(np.stack([per_px, -rest_px.T * per_px, zero, one], axis=2))
    return EpipolarLines(
        peaks.row.astype(np.float64),
        peaks.x_px.copy(),
        plane,
        np.zeros(len(peaks)),
        np.zeros(rest_px.shape[0]),
        np.full(rest_px.shape[0], rows - 1.0),
        np.full(rows, -_BORDER_PX),
        np.full(rows, columns - _BORDER_PX),
    )


def _projector(view: View) -> Floats | None:
    """Give where the light comes from; if only planes are known, their point nearest to the camera."""
    # a calibrated projector first; planes alone give their common point
    if np.isfinite(view.projector_mm).all():
        return np.asarray(view.projector_mm)
    normal, distance = view.planes[:, :3], view.planes[:, 3]
    # all normals nearly parallel: the planes have no common point within reach
    size = np.linalg.svd(normal, compute_uv=False)
    if size.size < 2 or size[1] < _PARALLEL * size[0]:
        return None
    # least squares of n·X = d from the camera: the nearest of all points that fit equally
    away = np.linalg.lstsq(normal, distance - normal @ view.camera_mm, rcond=_PARALLEL)[0]
    return np.asarray(view.camera_mm + away)


class _Sight(NamedTuple):
    """A view, and directions in the belt frame by which places on its epipolar lines are told."""

    view: View
    base: Floats
    forward: Floats
    side: Floats
    """base, forward, side: to the projector; square to it where the camera looks; and square to both."""
    camera: Floats
    """(12,) see `roemetry_kernels.lens.camera_of`."""

    def placed(self, xy_px: Floats) -> tuple[Floats, Floats, Floats]:
        """Give (point,) the angle about the base at which a pixel looks, rad, and a cotangent along it.

        And the (point, 3) direction itself.
        """
        if self.camera.size:
            return placed_by_camera(xy_px, self.camera, self.view.T_belt_camera, *self[1:4])
        way = self.view.rays(xy_px)[1]
        ahead, beside = way @ self.forward, way @ self.side
        # a line of sight along the base itself has no angle
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (way @ self.base) / np.hypot(ahead, beside)
        return np.arctan2(beside, ahead), u, way


@float_kernel
def placed_by_camera(
    xy_px: Floats, camera: Floats, pose: Floats, base: Floats, forward: Floats, side: Floats
) -> tuple[Floats, Floats, Floats]:
    """Give what `_Sight.placed` does; `camera` as there, `pose` as `View.T_belt_camera`."""
    ways = rays_through(xy_px, camera, pose)[1]
    angle, u = np.empty(ways.shape[0]), np.empty(ways.shape[0])
    for k in range(u.size):
        along, ahead, beside = 0.0, 0.0, 0.0
        for n in range(3):
            along += ways[k, n] * base[n]
            ahead += ways[k, n] * forward[n]
            beside += ways[k, n] * side[n]
        angle[k], u[k] = math.atan2(beside, ahead), along / math.sqrt(ahead * ahead + beside * beside)
    return angle, u, ways


@lru_cache(maxsize=4)
def _sight_of(view: View) -> _Sight | None:
    projector_mm, (rows, columns) = _projector(view), view.image_size
    if projector_mm is None:
        return None
    base = projector_mm - view.camera_mm
    base = base / np.linalg.norm(base)
    middle = view.rays(np.array([[(columns - 1) / 2.0, (rows - 1) / 2.0]]))[1][0]
    forward = middle - (middle @ base) * base
    if np.linalg.norm(forward) < _PARALLEL:
        # the camera looks along the base: lines would run out from the image's middle
        return None
    forward = np.asarray(forward / np.linalg.norm(forward))
    return _Sight(view, base, forward, np.cross(base, forward), camera_of(view))


class _Fan(NamedTuple):
    """The epipolar lines of a view, whatever is seen on them."""

    first: float
    step: float
    """first, step: angle of the first line, and from line to line, rad."""
    plane: Floats
    u_min: Floats
    u_max: Floats
    """plane, u_min, u_max: as in `EpipolarLines`."""


@lru_cache(maxsize=4)
def _fan_of(view: View, sign: float) -> _Fan | None:
    """Lay the lines of a view a row apart; `sign` is −1 where u falls with the stripe."""
    sight, (rows, columns) = _sight_of(view), view.image_size
    if sight is None:
        return None
    angle_border, u_border, _ = sight.placed(_border(rows, columns))
    if not np.isfinite(u_border).all() or np.ptp(angle_border) > np.pi / 2:
        return None  # the image shows the projector, or sees it through a lens that folds
    centre = np.stack([np.full(rows, (columns - 1) / 2.0), np.arange(rows, dtype=np.float64)], axis=1)
    # an image row's angle in the middle of the image
    step = float(np.median(np.diff(sight.placed(centre)[0])))
    # from the border where the angles begin, in the direction in which rows do
    first = float(angle_border.min() if step > 0 else angle_border.max())
    count = int(np.ptp(angle_border) / abs(step)) + 2 if step else 0
    if not 0 < count <= _LINES_MAX_FACTOR * rows:
        return None
    plane = _planes(sight, first + step * np.arange(count, dtype=np.float64), sign)
    u_min, u_max = np.full(count, np.inf), np.full(count, -np.inf)
    # border places by line; each line takes the extremes of those that fall on it
    at = np.clip(np.rint((angle_border - first) / step).astype(np.int64), 0, count - 1)
    np.minimum.at(u_min, at, sign * u_border)
    np.maximum.at(u_max, at, sign * u_border)
    # a line that meets the border in one place or none does not cross the image
    outside = ~(u_min < u_max)
    u_min[outside] = u_max[outside] = np.nan
    return _Fan(first, step, plane, u_min, u_max)


def _epipolar(peaks: Peaks, sight: _Sight, rest_px: Floats) -> EpipolarLines | None:
    stripes, rows = rest_px.shape
    # the outer stripes in the middle row, and where each enters and leaves the image
    rest = np.concatenate([rest_px[[0, -1], rows // 2], rest_px[:, 0], rest_px[:, -1]])
    row = np.repeat([rows / 2.0, 0.0, rows - 1.0], [2, stripes, stripes])
    angle_rest, across, _ = sight.placed(np.stack([rest, row], axis=1))
    # u must rise with the stripe: seen on the middle row
    sign = 1.0 if across[1] >= across[0] else -1.0
    fan = _fan_of(sight.view, sign)
    if fan is None:
        return None
    angle, u, ways = sight.placed(np.stack([peaks.x_px, peaks.row.astype(np.float64)], axis=1))
    planes = sight.view.planes
    # towards higher stripes, along the belt: the mean of the planes' normals, with the sign in which their
    # distances rise
    towards = np.array([*planes[:, :2].mean(axis=0), 0.0])
    towards *= np.sign(np.median(np.diff(planes[:, 3] / (planes @ np.array([*towards, 0.0])))))
    # per millimetre down, since lines of sight go down
    lean = (ways @ towards) / (-ways[:, 2] * np.linalg.norm(towards))
    enters, leaves = ((angle_rest[2:] - fan.first) / fan.step).reshape(2, stripes)
    line = (angle - fan.first) / fan.step
    return EpipolarLines(line, sign * u, fan.plane, lean, enters, leaves, fan.u_min, fan.u_max)


def _planes(sight: _Sight, angle: Floats, sign: float) -> Floats:
    """(line, stripe, 4) numbers that give height from the place on a line."""
    view, base = sight.view, sight.base
    # direction of sight at angle: the part of it square to the base; u adds that along the base
    ahead = np.cos(angle)[:, None] * sight.forward + np.sin(angle)[:, None] * sight.side
    normal = view.planes[:, :3]
    along = normal @ base
    away = ahead @ normal.T
    # distance of the camera from each plane
    reach = view.planes[:, 3] - normal @ view.camera_mm
    camera_z = view.camera_mm[2]
    # from camera height + t · direction, t where the plane is met, with u as the unknown
    alpha = np.broadcast_to(sign * (camera_z * along + reach * base[2]), away.shape)
    beta = camera_z * away + reach * ahead[:, 2:]
    gamma = np.broadcast_to(sign * along, away.shape)
    return np.ascontiguousarray(np.stack([alpha, beta, gamma, away], axis=2))


def _border(rows: int, columns: int) -> Floats:
    """Places along the image's border, px, close enough that each line meets two."""
    y = np.arange(0.0, rows, 0.25) - _BORDER_PX + 0.125
    x = np.arange(0.0, columns, 0.25) - _BORDER_PX + 0.125
    left, right = np.full_like(y, -_BORDER_PX), np.full_like(y, columns - _BORDER_PX)
    top, bottom = np.full_like(x, -_BORDER_PX), np.full_like(x, rows - _BORDER_PX)
    return np.concatenate(
        [np.stack([left, y], 1), np.stack([right, y], 1), np.stack([x, top], 1), np.stack([x, bottom], 1)]
    )


@kernel
def _neighbours(trace: Integers) -> tuple[Integers, Integers]:
    peaks = trace.shape[0]
    last = np.full(peaks + 1, -1, np.int64)
    before = np.full(peaks, -1, np.int64)
    after = np.full(peaks, -1, np.int64)
    for p in range(peaks):
        q = last[trace[p]]
        before[p] = q
        if q >= 0:
            after[q] = p
        last[trace[p]] = p
    return before, after


@kernel
def _tied(
    start: Integers, peak: Integers, place: Floats, trace: Integers, piece: Integers, loose: Flags,
    belt: Flags, u_per_px: float, ties: tuple[float, float, float], apart: int,
) -> tuple[Integers, Integers, Floats]:  # fmt: skip
    tie_whole, tie_cut, tie_gap = ties
    size = peak.shape[0]
    up = np.full(size, -1, np.int64)
    down = np.full(size, -1, np.int64)
    tie = np.zeros(size)
    last = np.full(trace.shape[0] + 1, -1, np.int64)
    line_of = np.empty(size, np.int64)
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            line_of[i] = e
            # of this trace, on the line before, not yet tied on
            j = last[trace[peak[i]]]
            if j >= 0 and line_of[j] == e - 1 and down[j] < 0:
                up[i], down[j] = j, i
                whole = piece[peak[i]] == piece[peak[j]] and not loose[peak[i]]
                tie[i] = tie_whole if whole else tie_cut
            last[trace[peak[i]]] = i
    # over gaps: from a beginning back to the end that points at it best; at a rim that says little
    for e in range(start.shape[0] - 1):
        for i in range(start[e], start[e + 1]):
            if up[i] >= 0:
                continue
            # 1 is what an end may be off at most
            best, found = 1.0, -1
            for back in range(1, GAP_ROWS // apart + 1):
                if e - back < 0:
                    break
                for j in range(start[e - back], start[e - back + 1]):
                    # only open ends, of other traces
                    if down[j] >= 0 or trace[peak[j]] == trace[peak[i]]:
                        continue
                    # mean slope of both ends over the gap
                    slope = 0.5 * (_slope(j, up, place, -1) + _slope(i, down, place, 1))
                    off = abs(place[j] + slope * back - place[i]) / u_per_px
                    most = _END_PX[0] + _END_PX[1] * back * apart
                    if off / most < best:
                        best, found = off / most, j
                if found >= 0:
                    break
            # nearest line first: a farther end is only asked where no nearer one points here
            if found >= 0:
                up[i], down[found] = found, i
                tie[i] = _TIE_LOOSE
                # belt to belt or body to body; at a rim only the loose tie
                if belt[peak[i]] == belt[peak[found]]:
                    tie[i] += tie_gap * (1.0 - best)
    return up, down, tie


@kernel
def _slope(i: int, to: Integers, place: Floats, sign: int) -> float:
    """Change of u from line to line near an end, over up to `_SLOPE_LINES` lines."""
    k, steps = i, 0
    while steps < _SLOPE_LINES and to[k] >= 0:
        k = to[k]
        steps += 1
    # towards the end: slopes are per line downwards on both sides
    return 0.0 if steps == 0 else sign * (place[k] - place[i]) / steps
