"""From a frame to peaks: what all extractors here have in common."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from roemetry.errors import StageError
from roemetry.records import Frame, Peaks
from roemetry_kernels.grey_levels import grey, plain_layout, scaled_level
from roemetry_peaks.options import PeakOptions

if TYPE_CHECKING:
    from roemetry_kernels.stripe_scan import Area

_NOISES = 10.0
_LEVELS_MIN = 6.0


def found(frame: Frame, options: PeakOptions, measure: Callable[..., int]) -> Peaks:
    """Find the stripes of a frame and measure each by a kernel.

    Parameters
    ----------
    frame
        One channel.
    options
        What counts as a stripe.
    measure
        Kernel with the parameters of `roemetry_kernels.centre_of_gravity.centres_of_gravity`.
    """
    from roemetry_kernels.stripe_scan import stripe_tops

    pixels = plain_layout(grey(frame))
    area = searched(frame, options.region)
    tops = stripe_tops(pixels, threshold_of(frame, pixels, area, options), area)
    room = tops.row.shape[0]
    row, values, flags = np.empty(room, np.int64), np.empty((5, room)), np.empty(room, np.uint8)
    count = measure(
        pixels,
        area.left,
        area.right,
        frame.white,
        options.width_min_px,
        options.width_max_px,
        *tops,
        row,
        values,
        flags,
    )
    x_px, x_std_px, amplitude, background, width_px = values[:, :count]
    return Peaks(
        image_size=frame.size,
        row=row[:count],
        x_px=x_px,
        x_std_px=x_std_px,
        amplitude=amplitude,
        background=background,
        width_px=width_px,
        flags=flags[:count],
    )


def searched(frame: Frame, region: tuple[int, int, int, int] | None) -> Area:
    """Give the part of the frame to search; raise StageError where it does not lie within the frame."""
    from roemetry_kernels.stripe_scan import Area

    rows, columns = frame.size
    if region is None:
        return Area(0, rows, 0, columns)
    top, bottom, left, right = region
    if not (0 <= top < bottom <= rows and 0 <= left < right <= columns):
        raise StageError(
            f"region {list(region)} does not lie within the image of {rows} rows and {columns} columns",
            hint="give first row, row after the last, first column, column after the last",
        )
    return Area(*region)


def threshold_of(frame: Frame, pixels: Any, area: Area, options: PeakOptions) -> int:
    """Give the threshold in grey levels of the frame."""
    from roemetry_kernels.image_noise import image_noise

    if options.threshold != "auto":
        return math.floor(scaled_level(options.threshold, frame))
    return math.ceil(max(_NOISES * image_noise(pixels, *area), scaled_level(_LEVELS_MIN, frame)))
