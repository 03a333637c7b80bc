"""A product's slices in the order in which they cut the belt, with what they stand for.

Model. A plane of light cuts the product; points of the cut are integrated to an area that stands for the way
to the neighbouring planes, which lean and fan out (`slice_areas`).

Assumed: a slice is seen from row to row, and what is missing between two curves of it goes straight or is a
hole. It fails, and refuses, with fewer than three slices, below the belt, and for planes of light along X.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Product, Profiles
from roemetry.records.arrays import Flags, Floats, Integers, Labels
from roemetry_kernels.compiling import float_kernel, kernel

LEAST_SLICES = 3  # for a course between them and its bend
_CLEFT_SLICES = 3  # single skeins, dented and folded ones too, fall deep on one stripe at most
_SUNKEN_MM = 1.0  # below its neighbours, from which on a slice counts as a cleft


class Slices(NamedTuple):
    """Slices with points on the product, along rising rest X."""

    stripe: Integers
    """(n,) stripe of each."""
    t_mm: Floats
    area_mm2: Floats
    width_mm: Floats
    loose_mm2: Floats
    filled_mm2: Floats
    open_mm2: Floats
    held_mm: Floats
    """t_mm, area_mm2, width_mm, loose_mm2, filled_mm2, open_mm2, held_mm: (n,) rest X; area; extent along Y;
    of the area, what was bridged beyond the outermost points that were seen, and what a straight line fills
    over missing rows; what one over a hole would hold; half the ways to both neighbours."""
    table: Floats
    """(n, 17) all columns of `roemetry_volume.slice_table`."""
    profiles: Profiles
    place: Integers
    """profiles, place: the points, in the order of the rows, and where each slice is in them, shape (n,)."""
    reach_mm: tuple[float, float]
    limited: tuple[bool, bool]
    """reach_mm, limited: at both ends: distance to the next stripe (the mean spacing where there is none),
    and whether there is one."""
    lean: tuple[float, float]
    """Of the planes of light of both outer slices: how far they go outwards, away from the product, for each
    millimetre upwards; negative where they lean over it."""
    missing: int
    """Stripes between others on the product without a point."""
    seen_mm3: float
    joined_mm3: float
    assumed_mm3: float
    """seen_mm3, joined_mm3, assumed_mm3: what was seen, what was bridged along a stripe, what stands over
    stripes without a point."""
    most_filled_mm2: float
    most_hole_mm: float
    lowest_mm: float
    rows_px: tuple[float, float]
    """most_filled_mm2, most_hole_mm, lowest_mm, rows_px: of all slices the largest area that a straight line
    fills, the largest length left out as a hole, the lowest height, and the first and last row."""


def slices_of(product: Product) -> Slices:
    """Cut a product into its slices.

    Raises
    ------
    StageError
        Fewer than three stripes lie on the product, it looks like two side by side, a slice lies below the
        belt, or a plane of light runs along X.
    """
    table, profiles = table_of(product.profiles, product.number)
    lit, held, whole, rows, by_column = in_order(table, profiles.stripe, profiles.frame, profiles.plane)
    if not lit.size:
        raise StageError("no stripe on the product", hint="there is nothing to sum; look at the coding")
    if lit.size < LEAST_SLICES:
        raise StageError(
            f"only {lit.size} {'stripe lies' if lit.size == 1 else 'stripes lie'} on the product: what is "
            "between and beyond is not known",
            hint="a finer fan of stripes, or a larger product",
        )
    told = whole.tolist()
    if told[UNKNOWN] >= 0.0:
        named = int(profiles.stripe[int(told[UNKNOWN])]) + 1
        raise StageError(f"the plane of stripe {named} runs along X: slices have no spacing there")
    if not told[LEAST_GAP] > 0.0:
        raise StageError("two slices lie at the same place", hint="one slice for each stripe and frame")
    stripe = profiles.stripe[lit]
    if told[CLOVEN] >= _CLEFT_SLICES:
        _refuse_cloven(int(told[CLOVEN]), lit.size)
    if told[LEAST_AREA] < 0.0:
        _refuse_sunken(rows, stripe)
    ends = [told[BEFORE], told[AFTER]]
    limited = [not math.isnan(end) for end in ends]
    before, after = (end if known else told[USUAL] for end, known in zip(ends, limited, strict=True))
    return Slices(
        stripe=stripe,
        t_mm=by_column[AT],
        area_mm2=by_column[AREA],
        width_mm=by_column[WIDTH],
        loose_mm2=by_column[LOOSE],
        filled_mm2=by_column[FILLED],
        open_mm2=by_column[OPEN],
        held_mm=held,
        table=rows,
        profiles=profiles,
        place=lit,
        reach_mm=(before, after),
        limited=(limited[0], limited[1]),
        lean=(told[LEANS[0]], told[LEANS[1]]),
        missing=int(told[MISSING]),
        seen_mm3=told[SEEN_MM3],
        joined_mm3=told[JOINED_MM3],
        assumed_mm3=told[ASSUMED_MM3],
        most_filled_mm2=told[MOST_FILLED],
        most_hole_mm=told[MOST_HOLE],
        lowest_mm=told[LOWEST],
        rows_px=(told[UPPERMOST], told[LOWERMOST]),
    )


def _refuse_cloven(deep: int, slices: int) -> None:
    """Refuse what falls deep between two humps on so many stripes that it is hardly one product."""
    if deep >= slices / 3.0:
        raise StageError(
            f"on {deep} of {slices} stripes the surface falls by over {CLEFT_SHARE:.0%} between two humps: "
            "two products side by side, labelled as one, have no volume in common",
            hint="keep products apart on the belt",
        )


def _refuse_sunken(rows: Floats, stripe: Integers) -> None:
    """Refuse a product of which a slice lies below the belt as a whole."""
    depth = -rows[:, AREA] / np.maximum(rows[:, WIDTH], 1e-9)
    worst = int(depth.argmax())
    if depth[worst] > _SUNKEN_MM:
        raise StageError(
            f"the slice of stripe {int(stripe[worst]) + 1} lies {depth[worst]:.1f} mm below the belt: no "
            "product does",
            hint="look at the coding, the calibration and the belt's zero",
        )


def table_of(profiles: Profiles, number: int) -> tuple[Floats, Profiles]:
    """Give the kernel's table; points in any order are put into that of the rows first, and given back so."""
    # most often they are in order: sorted only where the kernel says that they are not
    for _ in range(2):
        table: Floats
        table, ordered = slice_areas(
            profiles.xyz_mm,
            profiles.product,
            profiles.seen,
            profiles.row_px,
            profiles.plane,
            profiles.frame,
            number,
        )
        if ordered:
            break
        profiles = _in_rows(profiles)
    return table, profiles


