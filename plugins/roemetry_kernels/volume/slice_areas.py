"""Areas of a product's slices, in tilted planes of light that need not be parallel."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers, Labels
from roemetry_kernels.compiling import float_kernel

AT, AREA, SEEN, BRIDGED, FILLED, WIDTH, HOLE, TOP, LOW, COUNT, FIRST_ROW, LAST_ROW, CLEFT, LOOSE = range(14)
OPEN, WALL = 14, 15
"""Columns of the table: rest X (mm); area (mm²) and its parts by kind of point; width (mm); length left out
as a hole (mm); highest and lowest Z (mm); number of points; first and last row (px); how deep the surface
falls between two humps, over the lower one; area bridged beyond the outermost points that were seen, and that
of straight lines over what is left out as a hole (mm²); mean square of the heights of both ends (mm²)."""

_STEP_MAX = 1.5  # rows; a larger step between neighbours means that rows are missing
_HOLE_SHARE = 0.3
_GAP_SHARE = 0.4
_STEP_SHARE = 0.15  # of the slice's top
_LEVEL_ROWS, _LEVEL_SHARE = 4, 0.3
_END_ROWS = 4
_JUMP, _JUMP_MM = 2.2, 0.8
_Y, _Z, _ROW, _SEEN = range(4)


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
    table : ndarray, shape (slice, 16)
        Columns as named above; in the order of `Profiles`.
    ordered : bool
        False where a slice's points are not in the order of rows: then the table is not valid.
    """
    slices, points = product.shape
    table = np.zeros((slices, 16))
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
    start, stop = _trimmed(on)
    on = on[start:stop]
    count = stop - start
    out[FIRST_ROW], out[LAST_ROW] = on[0, _ROW], on[count - 1, _ROW]
    wall = 0.5 * (on[0, _Z] ** 2 + on[count - 1, _Z] ** 2)
    out[WALL] = wall
    out[CLEFT] = _cleft(on, highest)
    widest = _GAP_SHARE * abs(on[count - 1, _Y] - on[0, _Y])
    fan = y0, slope_y, slope_z, wall
    first, last = _outermost_seen(on)
    # summed up here, not in the table: a write there would make all of the slice be read anew
    width, area, on_seen, on_bridged, loose = 0.0, 0.0, 0.0, 0.0, 0.0
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
        if np.isnan(before):
            before = after
        if np.isnan(after):
            after = before
        span = per_row if np.isnan(before) else 0.5 * (before + after)
        part = span * _weighed(y, z, fan)
        width += span
        area += part
        if is_seen > 0.0:
            on_seen += abs(part)
        else:
            on_bridged += abs(part)
        if m < first or m > last:
            loose += abs(part)
        if gap:
            farthest = np.inf if _is_step(on, m, top) else widest
            _gap(out, on[m], on[m + 1], fan, top, per_row, farthest)
    out[WIDTH] += width
    out[AREA] += area
    out[SEEN], out[BRIDGED], out[LOOSE] = on_seen, on_bridged, loose


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
