"""Surface, rim and border of a product, solved together from stripes and outline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from roemetry.records import Outline, Product, Profiles
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.view import View
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.lens import sight_lines
from roemetry_kernels.robust_fit import solve
from roemetry_kernels.slices import body_curves
from roemetry_volume.footprint import (
    Border,
    area_of,
    border_at,
    evenly,
    inside_by,
    nodes_within,
    placed_border,
)
from roemetry_volume.rim import Rim, StripePoints, ends_of, fitted_rim, rim_at
from roemetry_volume.spline import Grid, add_points, bending, fastest, values_at

LONG_AXIS = 0.4  # by which lengths along the product are shrunk in the plate's coordinates
_POINTS = 400  # of the outline, evenly spaced
_ROUNDS, _ROUNDS_ON = 3, 2
"""From nothing, and from a solution: a third round from it moves an uncertainty by 1.2 % at most."""
_NODES = 40, 14  # of the integral over the footprint, along and across
_RIM_WEIGHT = 6.0  # of a point of the rim in the plate
_OPEN_RATIO = 0.9
"""Of the next slice's height: a lower outer slice has begun to fall. At 0.72 nothing changes; where none of
them is taken to have fallen, volumes with an outline change by up to 1.0 %."""
_UPRIGHT = 0.95
"""Of the next slice's highest u: an outer slice so high has not begun to fall, and ends in a wall, as a box
or a broken skein does."""
_OPEN_MISS = 0.15
"""Of an outer slice's level, by which the plate through the others is lower at an open end. It matters little
by how much (± 0.04: nothing), but without the rule volumes change by up to 1.9 %."""
_OVER_RIM = 1.0  # mm²: what is hardly over the rim ends with it, upright or not
_FACING = 0.85  # cosine between the contour's normal and the product's axis: it faces the end
_BELOW_RIM_MM = 0.3  # a point so far below the rim is on the dome only
_WALL_MM = 1.5  # if it lies farther inside: nearer it is on a wall
_PROBE_MM = 1.0  # inside the contour, where the dome tells how steeply it falls
_SETTLED_MM = 0.03  # a round that moves the contour by less is the last
_FOLLOWED_MM = 0.003
"""From a solution: one round follows a calibration, an outline that moves takes a second one (with one alone
its part came out up to 12 % too small on thin skeins)."""
_WALL_REACH_MM = 0.4  # two rows: a wall that shows by less is not told from its edge
_FEW, _BELT_SHARE = 3, 0.5  # points at an end before a gap, lower than that share of the next: belt
_HALF_LINE_MM, _HALF_LINE_SHARE, _SLICES_LEAST = 0.5, 0.1, 3
"""Of a line of light about 1 mm wide, or a fifth of the distance to the next one if that is less: a slice of
which no point lies so far within the outline is the flank of one whose centre passes beside the body. On a
box its heights were 3 mm below the top and 1 mm above it."""
_ASTRAY_PX, _ASTRAY_SIGMAS = 1.5, 3.0
"""A slice's end appears in the row it is seen in, to half a row, and lens and light move an edge by less than
another pixel."""


class Start(NamedTuple):
    """What a product that differs little is solved from."""

    frame: tuple[Floats, Floats]
    """Middle of the border on the belt, mm, and the turn to along and across it."""
    height_mm: Floats
    fall_mm: Floats
    """height_mm, fall_mm: (400,) height of the edge that made the outline, and how the dome falls to it."""
    open_end: Flags
    """(400,) where the outline is a flat end's."""
    wall_shows: bool
    """Whether the outline holds the walls that face the camera."""
    beside: tuple[int, int]
    """How many slices at either end are left out, as their lines of light pass beside the body."""