def _in_rows(profiles: Profiles) -> Profiles:
    order = np.argsort(profiles.row_px, axis=1, kind="stable")

    def moved(values: Any) -> Any:
        return np.take_along_axis(values, order, axis=1)

    return replace(
        profiles,
        xyz_mm=np.take_along_axis(profiles.xyz_mm, order[:, :, None], axis=1),
        product=moved(profiles.product),
        seen=moved(profiles.seen),
        x_px=moved(profiles.x_px),
        row_px=moved(profiles.row_px),
        height_std_mm=moved(profiles.height_std_mm),
    )


AT, AREA, SEEN, BRIDGED, FILLED, WIDTH, HOLE, TOP, LOW, COUNT, FIRST_ROW, LAST_ROW, CLEFT, LOOSE = range(14)
OPEN, WALL, SQUARE = 14, 15, 16
"""Columns of the table: rest X (mm); area (mm²) and its parts by kind of point; width (mm); length left out
as a hole (mm); highest and lowest Z (mm); number of points; first and last row (px); how deep the surface
falls between two humps, over the lower one; area bridged beyond the outermost points that were seen, and that
of straight lines over what is left out as a hole (mm²); mean square of the heights of both ends (mm²);
∫ z² dy (mm³) over the slice's own points, without tails and gaps: over their area, the mean height weighed by
the area."""

