"""From a frame to peaks: what the extractors that measure each stripe by itself have in common.

Threshold from the image's noise, tops (`peak_scan`), what stands around them (`peak_window`), the speckle's
contrast (`speckle_contrast`), the centre by one kernel or another, and the check of what is stated
(`stated_uncertainty`).

Overexposed stripes that leave the image sideways are followed by the flank that is still seen: where a
stripe's top is cut off at white and its outer flank has left the image, the row does not fall any more
before its last pixel, and no top is found. But the inner flank goes on from row to row, and the stripe's
width is known from the rows before.

It assumes that each row crosses a stripe steeply enough to be a profile of it. It fails where stripes run
along rows, and where they are nearer to each other than their width.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.records import EDGE, SATURATED, Frame, Peaks
from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined, kernel
from roemetry_kernels.image_levels import (
    SHARE_MIN,
    automatic_rise,
    clipped_beyond,
    doubts,
    grey,
    plain_layout,
    scaled_level,
)
from roemetry_peaks.peak_scan import GLARE, GLARING, Pixels, stripe_tops
from roemetry_peaks.peak_window import Stripes, stripes_around
from roemetry_peaks.searching import Area, SearchOptions, searched
from roemetry_peaks.speckle_contrast import contrasts_along, variance_of_middle
from roemetry_peaks.stated_uncertainty import corrected


class PeakOptions(SearchOptions):
    """What counts as a stripe, and its speckle."""

    speckle_contrast: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["auto"] = Field(
        default="auto",
        description="standard deviation of the light over its mean, from the laser's speckle; auto: from how "
        "much the stripes jump from row to row",
    )
    speckle_length_px: float = Field(
        default=0.8,
        gt=0.0,
        le=4.0,
        description="correlation length of the speckle, px: the standard deviation of the Gaussian that "
        "white noise would have to be smoothed with to look like it",
    )


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
    checked: bool = True,
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
    checked
        Whether uncertainties are held against the image, and what is doubtful is said and marked.
    """
    pixels = plain_layout(grey(frame))
    area = searched(frame, options.region)
    threshold = threshold_of(frame, pixels, area, options)
    tops = stripe_tops(pixels, threshold, area)
    limits = {"width_min_px": options.width_min_px, "width_max_px": options.width_max_px}
    limits["share_min"] = SHARE_MIN if options.threshold == "auto" else 0.0
    limits["height_min"] = _HEIGHT_SHARE * threshold
    stripes = stripes_around(pixels, tops, area, white=frame.highest, **limits)
    x_px, x_std_px = np.empty((2, stripes.row.shape[0]))
    levels, columns = pixels.reshape(-1), pixels.shape[1]
    noise = noise_of(frame, options)
    # without a sensor nothing is stated: then only centres that weigh by it need a contrast
    sought = weighs_speckle or frame.sensor is not None
    contrast2 = contrasts_of(frame, options, stripes, noise, sought=sought)
    speckled = contrast2.shape[0] > 1 or contrast2[0] > 0.0
    if contrast2.shape[0] > 1:
        contrast2 *= 1.0 + beyond_linear * contrast2
    else:  # quicker on one number
        contrast2[0] *= 1.0 + beyond_linear * float(contrast2[0])
    centres(levels, columns, stripes, frame.highest, noise, contrast2, x_px, x_std_px, *settings)
    outside, clipped = outside_or_clipped(x_px, stripes.flags, columns)
    if clipped:
        middles_of_clipped(stripes, noise, contrast2, x_px, x_std_px)
        outside, _ = outside_or_clipped(x_px, stripes.flags, columns)
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
    if clipped:
        fields = _with_leaving(fields, levels, columns, area, frame, stripes, x_px)
    # Speckle is as long along the stripe as across it; the sensor's noise is not correlated at all.
    rows = options.speckle_length_px if speckled else 0.0
    if not checked:
        return Peaks(image_size=frame.size, correlation_rows=rows, **fields)
    fields["x_std_px"], contradictions = corrected(
        pixels, **fields, sensor=(float(noise[0]), float(noise[1]))
    )
    fields["flags"] |= clipped_beyond(frame, fields["row"], fields["x_px"])
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
    whose, row, x_px, x_std_px, width_px = stripes_leaving_image(
        levels, columns, area, frame.highest, stripes, x_px
    )
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


