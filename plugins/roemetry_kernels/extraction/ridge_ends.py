"""Ridges in the first and the last rows of an image, which smoothing along them would bend; compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel

LEANS = 0.1
"""Px a row: a ridge that leans more is bent by rows that are repeated beyond the border."""
BORDER = 2.0
"""Standard deviations of the smoothing: so near the first or the last row it is."""
_AWAY = 0.75  # standard deviations of the smoothing from where the ridge leads, that its crossing may lie
_LIT = 0.25  # of the height, that all three pixels in the middle have
_STEPS = 6
_RESTS_PX = 1e-4
_REACH = 4.0  # standard deviations of the smoothing


@kernel
def carried_on(
    image: NDArray[Any],
    sigma: float,
    dark: float,
    count: int,
    row: Integers,
    values: Floats,
) -> int:
    """Carry ridges on to the first and the last row; gives how many crossings there are then.

    From the nearest row that smoothing does not bend, each ridge leads to the next one by its lean. There the
    row alone is smoothed, across the ridge, and the top nearest to that place is the crossing, if it has
    light. What else is known of it is as in the row where it was carried on from.

    Parameters
    ----------
    image
        (row, column) grey levels.
    sigma
        Standard deviation of the smoothing, px.
    dark
        Grey levels above the background that a pixel may have by chance.
    count
        Crossings so far.
    row, values
        (room,) image row, not falling as far as `count`; (5, room) place, px, height, background, width, lean
        of the crossings; those that are new are added, as far as there is room.
    """
    rows = image.shape[0]
    near = min(math.ceil(BORDER * sigma), rows)
    known = count
    for p in range(known):
        lean = values[4, p]
        for way in (-1, 1):
            last = 0 if way < 0 else rows - 1
            if abs(row[p] - last) != near:
                continue
            lead = values[0, p]
            for step in range(1, near + 1):
                y = row[p] + way * step
                lead += way * lean
                x = _top_near(image, y, lead, sigma)
                if not _is_lit(image, y, x, values[2, p], max(dark, _LIT * values[1, p])):
                    continue
                lead = x
                if _is_there(row, values, known, p, way, y, x, BORDER * sigma):
                    continue
                if count < row.shape[0]:
                    row[count], values[0, count] = y, x
                    for field in range(1, values.shape[0]):
                        values[field, count] = values[field, p]
                count += 1
    return count


@kernel
def _is_there(
    row: Integers, values: Floats, known: int, p: int, way: int, y: int, x: float, near_px: float
) -> bool:
    """Whether a row has a crossing near a place already; it is looked for from crossing p on."""
    q = p
    while 0 <= q < known and way * (y - row[q]) >= 0:
        if row[q] == y and abs(values[0, q] - x) < near_px:
            return True
        q += way
    return False


@kernel
def _top_near(image: NDArray[Any], y: int, at: float, sigma: float) -> float:
    """Where the row, smoothed by a Gaussian, has its top next to a place; NaN where it has none there."""
    columns = image.shape[1]
    reach = math.ceil(_REACH * sigma)
    x = at
    for _ in range(_STEPS):
        slope, bend = 0.0, 0.0
        for column in range(math.floor(x) - reach, math.floor(x) + reach + 1):
            u = (column - x) / sigma
            light = np.exp(-0.5 * u * u) * image[y, min(max(column, 0), columns - 1)]
            slope += u * light
            bend += (u * u - 1.0) * light
        if not bend < 0.0:
            return np.nan
        step = -sigma * slope / bend
        x += min(max(step, -0.5), 0.5)
        if not abs(x - at) <= _AWAY * sigma + LEANS:
            return np.nan
        if abs(step) < _RESTS_PX:
            break
    return x


@kernel
def _is_lit(image: NDArray[Any], y: int, x: float, background: float, least: float) -> bool:
    """Whether all three pixels around a place have light: a speck beyond a stripe's end is no more of it."""
    columns = image.shape[1]
    if not 0.0 <= x <= columns - 1:
        return False
    middle = int(x + 0.5)
    darkest = np.inf
    for column in range(middle - 1, middle + 2):
        darkest = min(darkest, np.float64(image[y, min(max(column, 0), columns - 1)]))
    return darkest - background > least
