"""The search for stripes along image rows: peaks that rise and fall by a threshold, compiled."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry_kernels.compiling import kernel

Pixels = NDArray[Any]
Places = NDArray[np.int32]

_PEAKS_A_ROW = 32  # room made at first


class Area(NamedTuple):
    """The part of an image that is searched: rows and columns from the first to the one after the last."""

    top: int
    bottom: int
    left: int
    right: int


class Tops(NamedTuple):
    """Tops of peaks, sorted by row, then column.

    Attributes
    ----------
    row : ndarray of int32, shape (peak,)
        Image row.
    first, last : ndarray of int32, shape (peak,)
        Columns of the first and the last pixel of the top: the same unless it is a plateau.
    """

    row: Places
    first: Places
    last: Places


def stripe_tops(image: Pixels, threshold: int, area: Area) -> Tops:
    """Find the peaks of each row that rise and fall by more than `threshold` grey levels.

    From the row's first pixel on, the lowest level is kept until a pixel exceeds it by more than the
    threshold; from there on the highest level is kept until a pixel falls below it by more than the
    threshold. That ends a peak, whose top is the leftmost run of pixels at its highest level, and the search
    begins anew. A stripe that the area's border cuts off before it has fallen is not found.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels, contiguous and read-only (`roemetry_kernels.grey_levels.plain_layout`).
    threshold
        Grey levels; a difference equal to it is not enough.
    area
        What is searched.
    """
    room = _PEAKS_A_ROW * (area.bottom - area.top)
    while True:
        row, first, last = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32)
        count = _scan(image, threshold, *area, row, first, last)
        if count <= room:
            return Tops(row[:count], first[:count], last[:count])
        room = count


@kernel
def _scan(
    image: Pixels,
    threshold: int,
    top: int,
    bottom: int,
    left: int,
    right: int,
    row: Places,
    first: Places,
    last: Places,
) -> int:
    """Walk every row; gives the number of peaks, also of those there is no room for."""
    count = 0
    for y in range(top, bottom):
        f = image[y]
        low = np.int64(f[left])
        rising = False
        high = low
        begin = end = left
        for x in range(left + 1, right):
            level = np.int64(f[x])
            if not rising:
                low = min(low, level)
                if level > low + threshold:
                    rising = True
                    high = level
                    begin = end = x
            elif level > high:
                high = level
                begin = end = x
            elif level == high and end == x - 1:
                end = x
            elif level < high - threshold:
                if count < row.shape[0]:
                    row[count] = y
                    first[count] = begin
                    last[count] = end
                count += 1
                rising = False
                low = level
    return count