_STEP_MAX = 1.5  # rows; a larger step between neighbours means that rows are missing
_HOLE_SHARE = 0.3  # of the slice's top: a gap with both ends lower is a hole down to the belt
_GAP_SHARE = 0.4  # of the slice's length: a wider gap is left out as a hole
_STEP_SHARE = 0.15  # of the slice's top
_LEVEL_ROWS, _LEVEL_SHARE = 4, 0.3  # rows beside a step, and how much of it they may fall by
_END_ROWS = 4  # at either end that may see belt beside the product
_JUMP, _JUMP_MM = 2.2, 0.8
"""Of a height there: times the next rise, and mm. At 1.76 or 2.75 times volumes change by up to 0.3 %,
without the rule by up to 3.7 %."""
_TAIL_POINTS = 12
"""Points of a slice's end that say how it goes on: about two millimetres, over which a dome is a parabola.
With 10 or 15 volumes change by up to 0.3 %."""
_Y, _Z, _ROW, _SEEN = range(4)  # columns of a slice's points


@float_kernel
def slice_areas(
    xyz_mm: Floats,
    product: Labels,
    seen: Flags,
    row_px: Floats,
    plane: Floats,
    frame: Integers,
    number: int,
) -> tuple[Floats, bool]:
    """Give each slice's area per millimetre of rest X, so that area times spacing is a visible volume.

    A plane of light is X = t + q·(y − y₀) + r·z with t where it cuts the belt at the product's middle Y;
    q′ and r′ are the slopes of straight lines through all planes' q and r over t. A point of height z counts
    with z·(1 + q′(y − y₀)) + r′(z² + w²)/2, where w is the height of the wall below the slice's ends (root
    mean square of the two): light that leans passes over a wall on its far side, and Green's theorem turns
    what it passes over, on both sides together, into that term.

    Each point stands for half the way to each of its neighbours; at a curve's end as much outwards as
    inwards. Up to four rows at either end are left out where the height jumps. Between two curves of a slice
    the area is bridged by a straight line, unless both ends are low (below 0.3 of the slice's top) or the gap
    is wide (over 0.4 of the slice): then it is a hole, and nothing is counted there. A wide one between two
    levels is none: light runs along a step's wall there, which the camera does not see.

    Parameters
    ----------
    xyz_mm, product, seen, row_px, plane, frame : ndarray
        As in `Profiles`.
    number
        Number of the product.

    Returns
    -------
    table : ndarray, shape (slice, 17)
        Columns as named above; in the order of `Profiles`.
    ordered : bool
        False where a slice's points are not in the order of rows: then the table is not valid.
    """
    slices, points = product.shape
    table = np.zeros((slices, 17))
    # the product's points one after another: y, z, row, and 1 where they were seen
    on = np.empty((slices * points, 4))
    begin = np.zeros(slices + 1, np.int64)
    low_y, high_y = np.inf, -np.inf
    length, rows = 0.0, 0.0
    ordered = True
    count = 0
    for i in range(slices):
        for k in range(points):
            if product[i, k] != number or not np.isfinite(xyz_mm[i, k, 2]):
                continue
            y, row = xyz_mm[i, k, 1], row_px[i, k]
            low_y, high_y = min(low_y, y), max(high_y, y)
            if count > begin[i]:
                step = row - on[count - 1, _ROW]
                if step <= 0.0:
                    ordered = False
                elif step <= _STEP_MAX:
                    length += abs(y - on[count - 1, _Y])
                    rows += step
            on[count, _Y], on[count, _Z], on[count, _ROW], on[count, _SEEN] = (
                y,
                xyz_mm[i, k, 2],
                row,
                seen[i, k],
            )
            count += 1
        begin[i + 1] = count
    # what a point without a neighbour stands for
    per_row = length / rows if rows > 0.0 else np.nan
    y0 = 0.5 * (low_y + high_y)
    slope_y, slope_z = _fan(plane, y0, table)
    highest = np.empty(points)
    for i in range(slices):
        _area(table[i], on[begin[i] : begin[i + 1]], highest, y0, slope_y, slope_z, per_row)
    return table, ordered


