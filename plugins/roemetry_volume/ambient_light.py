"""The ambient light of a laser image: what it shows beside its stripes.

Model. A grey opening along the rows takes away what is narrower than stripes are apart; what it takes away by
far more than noise is a stripe. Each place is then the mean of what lies beside stripes around it. The opened
image itself would not do: of what is not smooth it keeps the darkest, and it moves slanted edges of a bright
body.

Fails where stripes are so near to each other that no ambient light is seen between them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats
from roemetry_kernels.image_levels import median_of

SMOOTHED_PX = 1.2
"""Noise beside stripes is averaged along the outline, too: little is needed across it."""
_FILL_PX = 10.0  # about the width of a stripe, whose place is filled from beside it
_FILLED_SHARE = 0.2  # of the smoothing's weight that lies beside stripes; with less the wider one is taken
_COARSER = 4  # the wider smoothing of an image so many times coarser differs by less than noise
_STRIPE = 6.0
"""Times the noise: what the opening takes away that much is a stripe."""
_LEAST_NOISE = 0.5  # grey levels: that of rounding, with a margin
_STEPS = 64.0  # a grey level: finer than what the mean of a dozen pixels scatters by
_SAMPLED = 5  # every fifth row tells the noise
_WIDTH_SHARE, _WIDTH_MIN_PX = 0.6, 9
"""Of the spacing: more than a stripe is wide, less than stripes are apart."""


def ambient_light(
    pixels: NDArray[Any], spacing_px: float, *, grid: bool = False
) -> tuple[NDArray[Any], Flags]:
    """Take the stripes out of a laser image.

    Parameters
    ----------
    pixels
        (row, column) grey levels.
    spacing_px
        Distance of neighbouring stripes.
    grid
        Whether stripes lie across the image, too.

    Returns
    -------
    light : ndarray
        Ambient light, in 64ths of a grey level or, of more than 10 bits, in as fine steps as 16 bits allow.
    stripes : ndarray of bool
        Where a stripe was taken out. What stands there comes from beside it.
    """
    import cv2

    width = max(int(_WIDTH_SHARE * spacing_px) | 1, _WIDTH_MIN_PX)
    opened = cv2.morphologyEx(pixels, cv2.MORPH_OPEN, np.ones((1, width), np.uint8))
    if grid:
        opened = cv2.min(opened, cv2.morphologyEx(pixels, cv2.MORPH_OPEN, np.ones((width, 1), np.uint8)))
    taken = cv2.subtract(pixels, opened)
    sample = taken[::_SAMPLED].astype(np.float32).ravel()
    usual = median_of(sample)
    noise = 1.4826 * median_of(np.abs(sample - usual))
    on = (taken > usual + _STRIPE * max(noise, _LEAST_NOISE)).astype(np.uint8)
    on = cv2.morphologyEx(on, cv2.MORPH_OPEN, np.ones((3, 1), np.uint8))  # single pixels are noise
    beside = 1.0 - cv2.dilate(on, np.ones((3 if grid else 1, 3), np.uint8)).astype(np.float32)
    of_beside = beside * pixels
    share, total = (cv2.GaussianBlur(one, (0, 0), SMOOTHED_PX) for one in (beside, of_beside))
    filled = share <= _FILLED_SHARE
    light = cv2.divide(total, cv2.max(share, 1e-6))
    np.copyto(light, _widely(of_beside, beside), where=filled)
    light *= min(_STEPS, np.iinfo(np.uint16).max / max(float(light.max()), 1.0))
    return np.rint(light, out=light).astype(np.uint16), filled


def _widely(of_beside: Floats, beside: Floats) -> Floats:
    """Give the mean of what lies beside stripes over the width of one, (row, column)."""
    import cv2

    rows, columns = beside.shape
    size = (max(columns // _COARSER, 1), max(rows // _COARSER, 1))
    share, total = (
        cv2.GaussianBlur(cv2.resize(one, size, interpolation=cv2.INTER_AREA), (0, 0), _FILL_PX / _COARSER)
        for one in (beside, of_beside)
    )
    mean = total / np.maximum(share, 1e-6)
    return np.asarray(cv2.resize(mean, (columns, rows), interpolation=cv2.INTER_LINEAR))
