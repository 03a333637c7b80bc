"""Maximum likelihood of each stripe's centre under the camera's noise and the laser's speckle."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from roemetry.records import EDGE, SATURATED, Frame, Peaks, Reason
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry.stages import Capabilities, Extractor, StageOptions
from roemetry_kernels.image_levels import grey, plain_layout, scaled_level
from roemetry_peaks.clipped_tops import middles_of_flanks
from roemetry_peaks.noise_file import noise_of_file
from roemetry_peaks.region import searched
from roemetry_peaks.speckle_noise import FINE_TILES, TILES, StripeNoise, noise_from, rows_of, tile_of

if TYPE_CHECKING:
    from roemetry_peaks.local_background import Beside
    from roemetry_peaks.smoothed_peaks import Starts

_NOISES = 8.0  # of the smoothed image, that a stripe rises above both valleys
_LEVELS_MIN = 5.0  # grey levels of 0…255 that it rises at least
_AMPLITUDE_NOISES = 5.0  # of one pixel beside the stripe, that a fitted stripe is high
_DARK_SHARE = 0.1  # of white: light so far below black beside a stripe means that the fit has no hold
_FWHM = 2.3548200450309493  # full width at half height of a Gaussian, standard deviations
_SAMPLES = (480, 960)  # peaks that tell of the noise, in the first and the second pass
_GOLDEN = 0.6180339887498949
_FIRST_CONTRAST = 0.1
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


class MaximumLikelihoodOptions(StageOptions):
    """Options of `MaximumLikelihood`."""

    threshold: Annotated[float, Field(ge=1.0, le=255.0)] | Literal["auto"] = Field(
        default="auto",
        description="grey levels (of 0…255, scaled for deeper images) by which a stripe must rise above both "
        "valleys, in the lightly smoothed image; auto: 8 times the noise of that image, at least 5, "
        "and 8 % of what the image's stripes reach",
    )
    width_min_px: float = Field(
        default=2.0,
        ge=0.0,
        le=100.0,
        description="smallest full width at half height, px: rejects hot pixels",
    )
    width_max_px: float = Field(
        default=40.0, gt=0.0, le=90.0, description="largest full width at half height, px: rejects glare"
    )
    region: tuple[int, int, int, int] | None = Field(
        default=None,
        description="part of the (turned) image to search: first row, row after the last, first column, "
        "column after the last, px; none: all of it",
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


class Fitted(NamedTuple):
    """Fits, one element a peak."""

    x_px: Floats
    amplitude: Floats
    sigma_px: Floats
    x_std_px: Floats
    speckled: Floats
    state: Any


class MaximumLikelihood(Extractor[MaximumLikelihoodOptions]):
    """Fits a Gaussian's centre, height and width to each row's stripe, weighted by each pixel's noise."""

    Options: ClassVar[type[StageOptions]] = MaximumLikelihoodOptions
    capabilities = Capabilities(tolerance_px=0.02, saturated_tolerance_px=0.1)

    def extract(self, frame: Frame) -> Peaks:
        """Find the stripes of a frame."""
        from roemetry_kernels.image_levels import doubts
        from roemetry_peaks.fisher_scoring import CLIPPED
        from roemetry_peaks.stated_uncertainty import corrected

        image, found = starts(frame, self.options)
        noise = found.noise if found.noise is not None else estimated_noise(image, frame.white, found)
        if found.noise is None and self.options.speckle_contrast != "auto":
            noise = _noise_as_told(self.options, noise.variance, noise.gain)
        at = found.starts
        fit = fitted(image, frame.white, found, noise, np.arange(at.row.shape[0]))
        middles_of_flanks(fit, image, frame.white, found)
        kept = self._kept(fit, found, noise, frame.white)
        order: Any = slice(None) if kept.all() else np.flatnonzero(kept)
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
            flags=flags,
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
            & (width >= options.width_min_px)
            & (width <= options.width_max_px)
            & (fit.amplitude > _AMPLITUDE_NOISES * quiet)
            & (found.beside.height >= -_DARK_SHARE * white)
            & (fit.x_std_px < fit.sigma_px)
            & (np.abs(fit.x_px - 0.5 * (found.columns - 1)) <= 0.5 * found.columns)
        )
        return kept


class Found(NamedTuple):
    """Stripes of an image before they are fitted, and what is known of the noise.

    Attributes
    ----------
    starts, beside
        Where fits start, and the light beside the stripes.
    variance, gain
        R, grey levels², and g, grey levels; None where not known.
    rounding, quiet
        Variance of rounding, and of a pixel beside the stripes, grey levels².
    noise
        The whole noise, where it is given.
    measured
        Whether read noise and gain are known.
    top, left, columns
        Place and width of the part that is searched.
    error
        (peak,) variance of the profile model's error, grey levels² (`roemetry_peaks.scattering`).
    lit
        (peak,) whether that error is light that comes from inside the product.
    """

    starts: Starts
    beside: Beside
    variance: float | None
    gain: float | None
    rounding: float
    quiet: float
    noise: StripeNoise | None
    measured: bool
    top: int
    left: int
    columns: int
    error: Floats
    lit: Flags


