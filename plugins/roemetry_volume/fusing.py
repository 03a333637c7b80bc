"""Surface, rim and border of a product, solved together from stripes and outline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from roemetry.records import Product
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.records.view import View
from roemetry_volume.rim import Rim, StripePoints, ends_of, rim_of
from roemetry_volume.silhouette import Border, area_of, border_at, evenly
from roemetry_volume.step_lines import Step, steps_at, steps_of
from roemetry_volume.surface import Knots, Plate, grouped, plate_through

LONG_AXIS = 0.4
_POINTS = 400
_ROUNDS = 3
_NODES = 40, 14
_RIM_WEIGHT = 6.0
_OPEN_RATIO = 0.9
_OPEN_MISS = 0.15
_OVER_RIM = 1.0  # mm²: what is hardly over the rim ends with it, upright or not
_FACING = 0.85
_BELOW_RIM_MM = 0.3
_WALL_MM = 1.5
_PROBE_MM = 1.0
_SETTLED_MM = 0.03
_FEW, _BELT_SHARE = 3, 0.5


@dataclass(frozen=True, eq=False, slots=True)
class Fused:
    """What was solved.

    Attributes
    ----------
    points
        The product's points, less the steps; `place` (n, 2) are theirs along and across the product, mm.
    rim, border, plate, knots
        See their classes.
    contour : ndarray, shape (400, 2)
        The border along and across the product, mm.
    open_end : ndarray, shape (400,)
        True where the outline is a flat end's: no rim is asked for there.
    height_mm : ndarray, shape (400,)
        Height of the surface over the border.
    s, v, weight_mm2
        Nodes and weights over the footprint.
    steps, over_mm
        Steps that slices cross, and how much they rise at the nodes.
    """

    points: StripePoints
    place: Floats
    rim: Rim
    border: Border
    plate: Plate
    knots: Knots
    contour: Floats
    open_end: Any
    height_mm: Floats
    s: Floats
    v: Floats
    weight_mm2: Floats
    steps: tuple[Step, ...]
    over_mm: Floats

    def heights(self, values: Floats | None = None, rim_shift_mm: float = 0.0) -> Floats:
        """Height at the nodes, mm; `values` are the plate's there, if they are not its own."""
        u = self.plate.at(LONG_AXIS * self.s, self.v) if values is None else values
        heights: Floats = self.rim.at(self.s, self.v) + rim_shift_mm + _height(u, self.rim) + self.over_mm
        return heights

    @property
    def volume_mm3(self) -> float:
        """Visible volume."""
        return float((self.weight_mm2 * self.heights()).sum())


def points_of(product: Product) -> StripePoints:
    """Give the product's points, slice after slice, down the rows.

    What a coder has bridged beyond the outermost points it saw of a slice runs down to the belt beside the
    product, and is no part of its surface: left out, as are slices of which nothing was seen.
    """
    profiles = product.profiles
    mine = (profiles.product == product.number) & np.isfinite(profiles.xyz_mm[..., 2])
    slices, index = np.nonzero(mine)
    order = np.lexsort((profiles.row_px[slices, index], slices))
    slices, index = slices[order], index[order]
    seen = profiles.seen[slices, index].copy()
    _leave_out_belt(seen, slices, profiles.xyz_mm[slices, index, 2])
    held = _between_seen(slices, seen)
    slices, index = slices[held], index[held]
    _, number = np.unique(slices, return_inverse=True)
    first = np.append(np.flatnonzero(np.diff(number, prepend=-1)), number.size)
    return StripePoints(profiles.xyz_mm[slices, index], number, first)


def _leave_out_belt(seen: Flags, slices: Integers, z_mm: Floats) -> None:
    """Count up to three points at a slice's end as unseen if, behind unseen ones, the rest is far higher.

    They are the belt's: beside the product's shadow its stripe is blended, and its peak lies off.
    """
    bounds = np.append(np.flatnonzero(np.diff(slices, prepend=-1)), slices.size)
    for begin, stop in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        places = np.flatnonzero(seen[begin:stop]) + begin
        for outermost in (places[: _FEW + 1], places[::-1][: _FEW + 1]):
            gap = np.flatnonzero(np.abs(np.diff(outermost)) > 1)
            if gap.size and z_mm[outermost[: gap[0] + 1]].max() < _BELT_SHARE * z_mm[outermost[gap[0] + 1]]:
                seen[outermost[: gap[0] + 1]] = False


