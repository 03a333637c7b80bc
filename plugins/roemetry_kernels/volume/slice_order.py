"""A product's slices in the order in which they cut the belt, and what each stands for."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_kernels.volume.slice_areas import (
    AREA,
    AT,
    BRIDGED,
    CLEFT,
    COUNT,
    FILLED,
    FIRST_ROW,
    HOLE,
    LAST_ROW,
    LOW,
    SEEN,
)

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
    rows : ndarray of float64, shape (n, 16)
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
        assumed += (on + between) * (held[k] - own[k])
    whole[LEAST_AREA], whole[CLOVEN] = least_area, cloven
    whole[SEEN_MM3], whole[JOINED_MM3], whole[ASSUMED_MM3] = seen, joined, assumed
    whole[MOST_FILLED], whole[MOST_HOLE], whole[LOWEST] = filled, hole, lowest
    whole[UPPERMOST], whole[LOWERMOST] = upper, lower
    return lit, held, whole, rows, columns