@dataclass(frozen=True, eq=False, slots=True)
class FittedSurface:
    """The surface that slices and outline give together."""

    points: StripePoints
    """The product's points; `place` (n, 2) are theirs along and across the product, mm."""
    place: Floats
    rim: Rim
    border: Border
    plate: Plate
    knots: Knots
    """rim, border, plate, knots: see their classes."""
    contour: Floats
    """(400, 2) the border along and across the product, mm."""
    open_end: Any
    """(400,) true where the outline is a flat end's: no rim is asked for there."""
    height_mm: Floats
    """(400,) height of the surface over the border."""
    s: Floats
    v: Floats
    weight_mm2: Floats
    """s, v, weight_mm2: nodes and weights over the footprint."""
    start: Start
    """From which the same product is solved when it has changed a little."""

    def heights(self, values: Floats | None = None, rim_shift_mm: float = 0.0) -> Floats:
        """Height at the nodes, mm, nowhere below the belt; `values` are the plate's, if not its own."""
        u = self.plate.at(LONG_AXIS * self.s, self.v) if values is None else values
        return np.maximum(self.rim.at(self.s, self.v) + rim_shift_mm + _height(u, self.rim), 0.0)

    @property
    def volume_mm3(self) -> float:
        """Visible volume."""
        return float((self.weight_mm2 * self.heights()).sum())


def points_of(product: Product, view: View | None = None, outline: Outline | None = None) -> StripePoints:
    """Give the product's points, slice after slice, down the rows.

    What a coder has bridged beyond the outermost points it saw of a slice runs down to the belt beside the
    product, and is no part of its surface: left out, as are slices of which nothing was seen. So is, with an
    outline, what is seen beyond a gap at the end of a slice and appears outside of that: a speck. Slices
    whose lines of light pass beside the body are still there: `fit_surface` leaves them out.
    """
    profiles, number = product.profiles, product.number
    if view is None or outline is None:
        return _points_of(profiles, number)
    loose, xyz_mm = _loose_of(profiles, number)
    outside_px = -inside_by(outline.xy_px.copy(), view.project(xyz_mm)) if loose.size else np.empty(0)
    specks = loose[outside_px > _ASTRAY_PX + _ASTRAY_SIGMAS * outline.xy_std_px]
    return _points_of(profiles, number, tuple(specks.tolist()))


def _slices_beside(points: StripePoints, view: View, outline: Outline) -> tuple[int, int]:
    """Count the slices at either end whose lines of light pass beside the body; at least three are kept."""
    ring, kept = outline.xy_px.copy(), [0, points.first.size - 1]

    def is_within(xyz_mm: Floats, half_mm: float) -> bool:
        xy_px, beside_px = view.project(xyz_mm), view.project(xyz_mm + np.array([half_mm, 0.0, 0.0]))
        return bool((inside_by(ring, xy_px) > np.hypot(*(beside_px - xy_px).T)).any())

    for end, step in ((0, 1), (1, -1)):
        while kept[1] - kept[0] > _SLICES_LEAST:
            outer = kept[0] if end == 0 else kept[1] - 1
            xyz_mm, next_mm = (
                points.xyz_mm[points.first[one] : points.first[one + 1]] for one in (outer, outer + step)
            )
            apart_mm = abs(float(next_mm[:, 0].mean() - xyz_mm[:, 0].mean()))
            half_mm = min(_HALF_LINE_MM, _HALF_LINE_SHARE * apart_mm)
            middle = len(xyz_mm) // 2  # nearly always within, and then the others need not be asked
            if is_within(xyz_mm[middle : middle + 1], half_mm) or is_within(xyz_mm, half_mm):
                break
            kept[end] += step
    return kept[0], points.first.size - 1 - kept[1]


def _without_slices(points: StripePoints, beside: tuple[int, int]) -> StripePoints:
    """Leave out so many slices at either end, unless that leaves fewer than three."""
    before, after = beside
    slices = points.first.size - 1
    if not before + after or slices - before - after < _SLICES_LEAST:
        return points
    first = points.first[before : slices - after + 1]
    kept = slice(first[0], first[-1])
    return StripePoints(points.xyz_mm[kept], points.slice[kept] - before, first - first[0])


@lru_cache(maxsize=8)
def _loose_of(profiles: Profiles, number: int) -> tuple[Integers, Floats]:
    """Give what is seen at the ends of a product's slices before a gap: (n,) which points, (n, 3) mm."""
    curves = body_curves(profiles, number)
    loose = np.flatnonzero(loose_ends(curves.slice, profiles.seen[curves.slice, curves.point]))
    return loose, profiles.xyz_mm[curves.slice[loose], curves.point[loose]]