def _between_seen(slices: Integers, seen: Flags) -> Flags:
    """Say which points lie between the outermost seen ones of their slice."""
    place = np.arange(slices.size)
    first = np.full(int(slices.max(initial=-1)) + 1, slices.size)
    last = np.full(first.size, -1)
    np.minimum.at(first, slices[seen], place[seen])
    np.maximum.at(last, slices[seen], place[seen])
    held: Flags = (place >= first[slices]) & (place <= last[slices])
    return held


def fuse(
    product: Product, view: View, contour_px: Floats, upright: tuple[bool, bool] = (False, False)
) -> Fused:
    """Solve surface, rim and border together.

    Parameters
    ----------
    product, view, contour_px
        The product; the rig's geometry; the outline in the image.
    upright
        Whether the slices show an upright end at low and at high X: no rim is asked for there.
    """
    from roemetry_kernels.volume.footprint import inside_by, nodes_within

    contour_px = evenly(contour_px, _POINTS)
    points = points_of(product)
    xyz = points.xyz_mm
    outermost = np.concatenate([points.first[:-1], points.first[1:] - 1])
    height = np.full(_POINTS, 0.8 * float(np.median(xyz[outermost, 2])))
    border = border_at(view, contour_px, np.maximum(height, 0.0))
    centre, turn = _axes(border.xy_mm)
    place = (xyz[:, :2] - centre) @ turn
    ends = ends_of(points, place[:, 1])
    steps = steps_of(points, place, _to_light(view, xyz) @ turn)
    if (
        steps
        and rim_of(points, ends, place, inside_by((border.xy_mm - centre) @ turn, place[ends[0]])).upright
    ):
        steps = ()  # a dome's jump is a fold or a break, which runs as it likes
    if steps:
        xyz = xyz.copy()
        xyz[:, 2] -= steps_at(steps, place[:, 0], place[:, 1])
        points = points._replace(xyz_mm=xyz)
        ends = ends_of(points, place[:, 1])
    fall = np.zeros(_POINTS)
    open_end = np.zeros(_POINTS, np.bool_)
    for _ in range(_ROUNDS):
        contour = (border.xy_mm - centre) @ turn
        coarse = contour[::2]
        rim = rim_of(points, ends, place, inside_by(coarse, place[ends[0]]))
        knots = _knots(points, place, rim, coarse)
        open_end = _open_ends(knots, contour, (border.outward @ turn)[:, 0], upright)
        plate = _plate(knots, contour, open_end)
        height, fall = _at_border(plate, rim, contour, border, (centre, turn), open_end)
        height += steps_at(steps, contour[:, 0], contour[:, 1]) * (border.tilt >= 0.0)
        moved = border_at(view, contour_px, height, fall)
        step = np.abs(moved.xy_mm - border.xy_mm).max()
        border = moved
        if step < _SETTLED_MM:
            break
    contour = (border.xy_mm - centre) @ turn
    s, v, weight = nodes_within(contour, *_gauss(_NODES[0]), *_gauss(_NODES[1]))
    weight *= abs(area_of(contour)) / weight.sum()  # corners are between nodes
    over = steps_at(steps, s, v)
    return Fused(
        points, place, rim, border, plate, knots, contour, open_end, height, s, v, weight, steps, over
    )


def _to_light(view: View, xyz: Floats) -> Floats:
    """How far along X and Y light comes for each millimetre that it is higher, at points."""
    way = view.projector_mm - xyz
    towards: Floats = way[:, :2] / way[:, 2:]
    return towards


def _axes(xy: Floats) -> tuple[Floats, Floats]:
    """Middle of a polygon and the turn whose columns are its long and its short axis."""
    centre = xy.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((xy - centre).T))
    long = axes[:, 1] if axes[0, 1] >= 0.0 else -axes[:, 1]
    return centre, np.column_stack([long, [-long[1], long[0]]])