CUT_TWICE = EDGE | SATURATED
_MIRRORED_PX = 0.02
"""Standard uncertainty of a middle by a pixel's like on the other flank, but for noise; found by drawing."""

_OF_GLARE = 0.25
"""Of its width, that a stripe in glare is known to: told by another program's line on a real image."""


@kernel
def outside_or_clipped(x_px: Floats, flags: NDArray[np.uint8], columns: int) -> tuple[bool, bool]:
    """Say whether a centre lies outside of the image or is none, and whether a stripe may be half seen."""
    inside, highest = 0, np.uint8(0)
    last = columns - 1.0
    for i in range(np.uint64(x_px.shape[0])):
        inside += (x_px[i] >= 0.0) & (x_px[i] <= last)
    for i in range(np.uint64(flags.shape[0])):
        highest = max(highest, flags[i])
    return bool(inside < x_px.shape[0]), bool(highest >= CUT_TWICE)


@float_kernel
def middles_of_clipped(s: Stripes, noise: Floats, contrast2: Floats, x_px: Floats, x_std_px: Floats) -> None:
    """Take the middle for the centre where a top is cut off at white and a flank is not seen, in place.

    That is where the border cuts it off above half height, and in glare. What a method makes of the pixels
    that are left is up to 0.2 px beside at the border, and states an eighth of it. `GLARE` is taken off the
    flags.

    Parameters
    ----------
    s
        Stripes, as `roemetry_peaks.peak_window.stripes_around` gave them.
    noise, contrast2
        As for `roemetry_peaks.gaussian.gaussian_centres`.
    x_px, x_std_px
        (peak,) centres and what is stated of them.
    """
    _, los, his, flags, middles, widths, amplitudes, backgrounds, _, _ = s
    each = contrast2.shape[0] > 1
    for i in range(flags.shape[0]):
        half = 0.5 * widths[i]
        glare = flags[i] & GLARE != 0
        whole = (
            flags[i] & CUT_TWICE != CUT_TWICE or los[i] <= middles[i] - half <= middles[i] + half <= his[i]
        )
        if whole and not glare:
            continue
        speckle = contrast2[i if each else 0]
        variance = variance_of_middle(widths[i], amplitudes[i], backgrounds[i], noise, speckle)
        more = _OF_GLARE * widths[i] if glare else _MIRRORED_PX
        x_px[i], x_std_px[i] = middles[i], np.sqrt(variance + more * more)
        flags[i] &= ~GLARE


_ROWS = 12  # rows at most that tell where the flank is leading
_WHOLE = 8  # rows at most that tell the width, the nearest ones with both flanks
_BACK = 40  # rows, that these may lie farther back
_WHOLE_MIN = 5  # rows in which the stripe was whole: from fewer its width is not known
_GOES_ON, _GOES_ON_PX = 0.25, 2.0  # of the stripe's width, and in px, from where the flank was leading
_STEP_PX = 6.0  # from row to row, along one stripe
_TURNS, _BENDS = 0.3, 0.05  # by how much a row counts in where the flank is, and where it is leading


