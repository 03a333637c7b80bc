"""From a frame to peaks: what the extractors that measure each stripe by itself have in common.

It imports what is compiled: to be imported itself only when something runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from roemetry.records.arrays import Floats
from roemetry.records import EDGE, SATURATED, Frame, Peaks
from roemetry_kernels.image_levels import SHARE_MIN, automatic_rise, doubts, grey, plain_layout, scaled_level
from roemetry_peaks.clipped_peaks import middles_of_half_seen, what_is_odd
from roemetry_peaks.options import PeakOptions
from roemetry_peaks.peak_scan import Area, stripe_tops
from roemetry_peaks.peak_window import Stripes, stripes_around
from roemetry_peaks.region import searched
from roemetry_peaks.speckle_contrast import contrasts_along
from roemetry_peaks.stated_uncertainty import corrected

_HEIGHT_SHARE = 0.5
"""Of the threshold, that a stripe is high above the light beside it: noise on bright ground has tops, too."""
_ROUNDING = 1.0 / 12.0
"""Variance of rounding to whole grey levels."""


def found(
    frame: Frame,
    options: PeakOptions,
    centres: Callable[..., None],
    *settings: Any,
    weighs_speckle: bool = False,
    beyond_linear: float = 0.0,
) -> Peaks:
    """Find the stripes of a frame and measure the centre of each by a kernel.

    Parameters
    ----------
    frame
        One channel.
    options
        What counts as a stripe.
    centres
        Kernel with the parameters of `roemetry_peaks.centre_of_gravity.centres_of_gravity`.
    settings
        What else the kernel takes.
    weighs_speckle
        Whether the centres depend on the speckle's contrast, and not only what is stated of them.
    beyond_linear
        By which share, over the contrast's square, speckle scatters these centres more than each pixel's pull
        on them tells: a strong one changes the pulls themselves. Found by drawing.
    """
    pixels = plain_layout(grey(frame))
    area = searched(frame, options.region)
    threshold = threshold_of(frame, pixels, area, options)
    tops = stripe_tops(pixels, threshold, area)
    limits = {"width_min_px": options.width_min_px, "width_max_px": options.width_max_px}
    limits["share_min"] = SHARE_MIN if options.threshold == "auto" else 0.0
    limits["height_min"] = _HEIGHT_SHARE * threshold
    stripes = stripes_around(pixels, tops, area, white=frame.white, **limits)
    x_px, x_std_px = np.empty((2, stripes.row.shape[0]))
    levels, columns = pixels.reshape(-1), pixels.shape[1]
    noise = noise_of(frame, options)
    sought = weighs_speckle or frame.sensor is not None
    contrast2 = contrasts_of(frame, options, stripes, noise, sought=sought)
    speckled = contrast2.shape[0] > 1 or contrast2[0] > 0.0
    if contrast2.shape[0] > 1:
        contrast2 *= 1.0 + beyond_linear * contrast2
    else:  # quicker on one number
        contrast2[0] *= 1.0 + beyond_linear * float(contrast2[0])
    centres(levels, columns, stripes, frame.white, noise, contrast2, x_px, x_std_px, *settings)
    outside, half_seen = what_is_odd(x_px, stripes.flags, columns)
    if half_seen:
        middles_of_half_seen(stripes, noise, contrast2, x_px, x_std_px)
        outside, _ = what_is_odd(x_px, stripes.flags, columns)
    fields: dict[str, Any] = {
        "row": stripes.row,
        "x_px": x_px,
        "x_std_px": x_std_px,
        "amplitude": stripes.amplitude,
        "background": stripes.background,
        "width_px": stripes.width,
        "flags": stripes.flags,
    }
    if outside:
        inside = (x_px >= 0.0) & (x_px <= columns - 1.0)  # where there is none, NaN
        fields = {name: values[inside] for name, values in fields.items()}
    if half_seen:
        fields = _with_leaving(fields, levels, columns, area, frame, stripes, x_px)
    # Speckle is as long along the stripe as across it; the sensor's noise is not correlated at all.
    rows = options.speckle_length_px if speckled else 0.0
    fields["x_std_px"], contradictions = corrected(
        pixels, **fields, sensor=(float(noise[0]), float(noise[1]))
    )
    odd = doubts(pixels, frame.white, fields["row"], fields["x_px"], fields["width_px"])
    return Peaks(image_size=frame.size, correlation_rows=rows, reasons=(*contradictions, *odd), **fields)


def _with_leaving(
    fields: dict[str, Any],
    levels: Any,
    columns: int,
    area: Area,
    frame: Frame,
    stripes: Stripes,
    x_px: Floats,
) -> dict[str, Any]:
    """Add the rows in which overexposed stripes leave the image, to what is known of each peak."""
    # few images have any
    from roemetry_peaks.clipped_peaks import leaving_stripes

    whose, row, x_px, x_std_px, width_px = leaving_stripes(levels, columns, area, frame.white, stripes, x_px)
    if not whose.size:
        return fields
    more = {
        "row": row,
        "x_px": x_px,
        "x_std_px": x_std_px if frame.sensor is not None else np.full(whose.size, np.nan),
        "amplitude": stripes.amplitude[whose],
        "background": stripes.background[whose],
        "width_px": width_px,
        "flags": np.full(whose.size, SATURATED | EDGE, np.uint8),
    }
    joined = {name: np.concatenate([values, more[name]]) for name, values in fields.items()}
    order = np.lexsort((joined["x_px"], joined["row"]))
    return {name: values[order] for name, values in joined.items()}


def noise_of(frame: Frame, options: PeakOptions) -> Floats:
    """Give what is known of the sensor's noise, as `influence.variance_of` takes it."""
    if frame.sensor is None:
        return np.array([np.nan, np.nan, options.speckle_length_px])
    read, gain = frame.sensor.read_noise_grey, frame.sensor.gain_grey_per_electron
    return np.array([read * read + _ROUNDING, gain, options.speckle_length_px])


def contrasts_of(
    frame: Frame, options: PeakOptions, stripes: Stripes, noise: Floats, *, sought: bool
) -> Floats:
    """Give the square of the speckle's contrast: (1,) that of all stripes, or (peak,) where they differ.

    An automatic contrast is 0 where it is not `sought`: nothing is stated without a sensor.
    """
    if options.speckle_contrast != "auto":
        return np.array([options.speckle_contrast**2])
    if not sought:
        return np.zeros(1)
    squares: Floats = contrasts_along(stripes, *frame.size, noise)
    return squares


def threshold_of(frame: Frame, pixels: Any, area: Area, options: PeakOptions) -> int:
    """Give the threshold in grey levels of the frame."""
    if options.threshold != "auto":
        return math.floor(scaled_level(options.threshold, frame))
    return automatic_rise(pixels, frame.white, *area)
