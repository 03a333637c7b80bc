"""Which peaks are too faint beside what an image's stripes reach, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.ranking import nth_smallest

SHARE_MIN = 0.08
"""Of a stripe beside it, that a stripe is high: the ripples of a JPEG are lower."""
_USUAL = 0.9  # of the rows: others may show nothing but noise
_NEAR_BY_PX = 16.0  # two blocks of a JPEG
_ROWS_MAX = 64  # that a level is chosen from
_PART = 0.25  # of what stripes reach above the dark: where a stripe begins


@float_kernel
def faint(row: NDArray[Any], x_px: Floats, amplitude: Floats, share_min: float) -> Flags:
    """Say which peaks rise by too little beside the others: ringing, glare, or what a JPEG made of noise.

    Parameters
    ----------
    row, x_px, amplitude
        (peak,) image row, place, px, and height, grey levels, of peaks sorted by row, then place.
    share_min
        Of the height of a peak within 16 px in the same row, and of what the highest one of a row reaches in
        all but the brightest tenth of the rows.

    Returns
    -------
    ndarray
        (peak,) True where a peak is lower than that share.
    """
    count = row.shape[0]
    out = np.zeros(count, np.bool_)
    if count == 0:
        return out
    highest = 0.0
    for i in range(count):
        highest = max(highest, amplitude[i])
    least = share_min * usual_height(row, amplitude)
    for i in range(count):
        low = amplitude[i] < share_min * highest
        out[i] = amplitude[i] < least or (low and outshone(row, x_px, amplitude, i, share_min))
    return out


@inlined
def usual_height(row: NDArray[Any], amplitude: Floats) -> float:
    """What the highest peak reaches in all but the brightest tenth of the rows."""
    highest = np.empty(row.shape[0])
    rows = 0
    best = amplitude[0]
    for i in range(np.uint64(1), np.uint64(row.shape[0])):
        if row[i] != row[i - np.uint64(1)]:
            highest[rows] = best
            rows += 1
            best = amplitude[i]
        best = max(best, amplitude[i])
    highest[rows] = best
    rows += 1
    at = int(_USUAL * (rows - 1))
    return float(nth_smallest(highest[:rows], at))


@inlined
def outshone(row: NDArray[Any], x_px: Floats, amplitude: Floats, i: int, share_min: float) -> bool:
    """Say whether a peak of the same row near by is so much higher."""
    least = amplitude[i] / max(share_min, 1e-9)
    j = i - 1
    while j >= 0 and row[j] == row[i] and x_px[i] - x_px[j] <= _NEAR_BY_PX:
        if amplitude[j] > least:
            return True
        j -= 1
    j = i + 1
    while j < row.shape[0] and row[j] == row[i] and x_px[j] - x_px[i] <= _NEAR_BY_PX:
        if amplitude[j] > least:
            return True
        j += 1
    return False


def level_between(image: NDArray[Any], rise: int) -> int:
    """Choose a grey level between the dark and the stripes, for what knows one level only.

    The dark is the median of up to 64 rows spread over the image. The level lies above it by a quarter of
    what the rows' brightest pixels reach, but for the brightest tenth of the rows, and by `rise` at least.
    """
    some = image[:: max(1, image.shape[0] // _ROWS_MAX)]
    dark = float(np.median(some))
    usual = float(np.quantile(some.max(axis=1), _USUAL, method="lower"))
    return min(round(dark + max(float(rise), _PART * (usual - dark))), int(np.iinfo(image.dtype).max))