@lru_cache(maxsize=8)
def _points_of(profiles: Profiles, number: int, specks: tuple[int, ...] = ()) -> StripePoints:
    """Give them of a product's slices; where its outline alone has moved they are mostly the same."""
    curves = body_curves(profiles, number)
    slices, index = curves.slice, curves.point
    seen = profiles.seen[slices, index]
    seen[list(specks)] = False
    held = held_points(slices, seen, profiles.xyz_mm[slices, index, 2])
    slices, index = slices[held], index[held]
    begins = np.ones(slices.size, np.bool_)
    begins[1:] = slices[1:] != slices[:-1]
    first = np.append(np.flatnonzero(begins), slices.size)
    return StripePoints(profiles.xyz_mm[slices, index], np.cumsum(begins) - 1, first)


@kernel
def loose_ends(slices: Integers, seen: Flags) -> Flags:
    """Mark what is seen at the ends of slices, up to three points of each, before a gap; (n,) as below."""
    loose = np.zeros(slices.size, np.bool_)
    begin = 0
    while begin < slices.size:
        stop = begin
        while stop < slices.size and slices[stop] == slices[begin]:
            stop += 1
        for first, end, step in ((begin, stop, 1), (stop - 1, begin - 1, -1)):
            outermost, before, count = -1, -1, 0
            for k in range(first, end, step):
                if not seen[k]:
                    continue
                if before >= 0 and abs(k - before) > 1:
                    loose[min(outermost, before) : max(outermost, before) + 1] = True
                    break
                outermost = k if outermost < 0 else outermost
                before, count = k, count + 1
                if count > _FEW:
                    break
        begin = stop
    return loose & seen


@kernel
def held_points(slices: Integers, seen: Flags, z_mm: Floats) -> Flags:
    """Say which points lie between the outermost ones of their slice that were seen on the product.

    Parameters
    ----------
    slices, seen, z_mm : ndarray, shape (n,)
        Slice after slice, down the rows.
    """
    held = np.zeros(slices.size, np.bool_)
    begin = 0
    while begin < slices.size:
        stop = begin
        while stop < slices.size and slices[stop] == slices[begin]:
            stop += 1
        first, last = _outermost(seen, z_mm, begin, stop, 1), _outermost(seen, z_mm, stop - 1, begin - 1, -1)
        if first >= 0:
            held[first : last + 1] = True
        begin = stop
    return held


@kernel
def _outermost(seen: Flags, z_mm: Floats, begin: int, stop: int, step: int) -> int:
    """Give the outermost seen point at a slice's end, −1 of none.

    Up to three points at its end do not count if, behind unseen ones, the rest is far higher. They are the
    belt's: beside the product's shadow its stripe is blended, and its peak lies off.
    """
    first, before, count, highest = -1, -1, 0, 0.0
    for k in range(begin, stop, step):
        if not seen[k]:
            continue
        if first < 0:
            first, highest = k, z_mm[k]
        elif abs(k - before) > 1:
            return k if highest < _BELT_SHARE * z_mm[k] else first
        highest = max(highest, z_mm[k])
        before, count = k, count + 1
        if count > _FEW:
            break
    return first