@float_kernel
def _fan(plane: Floats, y0: float, table: Floats) -> tuple[float, float]:
    """Write t of each slice; give how fast the planes' slopes dX/dy and dX/dz change with t, per mm."""
    slices = plane.shape[0]
    mean_t, mean_y, mean_z = 0.0, 0.0, 0.0
    # of a plane n·X = d dX/dy is −n_y/n_x and dX/dz −n_z/n_x
    for i in range(slices):
        nx = plane[i, 0]
        table[i, AT] = (plane[i, 3] - plane[i, 1] * y0) / nx if abs(nx) > 1e-9 else np.nan
        mean_t += table[i, AT] / slices
        mean_y -= plane[i, 1] / nx / slices if abs(nx) > 1e-9 else 0.0
        mean_z -= plane[i, 2] / nx / slices if abs(nx) > 1e-9 else 0.0
    tt, ty, tz = 0.0, 0.0, 0.0
    for i in range(slices):
        off = table[i, AT] - mean_t
        tt += off * off
        ty += off * (-plane[i, 1] / plane[i, 0] - mean_y) if abs(plane[i, 0]) > 1e-9 else 0.0
        tz += off * (-plane[i, 2] / plane[i, 0] - mean_z) if abs(plane[i, 0]) > 1e-9 else 0.0
    # all at one place: no change is known
    if not tt > 0.0:
        return 0.0, 0.0
    return ty / tt, tz / tt


@float_kernel
def _area(
    out: Floats, on: Floats, highest: Floats, y0: float, slope_y: float, slope_z: float, per_row: float
) -> None:
    """Write one slice's row of the table."""
    count = on.shape[0]
    out[COUNT] = count
    if count == 0:
        return
    top, low = -np.inf, np.inf
    for m in range(count):
        top, low = max(top, on[m, _Z]), min(low, on[m, _Z])
    out[TOP], out[LOW] = top, low
    first, last = _outermost_seen(on)
    nothing_seen = first == count
    belt_y = on[0, _Y], on[count - 1, _Y]
    if first < count:
        on = on[first : last + 1]
    start, stop = _trimmed(on)
    on = on[start:stop]
    bridged = first > 0 and first < count, first < count and last < count - 1
    count = stop - start
    out[FIRST_ROW], out[LAST_ROW] = on[0, _ROW], on[count - 1, _ROW]
    wall = 0.5 * (on[0, _Z] ** 2 + on[count - 1, _Z] ** 2)
    out[WALL] = wall
    out[CLEFT] = _cleft(on, highest)
    widest = _GAP_SHARE * abs(on[count - 1, _Y] - on[0, _Y])
    fan = y0, slope_y, slope_z, wall
    # summed up here, not in the table: a write there would make all of the slice be read anew
    width, area, square, on_seen, on_bridged, loose = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    inwards = np.nan
    for m in range(count):
        y, z, row, is_seen = on[m, _Y], on[m, _Z], on[m, _ROW], on[m, _SEEN]
        outwards, gap = np.nan, False
        if m < count - 1:
            gap = on[m + 1, _ROW] - row > _STEP_MAX
            if not gap:
                outwards = abs(y - on[m + 1, _Y])
        before, after = inwards, outwards
        inwards = outwards
        # at a curve's end as much outwards as inwards
        if np.isnan(before):
            before = after
        if np.isnan(after):
            after = before
        span = per_row if np.isnan(before) else 0.5 * (before + after)
        part = span * _weighed(y, z, fan)
        width += span
        area += part
        square += span * z * z
        if is_seen > 0.0:
            on_seen += abs(part)
        else:
            on_bridged += abs(part)
        if nothing_seen:
            loose += abs(part)
        if gap:
            farthest = np.inf if _is_step(on, m, top) else widest
            _gap(out, on[m], on[m + 1], fan, top, per_row, farthest)
    # a bridge leads down to the belt there; the dome's own course does better
    for end in range(2):
        if bridged[end]:
            tail, reach = _tail(on, end, belt_y[end])
            edge = on[0 if end == 0 else count - 1]
            if edge[_Z] > 0.0:
                tail *= _weighed(edge[_Y], edge[_Z], fan) / edge[_Z]
            width += reach
            area += tail
            on_bridged += abs(tail)
            loose += abs(tail)
    out[WIDTH] += width
    out[AREA] += area
    out[SQUARE] = square
    out[SEEN], out[BRIDGED], out[LOOSE] = on_seen, on_bridged, loose


