"""Whether an image's stripes are darker than their surroundings: what is found then lies between them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry.records.reasons import Reason
from roemetry_kernels.extraction.image_noise import RISE_MIN

_LOOKED_AT = 200  # pairs of neighbours
_FEWEST = 8  # pairs, or rows, below which nothing is said
_FILLED = 0.5  # of a row, that stripes fill at most
_WIDTHS_PX = (1.5, 40.0)  # at half height, of what may be a line
_ROWS_MAX = 32  # that are searched for dark lines where nothing bright is found
_PIXELS_A_ROW = 160  # that tell of the ground
_ODD = Reason(
    "upside-down",
    "what was found is wider than the gaps between: the stripes are darker than their surroundings "
    "(then give the complement of the image), or too near to each other",
)
_DARK = Reason(
    "upside-down",
    "no bright stripe was found, but dark lines: give the complement of the image if they are meant",
)


def doubts(
    image: NDArray[Any], white: int, row: NDArray[Any], x_px: Floats, width_px: Floats
) -> tuple[Reason, ...]:
    """Say what speaks against the peaks of an image being its stripes.

    Stripes leave most of a row dark: of 8 standard deviations from one to the next, the full width at half
    height is 0.29. Between dark lines the bright ground is the wider part. Where there are less than two
    peaks a row, some rows of the complement are searched.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (rows, columns)
        Grey levels.
    white
        Grey level from which on a pixel is saturated.
    row, x_px, width_px
        (peak,) image row, place and full width at half height, px, sorted by row, then place.
    """
    step = max(1, row.shape[0] // _LOOKED_AT)
    one, other = slice(0, max(row.shape[0] - 1, 0), step), slice(1, None, step)
    pairs = row[one] == row[other]
    looked_at = np.count_nonzero(pairs)
    if looked_at >= _FEWEST:
        filled = width_px[one] + width_px[other] > 2.0 * _FILLED * (x_px[other] - x_px[one])
        # Half of them is more than half: without a median, which would take longer than all else.
        if 2 * np.count_nonzero(filled & pairs) > looked_at:
            return (_ODD,)
    if row.shape[0] >= 2 * image.shape[0] or not _has_darker_pixels(image, white):
        return ()
    return (_DARK,) if _has_dark_lines(image, white, row.shape[0] / image.shape[0]) else ()


def _has_darker_pixels(image: NDArray[Any], white: int) -> bool:
    """Say whether rows usually hold a pixel darker than the ground by what a line needs: asked first.

    On dark ground none is, so that what searches for lines need not even be loaded.
    """
    some = image[:: max(1, -(-image.shape[0] // _ROWS_MAX))]
    part = some[:, :: max(1, some.shape[1] // _PIXELS_A_ROW)].reshape(-1)
    half = max(some.shape[0] // 2 - 1, 0)
    darkest = np.partition(some.min(axis=1), half)[half]
    ground = np.partition(part, part.size // 2)[part.size // 2]
    return float(ground) - float(darkest) >= RISE_MIN * white / 255.0


def _has_dark_lines(image: NDArray[Any], white: int, bright_a_row: float) -> bool:
    from roemetry_kernels.extraction.grey_levels import plain_layout
    from roemetry_kernels.extraction.image_noise import automatic_rise
    from roemetry_kernels.extraction.local_contrast import SHARE_MIN
    from roemetry_kernels.extraction.stripe_footing import stripes_around
    from roemetry_kernels.extraction.stripe_scan import Area, stripe_tops

    some = image[:: max(1, -(-image.shape[0] // _ROWS_MAX))]
    area = Area(0, some.shape[0], 0, some.shape[1])
    dark = plain_layout((white - np.minimum(some, white)).astype(some.dtype.newbyteorder("=")))
    rise = automatic_rise(dark, white, *area)
    lines = stripes_around(
        dark,
        stripe_tops(dark, rise, area),
        area,
        white=white,
        width_min_px=_WIDTHS_PX[0],
        width_max_px=_WIDTHS_PX[1],
        share_min=SHARE_MIN,
        height_min=0.5 * rise,
    ).row
    rows = np.unique(lines).size
    return rows >= max(_FEWEST, some.shape[0] // 2) and lines.size > bright_a_row * some.shape[0]