def fit_surface(product: Product, view: View, outline: Outline, start: Start | None = None) -> FittedSurface:
    """Solve surface, rim and border together.

    Parameters
    ----------
    product, view, outline
        The product; the rig's geometry; the product's outline.
    start
        The solution of nearly the same product: a round or two from it give what three from nothing give,
        and follow small changes without the jumps of a search that ends sooner or later.
    """
    if len(outline.xy_px) == _POINTS:
        silhouette = sight_lines(view, outline)
    else:
        silhouette = view.rays(evenly(outline.xy_px, _POINTS))
    seen = points_of(product, view, outline)
    # which slices count is found once: what changes a little must not change by a slice
    beside = _slices_beside(seen, view, outline) if start is None else start.beside
    points = _without_slices(seen, beside)
    xyz = points.xyz_mm
    if start is None:
        outermost = np.concatenate([points.first[:-1], points.first[1:] - 1])
        level = np.full(_POINTS, max(0.8 * float(np.median(xyz[outermost, 2])), 0.0))
        border = border_at(silhouette, level, np.zeros(_POINTS))
        centre, turn = axes_of(border.xy_mm)
    else:
        border = border_at(silhouette, start.height_mm, start.fall_mm)
        centre, turn = start.frame
    place = (xyz[:, :2] - centre) @ turn
    ends = ends_of(points, place[:, 1])
    if start is None:
        wall_shows = _wall_shows(points, (border.xy_mm - centre) @ turn, border.tilt, place)
    else:
        wall_shows, open_end = start.wall_shows, start.open_end
    settled_mm = _SETTLED_MM if start is None else _FOLLOWED_MM
    for _ in range(_ROUNDS if start is None else _ROUNDS_ON):
        contour = (border.xy_mm - centre) @ turn
        found = under_dome(xyz, points.slice, place, *ends, contour)
        rim, knots = Rim(*found[:4]), Knots(*found[4:])
        if start is None:
            open_end = _open_ends(knots, contour, (border.outward @ turn)[:, 0])
        plate = _plate(knots, contour, open_end)
        height, fall, step, *placed = border_beside(
            plate.coefficients, plate.grid, rim.coefficients, rim.scale_mm, rim.upright, contour, turn,
            open_end, wall_shows, *silhouette, border.xy_mm, border.outward, border.tilt,
        )  # fmt: skip
        border = Border(*placed)
        if step < settled_mm:
            break
    contour = (border.xy_mm - centre) @ turn
    s, v, weight = nodes_within(contour, *_gauss(_NODES[0]), *_gauss(_NODES[1]))
    weight *= abs(area_of(contour)) / weight.sum()  # corners are between nodes
    found = Start((centre, turn), height, fall, open_end, wall_shows, beside)
    return FittedSurface(
        points, place, rim, border, plate, knots, contour, open_end, height, s, v, weight, found
    )


def axes_of(xy: Floats) -> tuple[Floats, Floats]:
    """Middle of a polygon and the turn whose columns are its long and its short axis."""
    centre = xy.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((xy - centre).T))
    long = axes[:, 1] if axes[0, 1] >= 0.0 else -axes[:, 1]
    return centre, np.column_stack([long, [-long[1], long[0]]])


@float_kernel
def under_dome(
    xyz_mm: Floats, slices: Integers, place: Floats, index: Integers, first: Integers, size: Integers,
    contour: Floats,
) -> tuple[Any, ...]:  # fmt: skip
    """Give the fields of `Rim`, then those of `Knots`, of a product's points and ends within a contour."""
    coarse = contour[::2].copy()
    fit, scale, std, upright = fitted_rim(
        xyz_mm[index, 2], place, index, first, size, inside_by(coarse, place[index])
    )
    s, v, u, weight, of = dome_knots(xyz_mm, place, slices, fit, scale, upright, coarse)
    return fit, scale, std, upright, s, v, u, weight, of


@float_kernel
def dome_knots(
    xyz_mm: Floats,
    place: Floats,
    slices: Integers,
    rim: Floats,
    scale_mm: tuple[float, float],
    upright: bool,
    contour: Floats,
) -> tuple[Floats, Floats, Floats, Floats, Integers]:
    """Give what `Knots` holds of a product's points (n, 3) along and across it (n, 2), over its rim."""
    over = xyz_mm[:, 2] - rim_at(rim, scale_mm, place[:, 0], place[:, 1])
    # what is seen of the wall below the rim is no part of the dome
    low = np.flatnonzero(over <= -_BELOW_RIM_MM)
    dome = np.ones(over.size, np.bool_)
    inside_mm = inside_by(contour, place[low])
    for k in range(low.size):
        dome[low[k]] = inside_mm[k] > _WALL_MM
    kept = np.flatnonzero(dome)
    over = over[kept]
    u = over * np.abs(over) if upright else over
    return means_of_groups(LONG_AXIS * place[kept, 0], place[kept, 1], u, slices[kept])


