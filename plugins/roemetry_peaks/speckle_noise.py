"""The noise of stripes, from what fits leave: read noise, shot noise, speckle's contrast by tile.

Model. Fits take up part of the noise: with P the matrix that takes pixels to residuals, residuals have the
covariance P V P', V that of the noise. V is linear in R, in g, in C² and in C² times the correlation of
pixels 1, 2, 3 apart (ρ, ρ⁴, ρ⁹); so are the expected products of residuals. Four sums of products per peak
(weighted for R, for g, for C², and of neighbours) against their expectation are solved for what is not
known: R and g for the image, ρ by the one whose C² explains both kinds of product best, C² for each tile,
drawn to the image's mean as far as tiles differ by no more than chance.

Assumed: Gaussian profiles (what is none leaves residuals; so R and g have upper limits), and speckle of one
length in the image. Fails where fewer than some tens of peaks are seen: nothing is then known of ρ.

Source: residuals' expectation as in analysis of variance by MINQUE, Rao (1971), J. Multivariate Anal.
1:257–275; the rest is ours.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from roemetry.errors import StageError
from roemetry.records import Frame
from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_peaks.fisher_scoring import FAILED, ROOM, WINDOW, Gaussians, PeakNoise
from roemetry_peaks.searching import Area

TILES = (4, 12)
"""Rows and columns of tiles that the image is cut into; each has a speckle contrast of its own."""
FINE_TILES = (16, 12)
"""The same where there is more than one material in the image."""
_DIFFERENT = 0.4  # standard deviation of the tiles' C² over their mean, from which on there is
_NEXT_TO_NONE = 0.03**2  # of C²: less is what chance makes of none
_PEAKS_MIN = 6  # a tile with fewer has the image's contrast
_SECOND_ORDER = 1.3  # a fit follows strong speckle further than its linear leverage tells; found by drawing
_CORRELATIONS = np.linspace(0.0, 0.9, 181)  # that are tried, in steps of 0.005
_LAGS = _CORRELATIONS[:, None] ** np.array([0.0, 1.0, 4.0, 9.0])  # ρ to the lag squared: a Gaussian
_ROWS = 8  # beyond which nothing is correlated along the stripe
_USUAL, _USUAL_STD = 0.5, 0.25  # the correlation of neighbouring pixels, where the image says little


@dataclass(frozen=True, eq=False, slots=True)
class StripeNoise:
    """The noise of a stripe's pixels: variance R + g μ + C² m², μ all light, m the stripe's."""

    variance: float
    """R: read noise and rounding, grey levels²."""
    gain: float
    """g: grey levels per electron."""
    correlation: float
    """Of the speckle of neighbouring pixels along a row, 0 to 0.9."""
    contrast2: Floats
    """(row, column) C² of the image's `TILES` or `FINE_TILES`."""

    def contrast2_at(self, image_size: tuple[int, int], row: Integers, x_px: Floats) -> Floats:
        """(peak,) C² of the tile that each peak lies in."""
        down, across = self.contrast2.shape
        tile: Floats = self.contrast2[
            np.clip(row * down // image_size[0], 0, down - 1),
            np.clip((x_px * across / image_size[1]).astype(np.int64), 0, across - 1),
        ]
        return tile

    def of_peaks(
        self, image_size: tuple[int, int], row: Integers, x_px: Floats, error: Floats, correlation: float
    ) -> PeakNoise:
        """Give the noise of peaks that lie there, with the variance of their model's error."""
        contrast2 = self.contrast2_at(image_size, row, x_px)
        return PeakNoise(self.variance, self.gain, correlation, contrast2, error)

    @property
    def differs(self) -> bool:
        """Whether there is more than one material in the image."""
        spread, mean = self.contrast2.std(), self.contrast2.mean()
        return bool(spread > _DIFFERENT * mean and self.contrast2.max() > _NEXT_TO_NONE)


def tile_of(
    image_size: tuple[int, int], row: Integers, x_px: Floats, tiles: tuple[int, int] = TILES
) -> Integers:
    """(peak,) number of the tile each peak lies in, row by row."""
    down, across = tiles
    column: Integers = np.clip((x_px * across / image_size[1]).astype(np.int64), 0, across - 1)
    numbers: Integers = np.clip(row * down // image_size[0], 0, down - 1) * across + column
    return numbers


def noise_from(
    products: Floats,
    tile: Integers,
    contrast2: Floats,
    *,
    variance: float | None,
    gain: float | None,
    rounding: float,
    most: tuple[float, float] = (np.inf, np.inf),
    tiles: tuple[int, int] = TILES,
) -> StripeNoise:
    """Solve for the noise that makes residuals what they are.

    Parameters
    ----------
    products
        (peak, 4, 7) from `roemetry_peaks.speckle_noise.residual_products`.
    tile
        (peak,) tile each peak lies in.
    contrast2
        (peak,) C² that the peaks were fitted with.
    variance, gain
        R, grey levels², and g, grey levels, where they are known; None: estimated.
    rounding
        Variance of rounding, grey levels²; R is no less.
    most
        What R and g can be at most, where they are estimated: what is no Gaussian leaves residuals, too.
    tiles
        Rows and columns of tiles that the numbers in `tile` are of.
    """
    said = products[:, 2, 2] > 0.0
    products, tile, contrast2 = products[said], tile[said], contrast2[said]
    if not tile.size:
        return StripeNoise(variance or rounding, gain or 0.0, _USUAL, np.zeros(tiles))
    correlation = _USUAL
    # twice where the sensor is estimated, since its share depends on the correlation
    for _ in range(2 if variance is None or gain is None else 1):
        if variance is None or gain is None:
            read, shot = _sensor(products.sum(0), _lags(correlation), variance, gain, most)
            read = max(read, rounding)
        else:
            read, shot = variance, gain
        # What R and g leave: products of a pixel with itself and with the next one, by cause.
        own = products[:, 2, 0] - products[:, 2, 1] * read - products[:, 2, 2] * shot
        next_ = products[:, 3, 0] - products[:, 3, 1] * read - products[:, 3, 2] * shot
        # Products go with 1/C⁴; where there is no speckle they say nothing of its correlation.
        share = (contrast2 / max(contrast2.max(), 1e-12))[:, None] ** 2
        correlation = _correlation(
            np.column_stack([next_, own]) * share, products[:, 2, 3:] * share, products[:, 3, 3:] * share
        )
    by_tile = _by_tile(own, products[:, 2, 3:] @ _lags(correlation), tile, tiles[0] * tiles[1])
    by_tile = np.minimum(by_tile * (1.0 + _SECOND_ORDER * by_tile), 1.0)
    return StripeNoise(read, shot, correlation, by_tile.reshape(tiles))


def _lags(correlation: float) -> NDArray[np.float64]:
    """Correlation of pixels 0, 1, 2, 3 apart, of white noise smoothed by a Gaussian."""
    return np.asarray(correlation ** np.array([0.0, 1.0, 4.0, 9.0]))


def _sensor(
    sums: Floats, lags: Floats, variance: float | None, gain: float | None, most: tuple[float, float]
) -> tuple[float, float]:
    """R and g by moments: of R, g, C², those not known, the feasible ones that explain the three sums best.

    A cause may be none (0), and R and g at most `most`. All such choices are tried; sums are compared in
    shares of themselves, so that no unit decides.
    """
    matrix = np.column_stack([sums[:3, 1:3], sums[:3, 3:] @ lags])
    scale = np.maximum(np.abs(sums[:3, 0]), 1e-300)
    matrix, target = matrix / scale[:, None], sums[:3, 0] / scale
    choices = [
        (np.nan, 0.0, most[0]) if variance is None else (variance,),
        (np.nan, 0.0, most[1]) if gain is None else (gain,),
        (np.nan, 0.0),
    ]
    best, least = (0.0, 0.0), np.inf
    for chosen in product(*choices):
        solution = np.array(chosen)
        free = np.isnan(solution)
        if not np.isfinite(solution[~free]).all():
            continue
        solution[free] = 0.0
        if free.any():
            solution[free] = np.linalg.lstsq(matrix[:, free], target - matrix @ solution, rcond=None)[0]
        left = float(np.sum((target - matrix @ solution) ** 2))
        possible = (solution >= 0.0).all() and (
            solution[:2] <= np.maximum(most, solution[:2] * ~free[:2])
        ).all()
        if possible and left < least - 1e-12:
            best, least = (float(solution[0]), float(solution[1])), left
    return best


def _correlation(left: Floats, by_own: Floats, by_next: Floats) -> float:
    """Correlation of neighbours' speckle: the one whose C² explains both kinds of product.

    Of each peak `left` are the products with the next pixel and of pixels with themselves; `by_own` and
    `by_next` are what a unit of C² adds to them, by lag.
    """
    unit_own, unit_next = _LAGS @ by_own.sum(0), _LAGS @ by_next.sum(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast2 = left[:, 1].sum() / unit_own
        ratio = unit_next / unit_own
        # What is left of each peak's products, as factors of its ten numbers, and its scatter over peaks.
        factors = np.column_stack(
            [np.ones(ratio.size), -ratio, -contrast2[:, None] * _LAGS, (contrast2 * ratio)[:, None] * _LAGS]
        )
        numbers = np.column_stack([left, by_next, by_own])
        scatter = ((factors @ (numbers.T @ numbers)) * factors).sum(1)
        doubt = (factors @ numbers.sum(0)) ** 2 / scatter + ((_CORRELATIONS - _USUAL) / _USUAL_STD) ** 2
    doubt = np.where((contrast2 > 0.0) & (unit_own > 0.0) & np.isfinite(doubt), doubt, np.inf)
    return float(_CORRELATIONS[int(np.argmin(doubt))]) if np.isfinite(doubt).any() else _USUAL


def _by_tile(own: Floats, unit: Floats, tile: Integers, tiles: int) -> Floats:
    """C² of each tile, drawn to the image's as far as the tiles' differences are no more than chance."""
    mean = max(float(own.sum() / unit.sum()), 0.0) if unit.sum() > 0.0 else 0.0
    count = np.bincount(tile, minlength=tiles)
    units = np.bincount(tile, unit, tiles)
    enough = (count >= _PEAKS_MIN) & (units > 0.0)
    if enough.sum() < 2:
        return np.full(tiles, mean)
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast2 = np.where(enough, np.bincount(tile, own, tiles) / units, mean)
        left = own - contrast2[tile] * unit
        scatter = np.bincount(tile, left**2, tiles) / units**2 * count / (count - 1)
        # No less than squares of normal residuals scatter: few peaks may agree by chance.
        chance = np.maximum(scatter, 2.0 / units)[enough]
    found, weight = contrast2[enough], count[enough] / count[enough].sum()
    mean = float(weight @ found)
    # variance between the tiles, less what is chance
    true = max(float(weight @ (found - mean) ** 2 - weight @ chance), 0.0)
    # empirical Bayes: drawn to the mean by the share of chance
    shrunk: Floats = np.full(tiles, max(mean, 0.0))
    shrunk[enough] = np.maximum(mean + true / (true + chance) * (found - mean), 0.0)
    return shrunk


def rows_of(share: float, correlation: float) -> float:
    """Give the correlation along the stripe: speckle is as long along it as across, all else independent."""
    if share <= 0.0 or correlation <= 0.0:
        return 0.0
    # exp(−rows² / (4 length²)), of neighbouring rows the pixels' own correlation.
    target = share * sum(correlation ** (row * row) for row in range(1, _ROWS))
    return float(np.interp(target, *_sums_of_lengths()))


@cache
def _sums_of_lengths() -> tuple[Floats, Floats]:
    """Sums of the correlation over rows, and the lengths they belong to, rows."""
    lengths = np.linspace(0.1, 2.0, 200)
    return np.exp(-(np.arange(1, _ROWS) ** 2) / (4.0 * lengths[:, None] ** 2)).sum(1), lengths


CAUSES = 6
"""Read noise, shot noise, speckle within a pixel, and of pixels 1, 2 and 3 apart."""
_OUTLIER = 8.0  # times what a peak's other residuals are: it says nothing of the noise
_PIXELS_MIN = 6  # of a peak: three more than what its fit takes up

Pixels = NDArray[Any]
Bytes = NDArray[np.uint8]


@float_kernel
def residual_products(
    image: Pixels, white: float, peaks: Gaussians, noise: PeakNoise, state: Bytes
) -> Floats:
    """Sum products of each peak's residuals, and what each cause of noise is expected to add to them.

    Residuals are smaller than the noise, by the leverage of the fitted parameters. With P the matrix that
    takes pixels to residuals, the expected products are the elements of P V P', linear in what the noise's
    covariance V is made of: a unit of R, of g μ, of C² m², and of C² m m' between pixels 1, 2, 3 apart.

    Parameters
    ----------
    image, white, noise
        As `fit_peaks` takes them.
    peaks, state
        Fitted without correlation, on the light beside them at the fitted centre.

    Returns
    -------
    ndarray
        (peak, 4, 7): products that tell of R, of g, of C² (a pixel with itself) and of the correlation (with
        the next pixel): their sum, then what a unit of each cause adds. All 0 where a peak says nothing.
    """
    columns = image.shape[1]
    out = np.zeros((peaks.row.shape[0], 4, 1 + CAUSES))
    m, mu, w, r = np.zeros(ROOM + 1), np.empty(ROOM), np.zeros(ROOM + 1), np.zeros(ROOM + 1)
    jac, hat, pulled = np.zeros((ROOM + 1, 3)), np.empty((ROOM, 3)), np.empty((ROOM, 3))
    weight = np.zeros((4, ROOM))
    for p in range(peaks.row.shape[0]):
        if state[p] == FAILED:
            continue
        f = image[peaks.row[p]]
        x_px, amplitude, sigma = peaks.x_px[p], peaks.amplitude[p], peaks.sigma_px[p]
        half = min(WINDOW * sigma, 0.5 * (ROOM - 2))
        first = max(math.ceil(x_px - half), 0)
        n = min(math.floor(x_px + half), columns - 1) - first + 1
        squares, largest = 0.0, 0.0
        for i in range(n):
            d = first + i - x_px
            z = d / (sigma * sigma)
            e = math.exp(-0.5 * d * z)
            m[i] = amplitude * e
            mu[i] = max(peaks.height[p] + peaks.slope[p] * d + m[i], 0.0)
            r[i] = f[first + i] - peaks.height[p] - peaks.slope[p] * d - m[i]
            v = noise.variance + noise.error[p] + noise.gain * mu[i] + noise.contrast2[p] * m[i] * m[i]
            w[i] = 0.0 if f[first + i] >= white else 1.0 / v
            squares += w[i] * r[i] * r[i]
            largest = max(largest, w[i] * r[i] * r[i])
            # derivatives of the model by centre, height and ln σ
            jac[i, 0], jac[i, 1], jac[i, 2] = m[i] * z, e, m[i] * z * d
        # A hot pixel is unlike the others; where all are large, that is how these stripes are.
        others = max((squares - largest) / max(n - 3.0, 1.0), 1.0)
        good = n >= _PIXELS_MIN and largest <= _OUTLIER * _OUTLIER * others
        if not good or not _hat(jac, w, n, hat):
            continue
        w[n] = 0.0  # there is no pixel after the last
        for i in range(n):
            square = w[i] * w[i]
            weight[0, i], weight[1, i], weight[2, i] = square, square * mu[i], square * m[i] * m[i]
            weight[3, i] = w[i] * w[i + 1] * m[i] * m[i + 1]
            for kind in range(3):
                out[p, kind, 0] += weight[kind, i] * r[i] * r[i]
            out[p, 3, 0] += weight[3, i] * r[i] * r[i + 1]
        for kind in range(4):
            _expected(jac, hat, weight[kind], kind == 3, m, mu, n, pulled, out[p, kind])
    return out


@inlined
def _hat(jac: Floats, w: Floats, n: int, hat: Floats) -> bool:
    """(pixel, parameter) what a unit in a pixel adds to the fitted parameters: (J'WJ)⁻¹ J'W.

    Gives whether the pixels below white determine the parameters at all.
    """
    a00 = a01 = a02 = a11 = a12 = a22 = 0.0
    for i in range(n):
        j0, j1, j2 = jac[i, 0], jac[i, 1], jac[i, 2]
        a00 += w[i] * j0 * j0
        a01 += w[i] * j0 * j1
        a02 += w[i] * j0 * j2
        a11 += w[i] * j1 * j1
        a12 += w[i] * j1 * j2
        a22 += w[i] * j2 * j2
    # inverse of a symmetric 3 × 3 matrix by cofactors
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    det = a00 * c00 + a01 * c01 + a02 * c02
    if not det > 0.0:
        return False
    for i in range(n):
        j0, j1, j2, s = jac[i, 0], jac[i, 1], jac[i, 2], w[i] / det
        hat[i, 0] = s * (c00 * j0 + c01 * j1 + c02 * j2)
        hat[i, 1] = s * (c01 * j0 + c11 * j1 + c12 * j2)
        hat[i, 2] = s * (c02 * j0 + c12 * j1 + c22 * j2)
    return True


@inlined
def _expected(
    jac: Floats, hat: Floats, weight: Floats, next_: bool, m: Floats, mu: Floats, n: int, pulled: Floats,
    out: Floats,
) -> None:  # fmt: skip
    """Add Σ W · (P V P') for one kind of weights W, cause by cause, to `out[1:]`.

    That is the trace of V P'W P, of which only the elements near the diagonal count. P = 1 − J G', with the
    rows of G those of `hat`; so P'W P = W + F G' + G F', F = ½ G J'W J − W J. W is diagonal or, for products
    with the next pixel, stands half above and half below the diagonal.
    """
    o00 = o01 = o02 = o11 = o12 = o22 = 0.0
    for i in range(n):
        for j in range(3):
            if next_:
                beside = weight[i - 1] * jac[i - 1, j] if i > 0 else 0.0
                pulled[i, j] = 0.5 * (weight[i] * jac[i + 1, j] + beside)
            else:
                pulled[i, j] = weight[i] * jac[i, j]
        o00 += jac[i, 0] * pulled[i, 0]
        o01 += jac[i, 0] * pulled[i, 1]
        o02 += jac[i, 0] * pulled[i, 2]
        o11 += jac[i, 1] * pulled[i, 1]
        o12 += jac[i, 1] * pulled[i, 2]
        o22 += jac[i, 2] * pulled[i, 2]
    for i in range(n):
        g0, g1, g2 = 0.5 * hat[i, 0], 0.5 * hat[i, 1], 0.5 * hat[i, 2]
        pulled[i, 0] = o00 * g0 + o01 * g1 + o02 * g2 - pulled[i, 0]
        pulled[i, 1] = o01 * g0 + o11 * g1 + o12 * g2 - pulled[i, 1]
        pulled[i, 2] = o02 * g0 + o12 * g1 + o22 * g2 - pulled[i, 2]
    for i in range(n):
        f0, f1, f2 = pulled[i, 0], pulled[i, 1], pulled[i, 2]
        g0, g1, g2 = hat[i, 0], hat[i, 1], hat[i, 2]
        own = 2.0 * (f0 * g0 + f1 * g1 + f2 * g2) + (0.0 if next_ else weight[i])
        out[1] += own
        out[2] += own * mu[i]
        out[3] += own * m[i] * m[i]
        for lag in range(1, min(4, n - i)):
            k = i + lag
            both = f0 * hat[k, 0] + f1 * hat[k, 1] + f2 * hat[k, 2]
            both += g0 * pulled[k, 0] + g1 * pulled[k, 1] + g2 * pulled[k, 2]
            out[3 + lag] += 2.0 * m[i] * m[k] * both
        if next_ and i + 1 < n:
            out[4] += weight[i] * m[i] * m[i + 1]


_AGAIN = "measure again: python -m roemetry_peaks.measure_noise RECIPE --out FILE"


class NoiseFile(BaseModel):
    """What the file holds."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    roemetry_noise: int = Field(ge=1, le=1)
    image_size: tuple[int, int]
    region: tuple[int, int, int, int]
    turn_deg: int
    bit_depth: int
    frames: int = Field(ge=1)
    peaks: int = Field(ge=1)
    read_noise_grey: float = Field(ge=0.0)
    gain_grey_per_electron: float = Field(ge=0.0)
    speckle_correlation: float = Field(ge=0.0, le=0.95)
    speckle_contrast: tuple[tuple[float, ...], ...]


def noise_of_file(path: Path, frame: Frame, area: Area, rounding: float) -> StripeNoise:
    """Read the noise of a frame's part from a file; raise StageError where it is none, or another image's."""
    try:
        stamp = path.stat().st_mtime_ns
    except OSError as error:
        raise StageError(f"the noise file {path} cannot be read: {error.strerror}", hint=_AGAIN) from error
    held = _read(path, stamp)
    expected = {
        "image_size": frame.size,
        "region": tuple(area),
        "turn_deg": frame.turn_deg,
        "bit_depth": frame.bit_depth,
    }
    for name, wanted in expected.items():
        if getattr(held, name) != wanted:
            raise StageError(
                f"the noise file {path} was measured on images of {name} {getattr(held, name)}, "
                f"this one has {wanted}",
                hint=_AGAIN,
            )
    contrast = np.array(held.speckle_contrast)
    return StripeNoise(
        held.read_noise_grey**2 + rounding,
        held.gain_grey_per_electron,
        held.speckle_correlation,
        contrast**2,
    )


@lru_cache(maxsize=8)
def _read(path: Path, stamp: int) -> NoiseFile:
    """Read a file once for each state of it."""
    try:
        held = NoiseFile.model_validate(json.loads(path.read_text("utf-8")))
    except (ValueError, ValidationError) as error:
        raise StageError(f"{path} is no noise file: {str(error).splitlines()[0]}", hint=_AGAIN) from error
    if [len(line) for line in held.speckle_contrast] != [TILES[1]] * TILES[0]:
        raise StageError(f"{path}: speckle_contrast is not {TILES[0]} × {TILES[1]} tiles", hint=_AGAIN)
    return held