@float_kernel
def _tail(on: Floats, end: int, belt_y: float) -> tuple[float, float]:
    """Give area and width between a slice's outermost seen point and the belt that is seen beyond it.

    A dome's y is a parabola of z near its rim, z = rim + √(α·d): fitted to the outermost points, it is
    followed down to where it turns, which is the rim, or to the belt, but not beyond where belt was seen.
    Of what does not fall, the edge lies anywhere up to there: half of it counts.
    """
    count = on.shape[0]
    first, step = (0, 1) if end == 0 else (count - 1, -1)
    y0, z0 = on[first, _Y], on[first, _Z]
    most = abs(belt_y - y0)
    sign = 1.0 if belt_y > y0 else -1.0
    row = abs(on[first + step, _Y] - y0) if count > 1 else 0.0
    used = min(_TAIL_POINTS, count)
    # d = b·h + c·h², outwards from the outermost point over the height above it
    hh, hhh, hhhh, dh, dhh = 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(1, used):
        d, h = sign * (on[first + m * step, _Y] - y0), on[first + m * step, _Z] - z0
        hh += h * h
        hhh += h * h * h
        hhhh += h * h * h * h
        dh += d * h
        dhh += d * h * h
    # least squares of the two terms
    determinant = hh * hhhh - hhh * hhh
    half = 0.5 * most * z0 - 0.5 * row * z0, max(0.5 * most - 0.5 * row, 0.0)
    if used < _TAIL_POINTS or not determinant > 1e-9 * hh * hhhh:
        return half
    b, c = (dh * hhhh - dhh * hhh) / determinant, (dhh * hh - dh * hhh) / determinant
    # no parabola that goes outwards: a line
    if not b < 0.0:
        c, b = 0.0, dh / hh
    if not b < 0.0:
        return half
    stop = -z0
    if c < 0.0:
        stop = max(stop, -0.5 * b / c)
    # not beyond where belt was seen
    if (b + c * stop) * stop > most:
        inside = b * b + 4.0 * c * most
        stop = 2.0 * most / (b - np.sqrt(max(inside, 0.0)))
    beyond = stop * (b * (z0 + 0.5 * stop) + c * stop * (z0 + 2.0 / 3.0 * stop))
    return beyond - 0.5 * row * z0, max((b + c * stop) * stop - 0.5 * row, 0.0)


@float_kernel
def _outermost_seen(on: Floats) -> tuple[int, int]:
    """First and last place among a slice's points that was seen; of none, all are beyond."""
    count = on.shape[0]
    first, last = count, count
    for m in range(count):
        if on[m, _SEEN] > 0.0:
            first = min(first, m)
            last = m
    return first, last


@float_kernel
def _trimmed(on: Floats) -> tuple[int, int]:
    """Leave out rows at a slice's ends that see a part of the belt beside the product.

    Blur makes of the two a peak in between. There the height jumps, and then rises evenly.
    """
    count = on.shape[0]
    start, stop = 0, count
    if count < 4 * _END_ROWS:
        return start, stop
    for k in range(_END_ROWS):
        here, inner, next_one = on[k, _Z], on[k + 1, _Z], on[k + 2, _Z]
        # a jump, and then an even rise
        if inner - here > max(_JUMP_MM, _JUMP * (next_one - inner)):
            start = k + 1
        m = count - 1 - k
        here, inner, next_one = on[m, _Z], on[m - 1, _Z], on[m - 2, _Z]
        if inner - here > max(_JUMP_MM, _JUMP * (next_one - inner)):
            stop = m
    return start, stop


@float_kernel
def _cleft(on: Floats, before: Floats) -> float:
    """Deepest fall below the lower of the highest points on either side, over that; from 0 to 1."""
    count = on.shape[0]
    highest = 0.0
    for m in range(count):
        highest = max(highest, on[m, _Z])
        before[m] = highest
    highest, deepest = 0.0, 0.0
    for m in range(count - 1, -1, -1):
        z = on[m, _Z]
        highest = max(highest, z)
        hump = min(before[m], highest)
        # most points are the highest yet from one side
        if z < hump and hump > 0.0:
            deepest = max(deepest, 1.0 - max(z, 0.0) / hump)
    return deepest