def _height(value: Floats, rim: Rim) -> Floats:
    """Height over the rim of the plate's value: below a dome that is the height's square, with its sign."""
    return np.sign(value) * np.sqrt(np.abs(value)) if rim.upright else value


def _open_ends(knots: Knots, contour: Floats, outward_s: Floats) -> Any:
    """Say where the outline belongs to a flat end: one towards which the slices do not fall.

    One is where the outer slice is as high as the next one. Where it is hardly lower than that at the same
    places across the product, the plate is fitted without it, once with and once without a rim beyond: a flat
    end it is if the rim makes the plate miss the slice by far. To the end belongs what lies beyond the outer
    slice, and, beyond the next one, what faces along the product: a slice at a slant runs over the edge.
    """
    is_open = np.zeros(contour.shape[0], np.bool_)
    along = LONG_AXIS * contour[:, 0]
    for end in (0, 1):
        kind, outer, inner = end_kind(knots.s, knots.v, knots.u, knots.weight, knots.slice, end)
        if kind == _FALLS:  # nearly always
            continue
        mine, next_one = knots.slice == outer, np.flatnonzero(knots.slice == inner)
        next_one = next_one[np.argsort(knots.v[next_one])]
        v, s, weight = knots.v[mine], knots.s[mine], knots.weight[mine]
        out = np.sign(s.mean() - knots.s[next_one].mean())
        past = (along - np.interp(contour[:, 1], knots.v[next_one], knots.s[next_one])) * out
        if kind == _UPRIGHT_END:
            is_open |= (outward_s * out > _FACING) & (past > 0.0)
            continue
        beside = (v >= knots.v[next_one[0]]) & (v <= knots.v[next_one[-1]])
        level = float(np.average(knots.u[mine], weights=weight))
        inner_s = np.interp(v[beside], knots.v[next_one], knots.s[next_one])
        step = float((s[beside] - inner_s).mean())
        # the outline beyond the outer slice, which may cross the product at a slant
        lean = np.polyfit(v, s, 1) if np.ptp(v) > 1.0 else np.array([0.0, s.mean()])
        beyond = (along - np.polyval(lean, contour[:, 1])) * out > 0.3 * abs(step)
        beyond |= (outward_s * out > _FACING) & (past > 0.2 * abs(step))
        others = Knots(*(getattr(knots, name)[~mine] for name in Knots.__slots__))
        misses = []
        for opened in (is_open, is_open | beyond):
            guess = _plate(others, contour, opened).at(s, v)
            misses.append(float(np.average(guess, weights=weight)) - level)
        if misses[0] < -_OPEN_MISS * level and abs(misses[1]) < 0.5 * abs(misses[0]):
            is_open |= beyond
    return is_open


_FALLS, _UPRIGHT_END, _IN_DOUBT = range(3)


@kernel
def end_kind(
    s: Floats, v: Floats, u: Floats, weight: Floats, slices: Integers, end: int
) -> tuple[int, int, int]:
    """Say whether a product falls to an end, and which slices are the outer and the next one there.

    Of fields of `Knots`, slice after slice. With fewer than four slices it falls.
    """
    first, count = np.empty(s.size + 1, np.int64), 0
    for k in range(s.size):
        if k == 0 or slices[k] != slices[k - 1]:
            first[count] = k
            count += 1
    first[count] = s.size
    if count < 4:
        return _FALLS, -1, -1
    one, other = (0, 1) if end == 0 else (count - 1, count - 2)
    mine, beyond = slice(first[one], first[one + 1]), slice(first[other], first[other + 1])
    outer, inner = slices[first[one]], slices[first[other]]
    if u[mine].max() > _UPRIGHT * u[beyond].max() > _OVER_RIM:
        return _UPRIGHT_END, outer, inner
    order = np.argsort(v[beyond], kind="mergesort")
    at_v, at_s, at_u = v[beyond][order], s[beyond][order], u[beyond][order]
    level, whole, high, below, beside = 0.0, 0.0, 0.0, 0.0, 0
    for k in range(first[one], first[one + 1]):
        level += weight[k] * u[k]
        whole += weight[k]
        if at_v[0] <= v[k] <= at_v[-1]:
            j = min(max(np.searchsorted(at_v, v[k], side="right"), 1), at_v.size - 1)
            wide = at_v[j] - at_v[j - 1] if at_v.size > 1 else 0.0
            share = (v[k] - at_v[j - 1]) / wide if wide > 0.0 else 0.0
            below += at_u[j - 1] + share * (at_u[j] - at_u[j - 1])
            high += u[k]
            beside += 1
    slants = at_s.max() - at_s.min() > LONG_AXIS * (at_v[-1] - at_v[0])
    falls = level / whole <= _OVER_RIM or high <= _OPEN_RATIO * below
    return (_FALLS if beside == 0 or slants or falls else _IN_DOUBT), outer, inner


