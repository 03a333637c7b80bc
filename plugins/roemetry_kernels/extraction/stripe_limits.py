"""Limits between stripes where halfway between two tops lies in the light of one; compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.extraction.stripe_scan import Pixels, Places

_IN_LIGHT = 0.25
"""Of the brighter top's height above the darkest pixel between: what is brighter is its light."""
_BRIGHT = 0.25  # of the highest top: what is lower has no ripples beside it that are tops


@float_kernel
def limits_out_of_light(
    levels: Pixels,
    columns: int,
    row: Places,
    first: Places,
    last: Places,
    unfit: NDArray[np.uint64],
    highs: Floats,
    places: NDArray[np.int32],
    done: NDArray[np.uint8],
) -> bool:
    """Put limits between stripes at the darkest pixel where halfway lies in the light of one, in place.

    Beside a wide stripe a faint top, such as the ripples that a JPEG makes, takes half of what is between
    the two tops: the stripe's own light would then be its background, and it would be too narrow or too
    faint. So only where that has happened to one that is unfit, or to its neighbour, are all looked at.

    Parameters
    ----------
    levels, columns, row, first, last
        As `roemetry_kernels.extraction.stripe_footing.stripes_around` has them.
    unfit
        Numbers of the tops that are no stripes by the limits so far.
    highs, places
        What it filled; `places` is changed.
    done
        (peak,) filled: 0 for the stripes that have another limit now.

    Returns
    -------
    bool
        Whether there are any.
    """
    if unfit.shape[0] == 0:
        return False
    some, least = False, _BRIGHT * np.max(highs)
    for g in range(unfit.shape[0]):
        k: Any = np.int64(unfit[g])
        for i in range(max(k, 1), min(k + 2, row.shape[0])):
            some |= _darkest(levels, columns, row, first, last, highs, least, places, i) >= 0
    if some:
        done[:] = 1
        for i in range(1, row.shape[0]):
            darkest = _darkest(levels, columns, row, first, last, highs, least, places, i)
            if darkest >= 0:
                places[1, i - 1] = places[0, i] = darkest
                done[i - 1] = done[i] = 0
    return some


@inlined
def _darkest(
    levels: Pixels,
    columns: int,
    row: Places,
    first: Places,
    last: Places,
    highs: Floats,
    least: float,
    places: NDArray[np.int32],
    i: int,
) -> int:
    """Column of the darkest pixel between a top and the one before it, if halfway is in light; else −1."""
    if row[i] != row[i - 1]:
        return -1
    high, at = max(highs[i - 1], highs[i]), row[i] * columns
    # The last pixel of the one and the first of the other: the same, or neighbours.
    halfway = max(levels[at + places[1, i - 1]], levels[at + places[0, i]])
    if high < least or halfway <= _IN_LIGHT * high:
        return -1
    darkest = at + last[i - 1]
    for x in range(at + last[i - 1] + 1, at + first[i]):
        darkest = x if levels[x] < levels[darkest] else darkest
    low = float(levels[darkest])
    return darkest - at if halfway - low > _IN_LIGHT * (high - low) else -1
