"""Centres of stripes around peaks that are whole pixels.

The paper's peak is the last pixel of the highest plateau. On a stripe that is clipped at white that is up to
half the plateau to the right of its middle: 0.5 to 2 px, and only where the surface is bright. The centre of
gravity of what exceeds half the peak's height, over the contiguous pixels around it, is free of that
(clipping is symmetric) and of rounding. It assumes a symmetric profile that is alone within its half height;
at the edge of a print or of a surface it follows the edge, as any centre of gravity does.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats, Integers

_REACH_MAX_PX = 15
"""Pixels on either side that are looked at: stripes wider than 30 px at half height keep part of the bias."""


def is_whole(x_px: Floats) -> bool:
    """Say whether places are whole pixels, as those of scans for maxima are."""
    return bool(x_px.size) and bool((x_px == np.rint(x_px)).all())


def centres(pixels: np.ndarray, row: Integers, x_px: Floats, background: Floats, amplitude: Floats) -> Floats:
    """Give (peak,) centres of gravity above half height, px.

    Parameters
    ----------
    pixels
        (row, column) grey levels.
    row, x_px
        (peak,) where the peaks are.
    background, amplitude
        (peak,) grey level beside each, and height above it.
    """
    if not row.size:
        return x_px
    reach = np.arange(-_REACH_MAX_PX, _REACH_MAX_PX + 1)
    at = np.rint(x_px).astype(np.int64)[:, None] + reach
    inside = (at >= 0) & (at < pixels.shape[1])
    grey = pixels[row[:, None], np.clip(at, 0, pixels.shape[1] - 1)].astype(np.float64)
    above = np.where(inside, grey - (background + 0.5 * amplitude)[:, None], 0.0)
    high = above > 0.0
    middle = _REACH_MAX_PX
    # only what hangs together with the peak: another stripe may be near
    high[:, middle:] = np.logical_and.accumulate(high[:, middle:], axis=1)
    high[:, : middle + 1] = np.logical_and.accumulate(high[:, middle::-1], axis=1)[:, ::-1]
    above *= high
    total = above.sum(axis=1)
    known = total > 0.0
    found = x_px.astype(np.float64)
    found[known] = at[known, middle] + (above[known] @ reach) / total[known]
    return found