def _plate(knots: Knots, contour: Floats, open_end: Any) -> Plate:
    rim = contour[~open_end][::2]
    return plate_through(knots, LONG_AXIS * rim[:, 0], rim[:, 1])


@float_kernel
def border_beside(
    coefficients: Floats, grid: Grid, rim: Floats, scale_mm: tuple[float, float], upright: bool,
    contour: Floats, turn: Floats, open_end: Flags, wall_shows: bool, start: Floats, way: Floats,
    xy_mm: Floats, outward: Floats, tilt: Floats,
) -> tuple[Floats, Floats, float, Floats, Floats, Floats]:  # fmt: skip
    """Give heights and falls along the border, how far it moves by them, mm, and the fields of its `Border`.

    `start` and `way` are the silhouette's lines of sight; `xy_mm`, `outward` and `tilt` the border before.
    """
    across = np.empty_like(outward)
    for k in range(tilt.size):
        for n in range(2):
            across[k, n] = outward[k, 0] * turn[0, n] + outward[k, 1] * turn[1, n]
    height, fall = edge_heights(
        coefficients, grid, rim, scale_mm, upright, contour, across, tilt, open_end, wall_shows
    )
    xy, normal, lean = placed_border(start, way, height, fall)
    return height, fall, np.abs(xy - xy_mm).max(), xy, normal, lean


@float_kernel
def edge_heights(
    coefficients: Floats,
    grid: Grid,
    rim: Floats,
    scale_mm: tuple[float, float],
    upright: bool,
    contour: Floats,
    outward: Floats,
    tilt: Floats,
    open_end: Flags,
    wall_shows: bool,
) -> tuple[Floats, Floats]:
    """Give (n,) height of the edge that made the outline, and how the dome falls to it (α, mm).

    Of a contour and its normals (n, 2), along and across the product.
    """
    n = tilt.size
    height, fall = rim_at(rim, scale_mm, contour[:, 0], contour[:, 1]), np.zeros(n)
    inner_s = LONG_AXIS * (contour[:, 0] - _PROBE_MM * outward[:, 0])
    dome = values_at(coefficients, grid, inner_s, contour[:, 1] - _PROBE_MM * outward[:, 1])
    here = values_at(coefficients, grid, LONG_AXIS * contour[:, 0], contour[:, 1])
    for k in range(n):
        dome_mm = max(dome[k], 0.0)
        if upright:
            dome_mm = np.sqrt(dome_mm)
        if tilt[k] < 0.0:
            # A wall that the camera sees ends at the belt if there is no dome above it: it is upright then.
            if wall_shows:
                height[k] *= min(2.0 * dome_mm / max(height[k], 1e-3), 1.0)
        elif open_end[k]:
            height[k] += np.sign(here[k]) * np.sqrt(abs(here[k])) if upright else here[k]
        elif upright:
            fall[k] = dome_mm * dome_mm / _PROBE_MM
    return height, fall