_ESTIMATED = Reason(
    "noise-estimated", "the camera's gain and read noise are not known; they were estimated from the image"
)


def starts(frame: Frame, options: MaximumLikelihoodOptions) -> tuple[Any, Found]:
    """Find where to fit; gives the searched part of the image with it."""
    from roemetry_kernels.image_levels import SHARE_MIN, faint
    from roemetry_peaks.local_background import light_beside
    from roemetry_peaks.smoothed_peaks import (
        NOISE_LEFT,
        background_noise,
        rounding_variance,
        smoothed_peaks,
    )

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
    level = (np.arange(256) + 0.5) / 256.0 * frame.white
    if options.threshold == "auto":
        rise = _NOISES * NOISE_LEFT * np.sqrt(np.maximum(quiet, (variance or 0.0) + slope * level))
        rise = np.maximum(rise, scaled_level(_LEVELS_MIN, frame))
    else:
        rise = np.full(256, scaled_level(options.threshold, frame))
    where = smoothed_peaks(image, rise, frame.white)
    if (
        options.threshold == "auto"
        and (low := faint(where.row, where.x_px, where.amplitude, SHARE_MIN)).any()
    ):
        where = type(where)._make(values[~low] for values in where)
    beside = light_beside(image, where, math.sqrt(quiet), slope)
    measured = variance is not None and gain is not None
    place = area.top, area.left, image.shape[1]
    none = np.zeros(where.row.size), np.zeros(where.row.size, np.bool_)
    found = Found(where, beside, variance, gain, rounding, quiet, given, measured, *place, *none)
    error, lit = _model_error(image, frame.white, found)
    return image, found._replace(error=error, lit=lit)


def _model_error(image: Any, white: int, found: Found) -> tuple[Floats, Flags]:
    """(peak,) variance of the error of a Gaussian as the profile, grey levels²; whether it is light."""
    from roemetry_peaks.fisher_scoring import FAILED
    from roemetry_peaks.scattering import model_error

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
    share, lit = model_error(
        image,
        float(white),
        at.row,
        x_px,
        amplitude,
        sigma_px,
        beside.height + beside.slope * (x_px - at.x_px),
        beside.slope,
        beside.down,
        beside.up,
    )
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
        if tiles == FINE_TILES and not noise.differs:
            break
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
    from roemetry_peaks.speckle_noise import residual_products

    peaks = found.starts.row.shape[0]
    opaque = np.flatnonzero(found.error == 0.0)
    if opaque.size < _OPAQUE_MIN:
        opaque = np.arange(peaks)
    pick = opaque[_spread(opaque.size, size)]
    row = found.starts.row[pick]
    contrast2 = noise.contrast2_at(image.shape, row, found.starts.x_px[pick])
    alone = StripeNoise(noise.variance, noise.gain, 0.0, noise.contrast2)
    fit = fitted(image, white, found, alone, pick)
    slope = found.beside.slope[pick]
    height = found.beside.height[pick] + slope * (fit.x_px - found.starts.x_px[pick])
    products = residual_products(
        image,
        float(white),
        row,
        fit.x_px,
        fit.amplitude,
        fit.sigma_px,
        height,
        slope,
        noise.variance + found.error[pick],
        noise.gain,
        contrast2,
        fit.state,
    )
    # What the model's error adds to each sum is known: the rest is noise.
    products[:, :, 0] -= products[:, :, 1] * found.error[pick][:, None]
    return products, tile_of(image.shape, row, fit.x_px, tiles), contrast2


def _spread(peaks: int, size: int) -> Integers:
    """Numbers of some of the peaks, spread over all; in equal steps they might be one stripe's."""
    if peaks <= size:
        return np.arange(peaks)
    within = (np.arange(size) * _GOLDEN) % 1.0
    return ((np.arange(size) + within) * (peaks / size)).astype(np.int64)


def fitted(image: Any, white: int, found: Found, noise: StripeNoise, pick: Integers) -> Fitted:
    """Fit the chosen peaks."""
    from roemetry_peaks.fisher_scoring import fit_peaks

    at, beside = found.starts, found.beside
    row, x_px = at.row[pick], at.x_px[pick]
    contrast2 = noise.contrast2_at(image.shape, row, x_px)
    fit = Fitted(
        x_px,
        at.amplitude[pick],
        beside.sigma_px[pick],
        np.full(pick.size, np.nan),
        np.zeros(pick.size),
        np.zeros(pick.size, np.uint8),
    )
    fit_peaks(
        image,
        float(white),
        row,
        *fit[:3],
        beside.height[pick],
        beside.slope[pick],
        noise.variance,
        found.error[pick],
        noise.gain,
        contrast2,
        noise.correlation,
        *fit[3:],
    )
    return fit


def _apart(row: Integers, x_px: Floats, sigma_px: Floats) -> Flags:
    """Say which peaks do not coincide with the one before, of peaks sorted by row, then x."""
    apart = np.ones(row.shape[0], np.bool_)
    if row.shape[0]:
        apart[1:] = (np.diff(row) > 0) | (np.diff(x_px) > 0.5 * np.minimum(sigma_px[1:], sigma_px[:-1]))
    return apart