@float_kernel
def _is_step(on: Floats, m: int, top: float) -> bool:
    """Whether a slice is level up to a gap and beyond it, but not as high: light met a wall there."""
    if m < _LEVEL_ROWS or m + 1 + _LEVEL_ROWS >= on.shape[0]:
        return False
    step = abs(on[m + 1, _Z] - on[m, _Z])
    falls = max(abs(on[m, _Z] - on[m - _LEVEL_ROWS, _Z]), abs(on[m + 1 + _LEVEL_ROWS, _Z] - on[m + 1, _Z]))
    return step > _STEP_SHARE * top and falls < _LEVEL_SHARE * step


@float_kernel
def _gap(
    out: Floats,
    one: Floats,
    other: Floats,
    fan: tuple[float, float, float, float],
    top: float,
    row: float,
    widest: float,
) -> None:
    """Bridge the rows between two curves of a slice, or count them as a hole."""
    span = max(abs(other[_Y] - one[_Y]) - row, 0.0)
    mean = 0.5 * (_weighed(one[_Y], one[_Z], fan) + _weighed(other[_Y], other[_Z], fan))
    if span > widest or (one[_Z] < _HOLE_SHARE * top and other[_Z] < _HOLE_SHARE * top):
        out[HOLE] += span
        out[OPEN] += abs(span * mean)
        return
    out[WIDTH] += span
    out[AREA] += span * mean
    out[FILLED] += abs(span * mean)


@float_kernel
def _weighed(y: float, z: float, fan: tuple[float, float, float, float]) -> float:
    """Height times the local spacing over that on the belt, mm."""
    y0, slope_y, slope_z, wall = fan
    return z * (1.0 + slope_y * (y - y0)) + 0.5 * slope_z * (z * z + wall)


BEFORE, AFTER, USUAL, MISSING, SEEN_MM3, JOINED_MM3, ASSUMED_MM3, LEAST_GAP, UNKNOWN = range(9)
MOST_FILLED, MOST_HOLE, LOWEST, UPPERMOST, LOWERMOST, LEAST_AREA, CLOVEN = range(9, 16)
LEANS = 16, 17
CLEFT_SHARE = 0.3
"""What `in_order` says of all slices: distances from the outer ones to the next stripe outside (NaN:
there is none) and mean spacing, mm; stripes between without a point; volumes that are seen, joined along a
stripe, and over stripes without a point, mm³; smallest distance of two slices, mm; the first slice of the
table whose place is not known, or −1; and of the slices that have points the largest area filled (mm²) and
length left out (mm), the lowest height (mm), the first and last row (px), the least area (mm²), how many
fall by over `CLEFT_SHARE` between two humps, and how far the planes of both outer ones go outwards for each
millimetre upwards."""