def _wall_shows(points: StripePoints, contour: Floats, tilt: Floats, place: Floats) -> bool:
    """Say whether the outline holds the walls that face the camera, or ends at their upper edge.

    A wall that faces the camera but not the lamp may be as dark as the shadow beside it. The stripes on top
    of an upright wall end at its edge. The contour stands at the share 0.8 of their height here: if it is the
    wall's foot they end 0.8 of tilt times height inside it, if it is the edge, 0.2 of that outside.
    """
    last = np.concatenate([points.first[:-1], points.first[1:] - 1])
    off = np.hypot(*(place[last, None, :] - contour[None, :, :]).transpose(2, 0, 1))
    facing = -tilt[off.argmin(axis=1)]
    reach_mm = facing * points.xyz_mm[last, 2]
    told = reach_mm > _WALL_REACH_MM
    if told.sum() < _FEW:
        return True
    share = inside_by(contour, place[last[told]]) / reach_mm[told]
    return bool(np.median(share) > 0.3)


@lru_cache(maxsize=8)
def _gauss(count: int) -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights


CELL_MM = 2.5  # of the grid of bending terms: products bend over some centimetres
STIFFNESS = 0.1  # of the bending against the points' misfit; the budget has what a stiffer plate would change
_RIDGE = 1e-6  # against cells that no point holds
_COURSE_RIDGE = 1e-10  # of the points' weight: places are counted in cells
_BELIEF = 10.0  # a dome's quadric leaves 0.2 % of the scatter, a skein's 7 %, that of steps nearly all
_GROUP = 5  # neighbouring points of a slice whose mean is one knot


@dataclass(frozen=True, eq=False, slots=True)
class Knots:
    """Points that the plate goes through: places (s scaled, v), values, weights, and the slice of each."""

    s: Floats
    v: Floats
    u: Floats
    weight: Floats
    slice: Integers


@kernel
def means_of_groups(
    s: Floats, v: Floats, u: Floats, slices: Integers
) -> tuple[Floats, Floats, Floats, Floats, Integers]:
    """Give what `Knots` holds: the mean of each five neighbours of a slice, which weighs as much."""
    mean, weight, of = np.zeros((3, s.size)), np.zeros(s.size), np.empty(s.size, np.int64)
    group = -1
    for k in range(s.size):
        if group < 0 or weight[group] == _GROUP or slices[k] != of[group]:
            group += 1
            of[group] = slices[k]
        weight[group] += 1.0
        mean[0, group] += s[k]
        mean[1, group] += v[k]
        mean[2, group] += u[k]
    count = group + 1
    mean = mean[:, :count] / weight[:count]
    return mean[0], mean[1], mean[2], weight[:count], of[:count]


@dataclass(frozen=True, eq=False, slots=True)
class Plate:
    """A fitted plate."""

    grid: Any
    """Of the spline, see `roemetry_volume.spline.Grid`."""
    course: Floats
    coefficients: Floats
    """course, coefficients: of the quadric through all points, and of the whole, as the spline's."""
    band: Floats
    factor: Floats
    right: Floats
    """band, factor, right: lower band of the system for what lies off the course, its Cholesky factor, and
    its right-hand side."""

    def at(self, s: Floats, v: Floats) -> Floats:
        """Value at places; s scaled."""
        places = np.ascontiguousarray(s), np.ascontiguousarray(v)
        values: Floats = values_at(self.coefficients, self.grid, *places)
        return values

    def moved_by(self, change: Floats) -> Floats:
        """Give what coefficients change by when the right-hand side changes."""
        return _solved(self.factor, change)


def _factor(band: Floats) -> Floats:
    """Give the Cholesky factor of a lower band; LinAlgError where it is not positive definite."""
    from scipy.linalg.lapack import dpbtrf  # what `cholesky_banded` calls after a third of its time

    factor, failed = dpbtrf(band, lower=1)
    if failed:
        raise np.linalg.LinAlgError(f"the plate's leading minor {failed} is not positive definite")
    return np.asarray(factor)


def _solved(factor: Floats, right: Floats) -> Floats:
    from scipy.linalg.lapack import dpbtrs

    return np.asarray(dpbtrs(factor, right, lower=1)[0])