@float_kernel
def stripes_leaving_image(
    levels: Pixels, columns: int, area: Area, white: int, s: Stripes, x_px: Floats
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats, Floats]:
    """Give the rows in which overexposed stripes leave the image, as long as their middles are inside.

    Parameters
    ----------
    levels, columns
        Grey levels, row after row; the length of a row.
    area
        What is searched.
    white
        Grey level from which on a pixel is saturated.
    s
        Stripes, as `roemetry_peaks.peak_window.stripes_around` gave them.
    x_px
        (peak,) their centres; NaN where there is none.

    Returns
    -------
    tuple
        (new,) the stripe that goes on; row; middle, its standard uncertainty, and width, px.
    """
    room = 4 * (area.bottom - area.top)
    whose, rows = np.empty(room, np.int64), np.empty(room, np.int64)
    middles, stds, widths = np.empty(room), np.empty(room), np.empty(room)
    count, seen_in = 0, np.zeros((2, area.bottom - area.top), np.bool_)
    begins = np.searchsorted(s.row, np.arange(area.top, area.bottom + 2))
    flanks, known = np.empty(_ROWS + 1), np.empty(_WHOLE)
    for way in (1, -1):
        for side in (-1, 1):
            border = area.left if side < 0 else area.right - 1
            for y in range(area.top, area.bottom):
                first, end = begins[y - area.top], begins[y - area.top + 1]
                if first == end:
                    continue
                i = first if side < 0 else end - 1
                white_top = s.background[i] + s.amplitude[i] >= GLARING * white
                if s.flags[i] & EDGE == 0 or not white_top or _goes_on(s, begins, area, i, side, way) >= 0:
                    continue
                # Back along the stripe.
                p, found, whole = i, 0, 0
                while p >= 0 and whole < _WHOLE and found < _BACK:
                    flanks[min(found, _ROWS)] = s.middle[p] - side * 0.5 * s.width[p]
                    found += 1
                    # whole: the border lies beyond half of its width
                    if (border - s.middle[p]) * side > 0.5 * s.width[p]:
                        known[whole] = s.width[p]
                        whole += 1
                    p = _goes_on(s, begins, area, p, side, -way)
                if whole < _WHOLE_MIN:
                    continue
                at, lean, scatter2 = _line_through(flanks[: min(found, _ROWS)])
                width = float(np.mean(known[:whole]))
                # variance of the flank about its line, and of half the width
                std = np.sqrt(scatter2 + 0.25 * np.var(known[:whole]))
                near = max(_GOES_ON * width, _GOES_ON_PX)
                half = s.background[i] + 0.5 * s.amplitude[i]
                r = y + way
                while area.top <= r < area.bottom and count < room:
                    seen = _inner_flank(levels, r * columns, border, area, side, half, white)
                    off = seen - at - lean
                    middle = seen + side * 0.5 * width
                    beyond = (middle - border) * side
                    # until the middle leaves the image, or the flank is lost
                    if not (abs(off) < near and -0.5 * width - near <= beyond <= 0.5):
                        break
                    row, edge = r - area.top, 1 if side > 0 else 0
                    if not (seen_in[edge, row] or _is_found(x_px, begins[row], begins[row + 1], seen, side)):
                        seen_in[edge, row] = True
                        whose[count], rows[count] = i, r
                        middles[count], stds[count], widths[count] = middle, std, width
                        count += 1
                    # an alpha-beta filter: place and lean follow by fixed shares
                    at, lean = at + lean + _TURNS * off, lean + _BENDS * off
                    r += way
    return whose[:count], rows[:count], middles[:count], stds[:count], widths[:count]


@inlined
def _line_through(flanks: Floats) -> tuple[float, float, float]:
    """Value at the first of a row of places, growth towards the one before it, variance about that line."""
    count = flanks.shape[0]
    mean, middle, moment, spread = float(np.mean(flanks)), 0.5 * (count - 1), 0.0, 0.0
    for k in range(count):
        moment += (k - middle) * flanks[k]
        spread += (k - middle) * (k - middle)
    # towards the row before, against the order of the places
    lean = -moment / spread
    rest = 0.0
    for k in range(count):
        rest += (flanks[k] - mean + lean * (k - middle)) ** 2
    return mean + lean * middle, lean, rest / (count - 2)


@inlined
def _goes_on(s: Stripes, begins: NDArray[np.int64], area: Area, i: int, side: int, way: int) -> int:
    """Give the outermost stripe of the next row, if it is the same; −1 if not."""
    r = s.row[i] + way
    if not area.top <= r < area.bottom:
        return -1
    first, end = begins[r - area.top], begins[r - area.top + 1]
    if first == end:
        return -1
    p = first if side < 0 else end - 1
    inner_i, inner_p = s.middle[i] - side * 0.5 * s.width[i], s.middle[p] - side * 0.5 * s.width[p]
    return p if abs(inner_p - inner_i) <= _STEP_PX else -1


@inlined
def _is_found(x_px: Floats, first: int, end: int, flank: float, side: int) -> bool:
    """Whether a row's outermost centre lies between a flank and the border."""
    return first < end and (x_px[first if side < 0 else end - 1] - flank) * side > 0.0


@inlined
def _inner_flank(
    levels: Pixels, at: int, border: int, area: Area, side: int, half: float, white: int
) -> float:
    """Where a row's light that reaches the border falls to a level; NaN where none does, or no white."""
    x, high = border, 0.0
    while area.left <= x < area.right and levels[at + x] >= half:
        high = max(high, float(levels[at + x]))
        x -= side
    if x == border or high < GLARING * white or not area.left <= x < area.right:
        return np.nan
    low, above = float(levels[at + x]), float(levels[at + x + side])
    return x + side * (half - low) / (above - low)
