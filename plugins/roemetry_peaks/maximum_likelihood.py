"""Maximum likelihood of each stripe's centre under the camera's noise and the laser's speckle.

Light that comes out of a translucent product beside the stripe: how far a profile is from a Gaussian.

Model. On an opaque surface a row's profile is the laser's: a Gaussian of height a and standard deviation σ.
In tissue part of the light enters, is scattered and leaves again some tenths of a millimetre away. The
profile becomes a narrow peak on broad skirts, and the two skirts differ wherever the tissue does (edges,
membranes, texture). No Gaussian describes the skirts, and no other fixed curve does either. So they are not
fitted; the fit is told how little they say of the centre: each pixel's variance becomes

    v = R + (d a)² + g μ + C² m²,

d the standard deviation of the model's error over the height of the peak. Without d, the speckle term C² m²
vanishes in the skirts, and the pixels that the model is worst at weigh most.

d is measured before any fit, and separately from speckle: the mean light between 2 and 3.2 standard
deviations on each side, less what a Gaussian of that width at half height has there, over a. Speckle and
noise change from row to row and average out along a stripe; light from inside a body does not. But speckle
is shared by neighbouring rows, and so is the error of a width that is pooled over them: a mean over a few
rows, squared, is never 0. So d² is the product of two means that share no row: that of the rows next to each,
and that of farther rows, above or below, whichever agrees more, on this stripe and on the next on both sides.
Its expectation is 0 for speckle, and d² for a material that goes on to one side at least. What farther rows
do not show, as where a material ends soon, is a model error as far as it exceeds chance, but no light.

Light enters at an angle, so what is scattered comes out farther from the projector, and draws the fitted
centre there. It draws the flanks less than the skirts: the two lean to opposite sides of the fit. So the
shift that the flanks between 0.5 and 1.5 σ ask for, averaged along the stripe, tells side and size, and the
centre is moved by twice as much. Over 24 rigs of three renderers, mean error of bodies 0.17 → 0.055 px.

Assumed: neighbouring rows see the same material; width at half height is hardly changed by the skirts. Fails
where stripes stand nearer together than about 7 σ (their skirts overlap), and where a stripe is so short that
its rows do not average: d is then taken from the same row's next stripes.

Source: subsurface scattering by a narrow beam, Farrell, Patterson, Wilson (1992), Medical Physics 19:879–888;
a variance for the error of a model after Kennedy, O'Hagan (2001), J. R. Statist. Soc. B 63:425–464. The rest
is ours.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roemetry.records import EDGE, SATURATED, Frame, Peaks, Reason
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Capabilities, Extractor
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.image_levels import (
    SHARE_MIN,
    clipped_beyond,
    doubts,
    faint,
    grey,
    plain_layout,
    scaled_level,
)
from roemetry_peaks.fisher_scoring import CLIPPED, FAILED, FITTED, Fitted, Gaussians, fit_peaks, gauss
from roemetry_peaks.searching import Narrowest, SearchOptions, searched
from roemetry_peaks.smoothed_peaks import (
    NOISE_LEFT,
    Beside,
    Starts,
    background_noise,
    light_beside,
    pooled,
    rounding_variance,
    smoothed_peaks,
)
from roemetry_peaks.speckle_noise import (
    FINE_TILES,
    TILES,
    StripeNoise,
    noise_from,
    noise_of_file,
    residual_products,
    rows_of,
    tile_of,
)
from roemetry_peaks.stated_uncertainty import corrected

_NOISES = 8.0  # of the smoothed image, that a stripe rises above both valleys
_LEVELS_MIN = 5.0  # grey levels of 0…255 that it rises at least
_AMPLITUDE_NOISES = 5.0  # of one pixel beside the stripe, that a fitted stripe is high
_DARK_SHARE = 0.1  # of white: light so far below black beside a stripe means that the fit has no hold
_FWHM = 2.3548200450309493  # full width at half height of a Gaussian, standard deviations
_SAMPLES = (240, 720)
"""Peaks that tell of the noise, in the first and the second pass. Up to twice as many give the same centres
and uncertainties on drawn images (one material, two, tissue); after one pass alone intervals on tissue under
speckle 0.25 hold 89 instead of 94 %."""
_GOLDEN = 0.6180339887498949  # (√5 − 1)/2: multiples of it, less whole numbers, repeat latest
_FIRST_CONTRAST = 0.1  # of the speckle, until the first pass has measured it
_READ_SHARE = 2.0  # of the variance beside the stripes, that the read noise's can be
_READ_MOST = 0.02  # of white, that it can be even where what is dark was made smooth (JPEG, subtraction)
_GAIN_SHARE = 1.0 / 255.0  # of white, that an electron can be
_EVERY = 7  # peak's share of speckle is looked at
_OPAQUE_MIN = 100
"""Peaks without an error of the profile's model, from which on they alone tell of the noise: of fewer no
contrast by tile can be told, and all are taken."""
_FLANKS_ERROR = 0.1
"""Model error over the start's height, for the fit that clipped tops' skirts are measured against: it makes
the flanks decide, and leaves the skirts out."""
_CUT = 2.0  # a stripe nearer to the left or right border than so many standard deviations is cut off


class MaximumLikelihoodOptions(SearchOptions):
    """Options of `MaximumLikelihood`."""

    width_min_px: Narrowest = 2.0
    width_max_px: float = Field(
        default=40.0,
        gt=0.0,
        le=90.0,
        description="largest full width at half height that a fit has room for, px",
    )
    speckle_contrast: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["auto"] = Field(
        default="auto",
        description="standard deviation of the stripe's light over its mean; auto: estimated from each "
        "image, for each of 4 × 12 tiles",
    )
    speckle_length_px: float = Field(
        default=0.8,
        ge=0.1,
        le=1.5,
        description="correlation length of the speckle, px, if speckle_contrast is a number: neighbouring "
        "pixels correlate by exp(−1/(4 length²))",
    )
    noise: Path | None = Field(
        default=None,
        description="noise measured beforehand by python -m roemetry_peaks.measure_noise: read noise, gain "
        "and speckle contrast by tile; nothing is then estimated from the image",
    )


class MaximumLikelihood(Extractor[MaximumLikelihoodOptions]):
    """Fits a Gaussian's centre, height and width to each row's stripe, weighted by each pixel's noise."""

    capabilities = Capabilities(tolerance_px=0.02, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        image, found = starts(frame, self.options)
        white = frame.highest
        noise = found.noise if found.noise is not None else estimated_noise(image, white, found)
        if found.noise is None and self.options.speckle_contrast != "auto":
            noise = _noise_as_told(self.options, noise.variance, noise.gain)
        at = found.starts
        fit = fitted(image, white, found, noise)
        core = middles_of_flanks(fit, image, white, found)
        undo_scattering(fit, image, white, found, ~core)
        kept = self._kept(fit, found, noise, white)
        order: Any = slice(None) if kept.all() else np.flatnonzero(kept)  # a slice copies nothing
        if not _apart(at.row[order], fit.x_px[order], fit.sigma_px[order]).all():
            order = np.flatnonzero(kept)
            order = order[np.lexsort((fit.x_px[order], at.row[order]))]
            order = order[_apart(at.row[order], fit.x_px[order], fit.sigma_px[order])]
        x_px, sigma_px = fit.x_px[order], fit.sigma_px[order]
        beyond = _CUT * sigma_px
        flags = np.where(fit.state[order] == CLIPPED, SATURATED, 0)
        flags |= np.where((x_px < beyond) | (x_px > image.shape[1] - 1 - beyond), EDGE, 0)
        share = float(np.median(fit.speckled[order][::_EVERY])) if x_px.size else 0.0
        flags = flags.astype(np.uint8)
        row, height, width = at.row[order], found.beside.height[order], _FWHM * sigma_px
        known = row, x_px, fit.x_std_px[order], fit.amplitude[order], height, width, flags
        x_std_px, contradictions = corrected(
            image, *known, sensor=(noise.variance, noise.gain), asked=~found.lit[order]
        )
        return Peaks(
            image_size=frame.size,
            row=row + found.top,
            x_px=x_px + found.left,
            x_std_px=x_std_px,
            amplitude=fit.amplitude[order],
            background=height,
            width_px=width,
            flags=flags | clipped_beyond(frame, row + found.top, x_px + found.left),
            correlation_rows=rows_of(share, noise.correlation),
            reasons=(
                *(() if found.measured else (_ESTIMATED,)),
                *contradictions,
                *doubts(image, frame.white, row, x_px, width),
            ),
        )

    def _kept(self, fit: Fitted, found: Found, noise: StripeNoise, white: int) -> Flags:
        options = self.options
        width = _FWHM * fit.sigma_px
        quiet = np.sqrt(noise.variance + noise.gain * np.maximum(found.beside.height, 0.0))
        kept: Flags = (
            (fit.state > 0)
            & (width <= options.width_max_px)
            & (fit.amplitude > _AMPLITUDE_NOISES * quiet)
            & (found.beside.height >= -_DARK_SHARE * white)
            & (fit.x_std_px < fit.sigma_px)
            & (np.abs(fit.x_px - 0.5 * (found.columns - 1)) <= 0.5 * found.columns)
        )
        narrow = width < options.width_min_px
        if narrow.any():
            # a hot pixel is alone: its light is in no other row
            down, up = found.beside.down, found.beside.up
            kept &= ~narrow | ((down >= 0) & (up >= 0) & kept[down] & kept[up])
        return kept


class Found(NamedTuple):
    """Stripes of an image before they are fitted, and what is known of the noise."""

    starts: Starts
    beside: Beside
    """starts, beside: where fits start, and the light beside the stripes."""
    variance: float | None
    gain: float | None
    """variance, gain: R, grey levels², and g, grey levels; None where not known."""
    rounding: float
    quiet: float
    """rounding, quiet: variance of rounding, and of a pixel beside the stripes, grey levels²."""
    noise: StripeNoise | None
    """The whole noise, where it is given."""
    measured: bool
    """Whether read noise and gain are known."""
    top: int
    left: int
    columns: int
    """top, left, columns: place and width of the part that is searched."""
    error: Floats
    """(peak,) variance of the profile model's error, grey levels² (`model_error`)."""
    lit: Flags
    """(peak,) whether that error is light that comes from inside the product."""


_ESTIMATED = Reason(
    "noise-estimated", "the camera's gain and read noise are not known; they were estimated from the image"
)


def starts(frame: Frame, options: MaximumLikelihoodOptions) -> tuple[Any, Found]:
    """Find where to fit; gives the searched part of the image with it."""
    area = searched(frame, options.region)
    image = plain_layout(grey(frame)[area.top : area.bottom, area.left : area.right])
    given = None
    rounding = rounding_variance(image)
    variance, gain = _sensor(frame, rounding)
    if options.noise is not None:
        given = noise_of_file(options.noise, frame, area, rounding)
        variance, gain = given.variance, given.gain
    elif options.speckle_contrast != "auto" and variance is not None and gain is not None:
        given = _noise_as_told(options, variance, gain)
    quiet = max(background_noise(image) ** 2, rounding if variance is None else variance)
    slope = 0.0 if gain is None else gain
    level = (np.arange(256) + 0.5) / 256.0 * frame.highest
    if options.threshold == "auto":
        rise = _NOISES * NOISE_LEFT * np.sqrt(np.maximum(quiet, (variance or 0.0) + slope * level))
        rise = np.maximum(rise, scaled_level(_LEVELS_MIN, frame))
    else:
        rise = np.full(256, scaled_level(options.threshold, frame))
    where = smoothed_peaks(image, rise, frame.highest)
    if options.threshold == "auto":
        seen = np.minimum(where.amplitude, float(frame.highest))  # of a clipped top, more is a guess
        if (low := faint(where.row, where.x_px, seen, SHARE_MIN)).any():
            where = type(where)._make(values[~low] for values in where)
    beside = light_beside(image, where, math.sqrt(quiet), slope)
    measured = variance is not None and gain is not None
    place = area.top, area.left, image.shape[1]
    none = np.zeros(where.row.size), np.zeros(where.row.size, np.bool_)
    found = Found(where, beside, variance, gain, rounding, quiet, given, measured, *place, *none)
    error, lit = _model_error(image, frame.highest, found)
    return image, found._replace(error=error, lit=lit)


def _model_error(image: Any, white: int, found: Found) -> tuple[Floats, Flags]:
    """(peak,) variance of the error of a Gaussian as the profile, grey levels²; whether it is light."""
    at, beside = found.starts, found.beside
    x_px, amplitude, sigma_px = at.x_px.copy(), beside.amplitude.copy(), beside.sigma_px.copy()
    inside = np.clip(np.rint(x_px).astype(np.int64), 0, image.shape[1] - 1)
    clipped = np.flatnonzero(image[at.row, inside] >= white)
    if clipped.size:
        # Half of the height that a clipped top would have is not seen: its start is too wide.
        guess = found.quiet if found.variance is None else found.variance
        noise = StripeNoise(guess, found.gain or 0.0, 0.0, np.full(TILES, _FIRST_CONTRAST**2))
        even = found._replace(error=(_FLANKS_ERROR * beside.amplitude) ** 2)
        fit = fitted(image, white, even, noise, clipped)
        lost = fit.state == FAILED
        x_px[clipped], sigma_px[clipped] = fit.x_px, fit.sigma_px
        amplitude[clipped] = np.where(lost, np.nan, fit.amplitude)
    height = beside.height + beside.slope * (x_px - at.x_px)
    start = Gaussians(at.row, x_px, amplitude, sigma_px, height, beside.slope)
    share, lit = model_error(image, float(white), start, beside.down, beside.up)
    return share * beside.amplitude**2, lit


def _sensor(frame: Frame, rounding: float) -> tuple[float | None, float | None]:
    """R and g, as far as the frame knows them."""
    if frame.sensor is None:
        return None, None
    read, gain = frame.sensor.read_noise_grey, frame.sensor.gain_grey_per_electron
    return (None if math.isnan(read) else read**2 + rounding), (None if math.isnan(gain) else gain)


def _noise_as_told(options: MaximumLikelihoodOptions, variance: float, gain: float) -> StripeNoise:
    contrast2 = np.full(TILES, float(options.speckle_contrast) ** 2)
    return StripeNoise(variance, gain, math.exp(-0.25 / options.speckle_length_px**2), contrast2)


def estimated_noise(image: Any, white: int, found: Found) -> StripeNoise:
    """Estimate the noise from the image in two passes; each fits a sample of the peaks.

    Where there is more than one material, a third one fits all, and takes smaller tiles.
    """
    guess = (found.quiet if found.variance is None else found.variance, found.gain or 0.0)
    noise = StripeNoise(*guess, 0.0, np.full(TILES, _FIRST_CONTRAST**2))
    for size, tiles in ((_SAMPLES[0], TILES), (_SAMPLES[1], TILES), (found.starts.row.size, FINE_TILES)):
        if tiles == TILES or noise.differs:
            noise = noise_from(
                *products_of(image, white, found, noise, size, tiles),
                variance=found.variance,
                gain=found.gain,
                rounding=found.rounding,
                most=most_noise(found, white),
                tiles=tiles,
            )
    return noise


def most_noise(found: Found, white: int) -> tuple[float, float]:
    """Give what R and g can be at most: no camera is so noisy that it would be stated."""
    return max(_READ_SHARE * found.quiet, (_READ_MOST * white) ** 2), _GAIN_SHARE * white


def products_of(
    image: Any, white: int, found: Found, noise: StripeNoise, size: int, tiles: tuple[int, int] = TILES
) -> tuple[Floats, Integers, Floats]:
    """Fit a sample of the peaks, and give their residual products, the tiles they lie in, and their C²."""
    peaks = found.starts.row.shape[0]
    opaque = np.flatnonzero((found.error == 0.0) & ~found.beside.halo)
    if opaque.size < _OPAQUE_MIN:
        opaque = np.flatnonzero(~found.beside.halo)
    if opaque.size < _OPAQUE_MIN:
        opaque = np.arange(peaks)
    pick = opaque[_spread(opaque.size, size)]
    alone = StripeNoise(noise.variance, noise.gain, 0.0, noise.contrast2)
    fit = fitted(image, white, found, alone, pick)
    peaks, error = on_light(fit, found, pick), found.error[pick]
    of_peaks = alone.of_peaks(image.shape, peaks.row, found.starts.x_px[pick], error, 0.0)
    products = residual_products(image, float(white), peaks, of_peaks, fit.state)
    # What the model's error adds to each sum is known: the rest is noise.
    products[:, :, 0] -= products[:, :, 1] * error[:, None]
    return products, tile_of(image.shape, peaks.row, fit.x_px, tiles), of_peaks.contrast2


def _spread(peaks: int, size: int) -> Integers:
    """Numbers of some of the peaks, spread over all; in equal steps they might be one stripe's."""
    if peaks <= size:
        return np.arange(peaks)
    within = (np.arange(size) * _GOLDEN) % 1.0
    return ((np.arange(size) + within) * (peaks / size)).astype(np.int64)


_ALL = slice(None)


def fitted(image: Any, white: int, found: Found, noise: StripeNoise, pick: Any = _ALL) -> Fitted:
    """Fit the chosen peaks."""
    at, beside = found.starts, found.beside
    start = Gaussians(
        at.row[pick], at.x_px[pick], at.amplitude[pick], beside.sigma_px[pick], beside.height[pick],
        beside.slope[pick],
    )  # fmt: skip
    known = noise.of_peaks(image.shape, start.row, start.x_px, found.error[pick], noise.correlation)
    return fit_peaks(image, float(white), start, known)


def on_light(fit: Fitted, found: Found, pick: Any = _ALL) -> Gaussians:
    """Give fits with the light beside them where they are."""
    at, slope = found.starts, found.beside.slope[pick]
    height = found.beside.height[pick] + slope * (fit.x_px - at.x_px[pick])
    return Gaussians(at.row[pick], *fit[:3], height, slope)


def _apart(row: Integers, x_px: Floats, sigma_px: Floats) -> Flags:
    """Say which peaks do not coincide with the one before, of peaks sorted by row, then x."""
    apart = np.ones(row.shape[0], np.bool_)
    if row.shape[0]:
        apart[1:] = (np.diff(row) > 0) | (np.diff(x_px) > 0.5 * np.minimum(sigma_px[1:], sigma_px[:-1]))
    return apart


_STD_PX = 0.15
"""Of the middle of two flanks; intervals of clipped cores then hold 98 %."""
_VAGUE = 2.0
"""Uncertainty of a fit over that of the core's middle from which on the fit gives way; 1 where the core bends
less along the stripe. The core's does not know of speckle, which bends it: at 1, peaks of contrast 0.25 err
2 % more; at 3, lines in room light are taken amiss."""
_APART_ROWS, _BENT_ROWS = 4, 15
"""Rows between the three whose bend is looked at, beyond speckle's reach; rows above and below that are
averaged. Fits of stripes with speckle of 0.12 to 0.25 bend 0.3 to 0.9 times as much as cores; of lines in
halos and room light 1.1 to 3 times."""
_CORE_ROWS = 3
"""Rows averaged on either side. A core's few pixels on its flanks scatter by 0.034 px on a still line in JPEG
images; over 5 rows by 0.025, over 7 by 0.022 px. More smear the edge of a body."""
_UNIFORM = 1.0 / math.sqrt(12.0)
"""Standard deviation of what lies anywhere in a core, over its width: no middle is more uncertain."""
_OWN_SHARE = 0.5
"""Of a peak's height: what its own row has of it at least, speckle included, or it is a neighbour's."""


def middles_of_flanks(fit: Fitted, image: Any, white: int, found: Found) -> Flags:
    """Give tops that are no Gaussian the middle of their core; (peak,) which these are.

    Two or three lit pixels a flank do not tell height from width of a top cut off at white, or the light is
    none that has a Gaussian's flanks, as in halos. Then the fit's own uncertainty, with the noise that its
    residuals ask for, is larger than that of the chord high up, whose ends lie anywhere within what a flank
    moves by between two levels. Where nothing is cut off, light around a core and speckle in it look alike,
    and the fit's uncertainty stays.

    Both uncertainties, and the middle, are means over the rows next to each of the same stripe: a stripe that
    took the fit in one row and the core in the next would jump by what lies between them. What is stated of a
    fit rests on a noise that is estimated, and changes from one image of a still line to the next; so the
    stripe itself is asked, too, by how much fits and cores bend along it.
    """
    beside = found.beside
    core: Flags = cores_for_fits(image, float(white), found.starts, beside.halo, beside.up, beside.down, fit)
    return core


@float_kernel
def cores_for_fits(
    image: NDArray[Any], white: float, at: Starts, halo: Flags, up: Integers, down: Integers, fit: Fitted
) -> Flags:
    """Put cores for fits in place, as `middles_of_flanks` says; (peak,) where it did."""
    peaks, last = at.row.size, image.shape[1] - 1
    core, clipped, inside = np.zeros(peaks, np.bool_), np.zeros(peaks, np.bool_), np.empty(peaks, np.int64)
    each = np.empty((peaks, 3))
    for p in range(peaks):
        inside[p] = min(max(np.int64(np.rint(at.core_px[p])), 0), last)
        clipped[p] = image[at.row[p], inside[p]] >= white
        std_px = math.sqrt(_STD_PX * _STD_PX + at.core_std_px[p] * at.core_std_px[p])
        fit_std_px = std_px if fit.state[p] == FAILED else fit.x_std_px[p]
        each[p, 0], each[p, 1], each[p, 2] = at.core_px[p], std_px * std_px, fit_std_px * fit_std_px
    mean = _along(each, up, down)
    bends = pooled(_bends(fit, at.core_px, up, down), up, down, _BENT_ROWS, _BENT_ROWS)
    for p in range(peaks):
        times = 1.0 if clipped[p] or bends[p, 0] > bends[p, 1] else _VAGUE
        failed = fit.state[p] == FAILED
        vague = (failed and clipped[p]) or mean[p, 2] > times * times * mean[p, 1]
        if not (halo[p] or (vague and (clipped[p] or not failed))):
            continue
        # smoothing sees the rows beside it, too: a core is where its own row has light
        own = image[at.row[p], inside[p]]
        for x in (max(inside[p] - 1, 0), min(inside[p] + 1, last)):
            own = max(own, image[at.row[p], x])
        core[p] = clipped[p] or own - at.level[p] > _OWN_SHARE * at.amplitude[p]
        if core[p]:
            at_least_px = min(fit.x_std_px[p], _UNIFORM * at.core_width_px[p])
            if clipped[p] or halo[p]:
                at_least_px = 0.0
            fit.x_px[p], fit.amplitude[p] = mean[p, 0], at.amplitude[p]
            fit.sigma_px[p] = at.core_width_px[p] / _FWHM
            fit.x_std_px[p] = max(math.sqrt(each[p, 1]), at_least_px)
            fit.speckled[p], fit.state[p] = 0.0, CLIPPED if clipped[p] else FITTED
    return core


@float_kernel
def _bends(fit: Fitted, core_px: Floats, up: Integers, down: Integers) -> Floats:
    """(peak, 2) by how much fit and core bend: second differences over rows `_APART_ROWS` apart, px."""
    out = np.zeros((core_px.size, 2))
    for p in range(core_px.size):
        above, below = p, p
        for _ in range(_APART_ROWS):
            above = up[above] if above >= 0 else above
            below = down[below] if below >= 0 else below
        if above >= 0 and below >= 0:
            off = fit.x_px[above] + fit.x_px[below] - 2.0 * fit.x_px[p]
            if not math.isnan(off):
                out[p, 0], out[p, 1] = abs(off), abs(core_px[above] + core_px[below] - 2.0 * core_px[p])
    return out


@float_kernel
def _along(values: Floats, up: Integers, down: Integers) -> Floats:
    """(peak, value) means over as many rows above as below, so that a lean moves nothing."""
    mean = values.copy()
    for p in range(values.shape[0]):
        above, below, rows = up[p], down[p], 1
        while above >= 0 and below >= 0 and rows <= 2 * _CORE_ROWS:
            for k in range(values.shape[1]):  # as sums of whole rows each would be an array of its own
                mean[p, k] += values[above, k] + values[below, k]
            above, below, rows = up[above], down[below], rows + 2
        for k in range(values.shape[1]):
            mean[p, k] /= rows
    return mean


_INNER, _OUTER = 2.0, 3.2
"""Where the skirts are looked at, standard deviations from the middle: inside, the peak's own light and
errors of the width outweigh them; outside ends the window of the fit."""
_ROWS_ABOVE, _ROWS_BELOW = 7, 6
"""Rows that are averaged. Fewer leave speckle in the mean, more smear the edge of a body."""
_ROWS_FAR = 30
"""Rows beyond them, above or below, that must agree. 15 to 60 leave the same errors within 1 % on drawn
stripes of speckle 0.25 and on rendered tissue."""
_ROWS_MIN = 5
"""Rows below which an average is not told from speckle."""
_CHANCE, _ALIKE_ROWS = 3.0, 2.8
"""Standard errors within which a mean is chance; rows of speckle 0.8 px long that tell as much as one, the
sum of their correlations exp(−k² / (4 · 0.8²)) over whole k."""
_START_ERROR = 0.015
"""Excess over the peak's height that counts as an error of the start's width and of pixels that integrate: on
drawn Gaussians of σ 1.5 to 5 px it stays below that; skirts of tissue are 0.02 to 0.1."""
_SHARE = 2.0
"""Model error over the measured excess. The excess is what stands above a line through the light farther out,
which the skirts have lifted already, and its mean hides texture: so the error is larger. Between 1.5 and 4
the precision on scattering bodies changes by less than 5 %; at 1 the stated uncertainty is a third too
small."""


@float_kernel
def model_error(
    image: NDArray[Any], white: float, start: Gaussians, down: Integers, up: Integers
) -> tuple[Floats, Flags]:
    """Give d², the variance of the profile model's error over the square of the peak's height.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels.
    white
        Grey level from which on a pixel is saturated.
    start
        Where fits start: middles at half height.
    down, up
        (peak,) the same stripe's peak in the next and in the last row; −1 for none.

    Returns
    -------
    tuple
        (peak,) d², and whether the error is light beside the peak, and not a lack of it: a profile with flat
        top and steep flanks is no Gaussian either.
    """
    row, x_px, sigma_px = start.row, start.x_px, start.sigma_px
    peaks, columns = row.shape[0], image.shape[1]
    sums = np.zeros((peaks, 6))  # of each side: rows, excess, its square
    whole = np.empty(peaks, np.bool_)
    for p in range(peaks):
        # Where the border cuts a stripe off, the middle and the width that it starts from are no measure.
        margin = _OUTER * sigma_px[p]
        whole[p] = not (x_px[p] < margin or x_px[p] > columns - 1 - margin)
        for side in range(2):
            sign = 2 * side - 1
            total, pixels = 0.0, 0
            near, far = _INNER * sigma_px[p], margin
            other = p + sign
            if 0 <= other < peaks and row[other] == row[p]:
                far = min(far, abs(x_px[other] - x_px[p]) - _OUTER * sigma_px[other])
            if far <= near or not whole[p]:
                continue
            first, last = x_px[p] + sign * near, x_px[p] + sign * far
            begin, end = math.ceil(min(first, last)), math.floor(max(first, last)) + 1
            for x in range(max(begin, 0), min(end, columns)):
                if image[row[p], x] >= white:
                    continue
                u = x - x_px[p]
                gaussian = start.amplitude[p] * gauss(0.5 * (u / sigma_px[p]) ** 2)
                total += image[row[p], x] - start.height[p] - start.slope[p] * u - gaussian
                pixels += 1
            excess = total / (pixels * start.amplitude[p]) if pixels else np.nan
            if not math.isnan(excess):
                sums[p, 3 * side], sums[p, 3 * side + 1], sums[p, 3 * side + 2] = 1.0, excess, excess * excess
    near = pooled(sums, up, down, _ROWS_ABOVE, _ROWS_BELOW)
    above, below = _farther(sums, row, up, down)
    error2, lit = np.full(peaks, np.nan), np.zeros(peaks, np.bool_)
    for p in range(peaks):
        known, sum2, sure2, sum1 = 0, 0.0, 0.0, 0.0
        for side in range(2):
            if near[p, 3 * side] < _ROWS_MIN:
                continue
            mean = near[p, 3 * side + 1] / near[p, 3 * side]
            agreed2 = 0.0
            for far in (above, below):
                if far[p, 3 * side] >= _ROWS_MIN:
                    agreed2 = max(agreed2, mean * far[p, 3 * side + 1] / far[p, 3 * side])
            spread2 = max(near[p, 3 * side + 2] / near[p, 3 * side] - mean * mean, 0.0)
            own2 = mean * mean - _CHANCE * _CHANCE * spread2 / (near[p, 3 * side] / _ALIKE_ROWS - 1.0)
            sum2 += max(max(agreed2, own2) - _START_ERROR * _START_ERROR, 0.0)
            sure2 += max(agreed2 - _START_ERROR * _START_ERROR, 0.0)
            sum1 += mean
            known += 1
        if known:
            error2[p] = sum2 / known
            lit[p] = sure2 > 0.0 and sum1 > 0.0
    # Where stripes crowd or are short, the same row's next stripes are most likely of the same material.
    filled = error2.copy()
    for p in range(peaks):
        if math.isnan(error2[p]):
            filled[p] = 0.0
            for other in (p - 1, p + 1):
                if 0 <= other < peaks and row[other] == row[p] and error2[other] > filled[p]:
                    filled[p], lit[p] = error2[other], lit[other]
        if not whole[p]:
            filled[p] = 0.0  # what the rows above and below say is not of the part that is seen
        filled[p] *= _SHARE * _SHARE
    return filled, lit


@float_kernel
def _farther(sums: Floats, row: Integers, up: Integers, down: Integers) -> tuple[Floats, Floats]:
    """Sum over the rows above and below that share no row of this stripe with the rows next to each peak.

    Those of the next stripes on both sides count, too.
    """
    around = sums.copy()
    for p in range(row.shape[0]):
        for other in (p - 1, p + 1):
            if 0 <= other < row.shape[0] and row[other] == row[p]:
                for k in range(sums.shape[1]):
                    around[p, k] += sums[other, k]
    above = pooled(around, up, down, _ROWS_ABOVE + _ROWS_FAR, 0) - pooled(sums, up, down, _ROWS_ABOVE, 0)
    below = pooled(around, up, down, 0, _ROWS_BELOW + _ROWS_FAR) - pooled(sums, up, down, 0, _ROWS_BELOW)
    return above, below


_FLANK = 0.5, 1.5
"""Flanks: from where to where, standard deviations from the middle. Nearer, the profile has no slope; farther
out the skirts begin, which lean the other way."""
_CERTAIN = 3.0
"""Standard errors of the mean from which on the flanks are believed: speckle 0.25 on an opaque surface looks
like tissue in some rows, and stays at the bound so."""
_FLANK_ROWS = 80
"""Rows above and below whose flanks are averaged: speckle moves those of one row by 0.2 px. Material and
angle hardly change over a product: 24 to 300 rows leave the same bias within 0.01 px."""
_DRAWN = 2.0
"""How far scattered light draws the fit, over how far the flanks stand back from it. For a line of light on a
half space (dipole; free path 0.4 to 3 σ, 30 to 60 % of the light scattered, angles of 20 to 50°) the fit and
the middle at half height give a factor of 2 to 12: so this does not overcorrect. 1.5 to 2.5 leave 0.08 to
0.05 px of 0.17 px."""


def undo_scattering(fit: Fitted, image: Any, white: int, found: Found, is_fit: Flags) -> None:
    """Move fitted centres back that light from inside the product has drawn away from the projector."""
    asked = found.lit & (fit.state != FAILED) & is_fit
    if asked.any():
        beside = found.beside
        shift = flank_shift(image, float(white), on_light(fit, found), asked, beside.down, beside.up)
        fit.x_px[:] += _DRAWN * shift


@float_kernel
def flank_shift(
    image: NDArray[Any], white: float, fit: Gaussians, asked: Flags, down: Integers, up: Integers
) -> Floats:
    """Give how far the flanks of profiles stand beside the fitted centre, averaged along each stripe.

    Parameters
    ----------
    image, white, down, up
        As of `model_error`.
    fit
        The fits.
    asked
        (peak,) which peaks have light from inside the product; 0 is given for the others.

    Returns
    -------
    ndarray
        (peak,) shift in px that brings the Gaussian's flanks to those of the profile, by least squares.
    """
    row, x_px, amplitude, sigma_px = fit.row, fit.x_px, fit.amplitude, fit.sigma_px
    peaks, columns = row.shape[0], image.shape[1]
    sums = np.zeros((peaks, 3))
    for p in range(peaks):
        if not asked[p]:
            continue
        near, far = _FLANK[0] * sigma_px[p], _FLANK[1] * sigma_px[p]
        first, last = math.ceil(x_px[p] - far), math.floor(x_px[p] + far)
        if first < 0 or last >= columns:
            continue
        for x in range(first, last + 1):
            u = x - x_px[p]
            if abs(u) < near or image[row[p], x] >= white:
                continue
            t = u / sigma_px[p]
            gaussian = gauss(0.5 * t * t)
            slant = t / sigma_px[p] * gaussian
            residual = image[row[p], x] - fit.height[p] - fit.slope[p] * u - amplitude[p] * gaussian
            sums[p, 0] += residual * slant / amplitude[p]
            sums[p, 1] += slant * slant
        sums[p, 2] = sums[p, 0] ** 2
    sums = pooled(sums, up, down, _FLANK_ROWS + 1, _FLANK_ROWS)
    shift = np.zeros(peaks)
    for p in range(peaks):
        over, squares = sums[p, 0], sums[p, 2]
        # Of a surface that speckle alone takes for tissue, the sum is chance.
        if asked[p] and over * over > _CERTAIN * _CERTAIN * squares:
            shift[p] = over / sums[p, 1] * (1.0 - squares / (over * over))  # shrunk by the share of chance
    return shift
