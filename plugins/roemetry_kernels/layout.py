"""Coded points laid out over (stripe, row): off the belt or on it, gaps bridged, products numbered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_PRODUCT_ROWS_MIN = 3


@kernel
def off_belt_and_bridged(
    x_px: Floats, rest_px: Floats, tolerance_px: float, reach_px: float, longest_gap_rows: int
) -> Flags:
    """Say which points lie off the belt, and bridge short gaps by straight lines, in place.

    A run off the belt that is too short or nowhere far from it is taken back to the belt: where a product's
    shadow cuts a belt stripe lengthwise, its peak shifts by a pixel or two. A gap beside a product is its.

    Parameters
    ----------
    x_px
        (stripe, row) seen points, NaN elsewhere; bridged ones are filled in.
    rest_px
        (stripe, row) rest lines; NaN where none is known: then every point is off the belt.
    tolerance_px
        How far from its rest line a point still lies on the belt, px.
    reach_px
        How far a run must get away from its rest line to be product, px.
    longest_gap_rows
        Longer gaps stay empty, rows.

    Returns
    -------
    ndarray
        (stripe, row) True off the belt.
    """
    stripes, rows = x_px.shape
    off_belt = np.zeros((stripes, rows), np.bool_)
    seen = np.empty(rows, np.int64)
    for s in range(stripes):
        count = 0
        for row in range(rows):
            if not np.isnan(x_px[s, row]):
                seen[count] = row
                count += 1
                off_belt[s, row] = not abs(x_px[s, row] - rest_px[s, row]) <= tolerance_px
        begin = 0
        while begin < count:
            if not off_belt[s, seen[begin]]:
                begin += 1
                continue
            end, farthest = begin, 0.0
            while end < count and off_belt[s, seen[end]]:
                away = abs(x_px[s, seen[end]] - rest_px[s, seen[end]])
                farthest = max(farthest, np.inf if np.isnan(away) else away)
                end += 1
            if end - begin < _PRODUCT_ROWS_MIN or farthest < reach_px:
                for k in range(begin, end):
                    off_belt[s, seen[k]] = False
            begin = end
        for k in range(count - 1):
            before, after = seen[k], seen[k + 1]
            if not 1 < after - before <= longest_gap_rows + 1:
                continue
            slope = (x_px[s, after] - x_px[s, before]) / (after - before)
            for row in range(before + 1, after):
                x_px[s, row] = x_px[s, before] + slope * (row - before)
                off_belt[s, row] = off_belt[s, before] or off_belt[s, after]
    return off_belt


@kernel
def numbered(x_px: Floats, off_belt: Flags, smallest: int) -> tuple[NDArray[np.int16], Flags]:
    """Number connected points off the belt 1…n from left to right.

    Neighbours are the same stripe's next row and the next stripe's same row. What is not seen joins what
    lies off the belt on both sides of it, along the stripe or across.

    Parameters
    ----------
    x_px
        (stripe, row) points, NaN where nothing is known.
    off_belt
        (stripe, row) True off the belt.
    smallest
        Groups of fewer points are dirt.

    Returns
    -------
    tuple
        (stripe, row) product's number, 0 on the belt, −1 where nothing is known and for dirt; and
        (stripe, row) True for dirt.
    """
    stripes, rows = x_px.shape
    filled = _joined(x_px, off_belt)
    parent = np.arange(stripes * rows)
    for s in range(stripes):
        for row in range(rows):
            if not filled[s, row]:
                continue
            cell = s * rows + row
            if row + 1 < rows and filled[s, row + 1]:
                _join(parent, cell, cell + 1)
            if s + 1 < stripes and filled[s + 1, row]:
                _join(parent, cell, cell + rows)
    points = np.zeros(stripes * rows, np.int64)
    cells = np.zeros(stripes * rows, np.int64)
    place = np.zeros(stripes * rows)
    for s in range(stripes):
        for row in range(rows):
            if filled[s, row]:
                root = _root(parent, s * rows + row)
                points[root] += off_belt[s, row]
                cells[root] += 1
                place[root] += s
    number = np.zeros(stripes * rows, np.int16)
    big = np.flatnonzero(points >= max(smallest, 1))
    order = np.argsort(place[big] / cells[big], kind="mergesort")
    for k in range(big.size):
        number[big[order[k]]] = k + 1
    product = np.full((stripes, rows), -1, np.int16)
    dirt = np.zeros((stripes, rows), np.bool_)
    for s in range(stripes):
        for row in range(rows):
            if off_belt[s, row]:
                mine = number[_root(parent, s * rows + row)]
                product[s, row] = mine if mine > 0 else -1
                dirt[s, row] = mine == 0
            elif not np.isnan(x_px[s, row]):
                product[s, row] = 0
    return product, dirt


@kernel
def cells_between(
    row: Integers, x_px: Floats, stripe: Integers, refused: int, rest_px: Floats
) -> tuple[Flags, int]:
    """Mark the cells a refused peak may belong to: the stripes whose rest lines are its nearest two.

    Gives (stripe, row) flags and the number of refused peaks.
    """
    stripes, rows = rest_px.shape
    cells = np.zeros((stripes, rows), np.bool_)
    count = 0
    for p in range(row.shape[0]):
        if stripe[p] != refused:
            continue
        count += 1
        right = 0
        for s in range(stripes):
            right += rest_px[s, row[p]] < x_px[p]
        if right > 0:
            cells[right - 1, row[p]] = True
        if right < stripes and not np.isnan(rest_px[right, row[p]]):
            cells[right, row[p]] = True
    return cells, count


@kernel
def _joined(x_px: Floats, off_belt: Flags) -> Flags:
    """Give what lies off the belt, with what is not seen between it."""
    stripes, rows = x_px.shape
    filled = off_belt.copy()
    for s in range(1, stripes - 1):
        for row in range(rows):
            if np.isnan(x_px[s, row]) and off_belt[s - 1, row] and off_belt[s + 1, row]:
                filled[s, row] = True
    for s in range(stripes):
        last = -1
        for row in range(rows):
            if np.isnan(x_px[s, row]):
                continue
            if last >= 0 and off_belt[s, last] and off_belt[s, row]:
                filled[s, last:row] = True
            last = row
    return filled


@kernel
def _root(parent: Integers, cell: int) -> int:
    while parent[cell] != cell:
        parent[cell] = parent[parent[cell]]
        cell = parent[cell]
    return cell


@kernel
def _join(parent: Integers, one: int, other: int) -> None:
    a, b = _root(parent, one), _root(parent, other)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