@kernel
def in_order(
    table: Floats, stripe: Integers, frame: Integers, plane: Floats
) -> tuple[Integers, Floats, Floats, Floats, Floats]:
    """Sort the slices that have points along rising rest X.

    Parameters
    ----------
    table
        From `slice_areas`.
    stripe, frame : ndarray of int64, shape (slice,)
        As in `Profiles`: within a frame stripe numbers tell of stripes without a point; a scan's frames
        overlap as they like.
    plane : ndarray of float64, shape (slice, 4)
        As there.

    Returns
    -------
    lit : ndarray of int64, shape (n,)
        Rows of the table, sorted.
    held_mm : ndarray of float64, shape (n,)
        Half the ways to both neighbours, nothing beyond the outer ones.
    whole : ndarray of float64, shape (18,)
        As named above.
    rows : ndarray of float64, shape (n, 17)
        The table's rows, sorted.
    columns : ndarray of float64, shape (16, n)
        The same by column, each in one piece.
    """
    whole = np.full(18, np.nan)
    whole[UNKNOWN] = -1.0
    lit = np.empty(table.shape[0], np.int64)
    count = 0
    for i in range(table.shape[0]):
        if np.isnan(table[i, AT]) and whole[UNKNOWN] < 0.0:
            whole[UNKNOWN] = i
        if table[i, COUNT] > 0.0:
            # sorted by insertion, since they are nearly in order
            k = count
            while k > 0 and table[lit[k - 1], AT] > table[i, AT]:
                lit[k] = lit[k - 1]
                k -= 1
            lit[k] = i
            count += 1
    lit = lit[:count]
    held = np.zeros(count)
    rows, columns = np.empty((count, table.shape[1])), np.empty((table.shape[1], count))
    if count == 0 or whole[UNKNOWN] >= 0.0:
        return lit, held, whole, rows, columns
    own = np.zeros(count)
    spacings, missing, least = 0.0, 0.0, np.inf
    for k in range(count - 1):
        one, other = lit[k], lit[k + 1]
        gap = table[other, AT] - table[one, AT]
        least = min(least, gap)
        # stripes between without a point; frames of a scan tell nothing of each other
        step = max(abs(stripe[other] - stripe[one]), 1) if frame[one] == frame[other] else 1
        missing += step - 1
        spacings += gap / step
        for end in (k, k + 1):
            held[end] += 0.5 * gap
            own[end] += 0.5 * gap / step
    first, last = table[lit[0], AT], table[lit[count - 1], AT]
    before, after = np.inf, np.inf
    for i in range(table.shape[0]):
        at = table[i, AT]
        if at < first:
            before = min(before, first - at)
        if at > last:
            after = min(after, at - last)
    whole[BEFORE] = before if before < np.inf else np.nan
    whole[AFTER] = after if after < np.inf else np.nan
    whole[USUAL] = spacings / (count - 1) if count > 1 else np.nan
    whole[MISSING], whole[LEAST_GAP] = missing, least
    whole[LEANS[0]] = plane[lit[0], 2] / plane[lit[0], 0]
    whole[LEANS[1]] = -plane[lit[count - 1], 2] / plane[lit[count - 1], 0]
    seen, joined, assumed = 0.0, 0.0, 0.0
    filled, hole, lowest, upper, lower = 0.0, 0.0, np.inf, np.inf, -np.inf
    least_area, cloven = np.inf, 0.0
    for k in range(count):
        mine = rows[k]
        for column in range(mine.size):
            mine[column] = table[lit[k], column]
            columns[column, k] = mine[column]
        least_area = min(least_area, mine[AREA])
        cloven += 1.0 if mine[CLEFT] > CLEFT_SHARE else 0.0
        filled, hole, lowest = max(filled, mine[FILLED]), max(hole, mine[HOLE]), min(lowest, mine[LOW])
        upper, lower = min(upper, mine[FIRST_ROW]), max(lower, mine[LAST_ROW])
        on, between = mine[SEEN], mine[BRIDGED] + mine[FILLED]
        seen += on * own[k]
        joined += between * own[k]
        # over stripes without a point nothing was seen
        assumed += (on + between) * (held[k] - own[k])
    whole[LEAST_AREA], whole[CLOVEN] = least_area, cloven
    whole[SEEN_MM3], whole[JOINED_MM3], whole[ASSUMED_MM3] = seen, joined, assumed
    whole[MOST_FILLED], whole[MOST_HOLE], whole[LOWEST] = filled, hole, lowest
    whole[UPPERMOST], whole[LOWERMOST] = upper, lower
    return lit, held, whole, rows, columns


@kernel
def three_outer(t: Floats, at_end: int) -> tuple[int, int, int]:
    """Numbers of the outer slice and of the next ones that lie 0.08 and 0.17 of the whole length inwards."""
    n = t.size
    step = 1 if at_end == 0 else -1
    i = 0 if at_end == 0 else n - 1
    span = t[n - 1] - t[0]
    j = 1
    while j < n - 2 and abs(t[i + step * j] - t[i]) < 0.08 * span:
        j += 1
    k = j + 1
    while k < n - 1 and abs(t[i + step * k] - t[i]) < 0.17 * span:
        k += 1
    return i, i + step * j, i + step * k