def plate_through(knots: Knots, rim_s: Floats, rim_v: Floats, stiffness: float = 1.0) -> Plate:
    """Fit a plate through the knots and through 0 at places of the rim; `stiffness` times as stiff."""
    s, v = np.concatenate([knots.s, rim_s]), np.concatenate([knots.v, rim_v])
    grid = grid_over(s, v)
    band = _bending_of(grid[3], grid[4], stiffness * STIFFNESS).copy()
    right = np.zeros(band.shape[1])
    weight = np.concatenate([knots.weight, np.full(rim_s.size, _RIM_WEIGHT)])
    u = np.concatenate([knots.u, np.zeros(rim_s.size)])
    course = off_course(band, right, grid, s, v, u, weight)
    factor = _factor(band)
    return Plate(grid, course, course + _solved(factor, right), band, factor, right)


@lru_cache(maxsize=16)
def _bending_of(cells_s: int, cells_v: int, weight: float) -> Floats:
    """Give `bending` of a grid, which does not hang on where the grid lies."""
    return bending((0.0, 0.0, CELL_MM, cells_s, cells_v), weight, _RIDGE)


@float_kernel
def grid_over(s: Floats, v: Floats) -> Grid:
    """Give the grid that holds all places, and half a cell around them."""
    low_s, low_v = s.min() - 0.5, v.min() - 0.5
    cells_s = max(int(np.ceil((s.max() + 0.5 - low_s) / CELL_MM)), 1)
    return low_s, low_v, CELL_MM, cells_s, max(int(np.ceil((v.max() + 0.5 - low_v) / CELL_MM)), 1)


@float_kernel
def off_course(
    band: Floats, right: Floats, grid: Grid, s: Floats, v: Floats, u: Floats, weight: Floats
) -> Floats:
    """Give the quadric through all points, as the spline's coefficients; add how they lie off it to a system.

    It is taken by a share: the more of the points' scatter it leaves, the less it says of what is between.
    """
    low_s, low_v, side, cells_s, cells_v = grid
    design = np.ones((6, s.size))
    for k in range(s.size):
        a, b = (s[k] - low_s) / side, (v[k] - low_v) / side
        design[1, k], design[2, k] = a, b
        design[3, k], design[4, k], design[5, k] = a * a, a * b, b * b
    normal, c = np.empty((6, 6)), np.empty(6)
    for a in range(6):
        weighed = weight * design[a]
        c[a] = (weighed * u).sum()
        for b in range(a + 1):
            normal[a, b] = (weighed * design[b]).sum()
    ridge = _COURSE_RIDGE * normal[0, 0]
    for a in range(6):
        normal[a, a] += ridge
    solve(normal, c)
    guess = np.zeros(s.size)
    for a in range(6):
        guess += c[a] * design[a]
    mean = (weight * u).sum() / weight.sum()
    left = (weight * (u - guess) ** 2).sum() / (weight * (u - mean) ** 2).sum()
    share = max(1.0 - left, 0.0) ** _BELIEF
    add_points(band, right, grid, s, v, u - share * guess, weight)
    along_s, high = fastest(grid)
    course = np.empty((cells_s + 3) * (cells_v + 3))
    for k in range(course.size):
        # a cubic B-spline's coefficient k stands for the place k - 1; of a square it is a third less
        i, j = k // high - 1.0, k % high - 1.0
        if along_s:
            i, j = j, i
        bent = c[3] * (i * i - 1.0 / 3.0) + c[4] * i * j + c[5] * (j * j - 1.0 / 3.0)
        course[k] = share * (c[0] + c[1] * i + c[2] * j + bent)
    return course


def without_slice(plate: Plate, knots: Knots, slice_: int) -> Floats:
    """Give the coefficients of the plate that a slice had no part in, about the same course."""
    mine = knots.slice == slice_
    s, v = knots.s[mine], knots.v[mine]
    band, right = plate.band.copy(), plate.right.copy()
    off = knots.u[mine] - values_at(plate.course, plate.grid, s, v)
    add_points(band, right, plate.grid, s, v, off, -knots.weight[mine])
    return plate.course + _solved(_factor(band), right)