def _knots(points: StripePoints, place: Floats, rim: Rim, contour: Floats) -> Knots:
    from roemetry_kernels.volume.footprint import inside_by

    over = points.xyz_mm[:, 2] - rim.at(place[:, 0], place[:, 1])
    # what is seen of the wall below the rim is no part of the dome
    dome = over > -_BELOW_RIM_MM
    dome[~dome] = inside_by(contour, place[~dome]) > _WALL_MM
    s, v = LONG_AXIS * place[dome, 0], place[dome, 1]
    return grouped(s, v, _value(over, rim)[dome], points.slice[dome])


def _value(over_mm: Floats, rim: Rim) -> Floats:
    """What the plate goes through: the square of the height over the rim, with its sign, below a dome."""
    return over_mm * np.abs(over_mm) if rim.upright else over_mm


def _height(value: Floats, rim: Rim) -> Floats:
    """Height over the rim of the plate's value."""
    return np.sign(value) * np.sqrt(np.abs(value)) if rim.upright else value


def _open_ends(knots: Knots, contour: Floats, outward_s: Floats, upright: tuple[bool, bool]) -> Any:
    """Say where the outline belongs to a flat end: one towards which the slices do not fall.

    Of one that the slices show to be upright it is what faces along the product.

    Where the outer slice is hardly lower than the next one at the same places across the product, the plate
    is fitted without it, once with and once without a rim beyond. A flat end it is if the rim makes the plate
    miss the slice by far. To the end belongs what lies beyond the outer slice, and, beyond the next one, what
    faces along the product: a slice at a slant runs over the edge.
    """
    is_open = np.zeros(contour.shape[0], np.bool_)
    slices = np.unique(knots.slice)
    if slices.size < 4:
        return is_open
    along = LONG_AXIS * contour[:, 0]
    for outer, inner in ((slices[0], slices[1]), (slices[-1], slices[-2])):
        mine, next_one = knots.slice == outer, np.flatnonzero(knots.slice == inner)
        next_one = next_one[np.argsort(knots.v[next_one])]
        v, s, weight = knots.v[mine], knots.s[mine], knots.weight[mine]
        out = np.sign(s.mean() - knots.s[next_one].mean())
        past = (along - np.interp(contour[:, 1], knots.v[next_one], knots.s[next_one])) * out
        if upright[int(out > 0.0)] and float(knots.u[next_one].mean()) > _OVER_RIM:
            is_open |= (outward_s * out > _FACING) & (past > 0.0)
            continue
        beside = (v >= knots.v[next_one[0]]) & (v <= knots.v[next_one[-1]])
        across = float(np.ptp(knots.v[next_one]))
        if not beside.any() or float(np.ptp(knots.s[next_one])) > LONG_AXIS * across:
            continue
        level = float(np.average(knots.u[mine], weights=weight))
        before, inner_s = (np.interp(v[beside], knots.v[next_one], x[next_one]) for x in (knots.u, knots.s))
        if level <= _OVER_RIM or float(knots.u[mine][beside].mean()) <= _OPEN_RATIO * float(before.mean()):
            continue
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


def _plate(knots: Knots, contour: Floats, open_end: Any) -> Plate:
    rim = contour[~open_end][::2]
    return plate_through(knots, LONG_AXIS * rim[:, 0], rim[:, 1], np.full(rim.shape[0], _RIM_WEIGHT))


def _at_border(
    plate: Plate, rim: Rim, contour: Floats, border: Border, frame: tuple[Floats, Floats], open_end: Any
) -> tuple[Floats, Floats]:
    """Height of the edge that made the outline, and how the dome falls to it (α, mm), along the border."""
    inner = contour - _PROBE_MM * (border.outward @ frame[1])
    dome_mm = np.maximum(_height(plate.at(LONG_AXIS * inner[:, 0], inner[:, 1]), rim), 0.0)
    level = rim.at(contour[:, 0], contour[:, 1])
    top = level + _height(plate.at(LONG_AXIS * contour[:, 0], contour[:, 1]), rim)
    # A wall that the camera sees ends at the belt if there is no dome above it: it is upright then.
    foot = level * np.clip(2.0 * dome_mm / np.maximum(level, 1e-3), 0.0, 1.0)
    height = np.where(border.tilt < 0.0, foot, np.where(open_end, top, level))
    fall = dome_mm**2 / _PROBE_MM if rim.upright else np.zeros_like(dome_mm)
    return height, np.where(open_end | (border.tilt < 0.0), 0.0, fall)


@lru_cache(maxsize=8)
def _gauss(count: int) -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights
