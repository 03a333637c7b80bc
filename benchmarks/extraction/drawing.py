"""Images of stripes whose centres are known, the bound that physics sets, and peaks matched to the truth.

A stripe's profile across a row is a Gaussian, integrated over each pixel; speckle multiplies it by a
log-normal field of mean 1 that is smooth over `SPECKLE_PX`; then comes ambient light, shot noise, read noise,
the cut at white and the rounding to 8 bit. Single pixels may be hot.

The bound (Cramér-Rao) of one row's centre says how well any unbiased method can do. Four unknowns a row:
centre, height, width, background. Pixels at white carry nothing. Without speckle the pixels are independent,
and the shot noise's dependence on the light is information, too. With speckle their covariance is
C² m m′ exp(−Δ²/4ℓ²) besides the sensor's noise (ℓ: standard deviation of the filter that made the speckle).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from roemetry.records.arrays import Flags, Floats

GREY_PER_ELECTRON = 255.0 / 10_000.0
READ_NOISE_GREY = 1.0
SPECKLE_PX = 0.8
STRIPES = 11
SIZES = {"VGA": (480, 640), "3 Mpix": (1536, 2048), "12 Mpix": (3000, 4096)}
CONTRAST = {"clean": 0.0, "speckle": 0.15, "hard": 0.25}
HIT_PX = 2.0
_REACH = np.arange(-18, 19)
_SATURATED_ABOVE = 250.0
_AMPLITUDES, _SIGMAS_PX = (60.0, 300.0), (1.5, 3.0)
_ROUNDING, _WHITE_ABOVE = 1.0 / 12.0, 252.0  # variance, grey levels²; from here on a pixel carries nothing
_AT_ONCE = 4096


@dataclass(frozen=True)
class Light:
    """What lies over the stripes, grey levels and px; a contrast may be an image of its own."""

    contrast: float | Floats = 0.0
    ambient: tuple[float, float, float] = (8.0, 12.0, 8.0)  # at the corner, more to the right, more below
    hot_share: float = 0.0
    grey_per_electron: float = GREY_PER_ELECTRON
    read_noise: float = READ_NOISE_GREY

    def background(self, row: Floats, x_px: Floats, size: tuple[int, int]) -> Floats:
        """Give the ambient light at places."""
        corner, across, down = self.ambient
        return corner + across * x_px / size[1] + down * row / size[0]


@dataclass(frozen=True)
class Stripes:
    """Truth: (stripe, row) centre, width (σ), peak height, and whether there is light at all."""

    x_px: Floats
    sigma_px: Floats
    amplitude: Floats
    lit: Flags


@dataclass(frozen=True)
class Drawn:
    """An image with its truth; `background` and `contrast` are (stripe, row), as the truth is."""

    pixels: NDArray[np.uint8]
    stripes: Stripes
    light: Light
    background: Floats
    contrast: Floats

    @property
    def saturated(self) -> Flags:
        """(stripe, row) whether the top is cut off at white."""
        return self.stripes.amplitude + self.background > _SATURATED_ABOVE


def stripes_of(x_px: Floats, sigma: Floats | float, amplitude: Floats | float) -> Stripes:
    """Give stripes that are lit everywhere, of widths and heights that are broadcast along them."""
    ones = np.ones_like(x_px)
    return Stripes(x_px, sigma * ones, amplitude * ones, ones.astype(bool))


def standard_stripes(size: tuple[int, int]) -> Stripes:
    """Give eleven stripes that a body pushes aside: the fixed scene of the tables of speed."""
    height, width = size
    row, number = np.arange(height, dtype=np.float64), np.arange(STRIPES)[:, None]
    along = (row - height / 2) / (0.4 * height)
    body = np.where(np.abs(along) < 1.0, np.cos(0.5 * np.pi * along) ** 2, 0.0)
    push = 0.25 * width / 12.0 * body * np.cos(np.pi * (number - 5) / 12.0)
    x_px = width * (number + 1) / 12.0 + 0.02 * (row - height / 2) + push + 0.37 * number
    sigma = np.linspace(*_SIGMAS_PX, STRIPES)[[3, 8, 0, 5, 10, 1, 6, 9, 2, 7, 4]]
    top = np.linspace(*_AMPLITUDES, STRIPES)[[6, 2, 9, 0, 4, 10, 1, 7, 5, 3, 8]]
    wave = 0.9 + 0.1 * np.sin(2.0 * np.pi * (row / (0.3 * height) + 0.17 * number))
    return stripes_of(x_px, sigma[:, None], top[:, None] * wave)


def unseen_stripes(size: tuple[int, int], rng: np.random.Generator) -> Stripes:
    """Draw eleven stripes of random tilt, displacement, widths and heights, none within 10 σ of another."""
    height, width = size
    row, number = np.arange(height, dtype=np.float64), np.arange(STRIPES)[:, None]
    pitch = width / 12.0
    middle, half = rng.uniform(0.3, 0.7) * height, rng.uniform(0.2, 0.45) * height
    along = (row - middle) / half
    body = np.where(np.abs(along) < 1.0, np.cos(0.5 * np.pi * along) ** 2, 0.0)
    bow = np.cos(np.pi * (number - rng.uniform(3.0, 7.0)) / 12.0)
    tilt = rng.uniform(-0.06, 0.06) * (row - height / 2)
    push = rng.uniform(-0.4, 0.4) * pitch * body * bow
    x_px = pitch * (number + 1) + rng.uniform(-3.0, 3.0, (STRIPES, 1)) + tilt + push
    sigma = rng.uniform(*_SIGMAS_PX, (STRIPES, 1))
    top = rng.uniform(*_AMPLITUDES, (STRIPES, 1))
    turns = row / (rng.uniform(0.2, 0.6) * height) + rng.uniform(0.0, 1.0, (STRIPES, 1))
    return stripes_of(x_px, sigma, top * (0.9 + 0.1 * np.sin(2.0 * np.pi * turns)))


def drawn_set(
    kind: str, size: tuple[int, int], rng: np.random.Generator, stripes: Stripes | None = None
) -> Drawn:
    """Draw an image of a set: ``clean``, ``speckle``, or ``hard`` (strong speckle, hot pixels, gaps)."""
    stripes = standard_stripes(size) if stripes is None else stripes
    stripes = _with_gaps(stripes, rng) if kind == "hard" else stripes
    light = Light(contrast=CONTRAST[kind], hot_share=100e-6 if kind == "hard" else 0.0)
    return draw(stripes, size, rng, light)


def _with_gaps(stripes: Stripes, rng: np.random.Generator) -> Stripes:
    """Take a twelfth of the rows away from every second stripe."""
    lit = stripes.lit.copy()
    rows = lit.shape[1]
    for number in range(0, lit.shape[0], 2):
        first = int(rng.integers(0, rows - rows // 12))
        lit[number, first : first + rows // 12] = False
    return replace(stripes, lit=lit)


def draw(stripes: Stripes, size: tuple[int, int], rng: np.random.Generator, light: Light) -> Drawn:
    """Draw an image."""
    height, width = size
    laser = laser_light(stripes, size)
    contrast = np.broadcast_to(np.asarray(light.contrast, np.float32), size)
    if contrast.any():
        field = gaussian_filter(rng.standard_normal(size, dtype=np.float32), SPECKLE_PX)
        field /= field.std()
        laser *= np.exp(contrast * field - 0.5 * contrast**2)
    row, column = np.arange(height, dtype=np.float32)[:, None], np.arange(width, dtype=np.float32)[None]
    mean = laser + np.asarray(light.background(row, column, size), np.float32)
    noise = np.sqrt(light.grey_per_electron * mean + light.read_noise**2)
    level = mean + noise * rng.standard_normal(size, dtype=np.float32)
    if hot := int(light.hot_share * height * width):
        level[rng.integers(0, height, hot), rng.integers(0, width, hot)] += rng.uniform(80.0, 200.0, hot)
    at_row = np.broadcast_to(np.arange(height, dtype=np.float64), stripes.x_px.shape)
    at_column = np.clip(np.rint(stripes.x_px), 0, width - 1).astype(int)
    pixels = np.clip(np.rint(level), 0, 255).astype(np.uint8)
    background = light.background(at_row, stripes.x_px, size)
    at_stripes = contrast[at_row.astype(int), at_column].astype(np.float64)
    return Drawn(pixels, stripes, light, background, at_stripes)


def laser_light(stripes: Stripes, size: tuple[int, int]) -> NDArray[np.float32]:
    """Give the laser's light without speckle and noise, grey levels."""
    light = np.zeros(size, np.float32)
    tops = stripes.amplitude * stripes.lit
    for x_px, sigma, top, lit in zip(stripes.x_px, stripes.sigma_px, tops, stripes.lit, strict=True):
        column = np.rint(x_px).astype(int)[:, None] + _REACH
        profile = top[:, None] * pixel_profile(column - x_px[:, None], sigma[:, None])
        row = np.broadcast_to(np.arange(size[0])[:, None], column.shape)
        inside = (column >= 0) & (column < size[1]) & lit[:, None]
        # A stripe's own pixels of one row are all different, so plain addition is safe.
        light[row[inside], column[inside]] += profile[inside].astype(np.float32)
    return light


def pixel_profile(offset: Floats, sigma: Floats) -> Floats:
    """Integrate a Gaussian of height 1 over pixels whose centres lie `offset` px from its own."""
    scale = np.sqrt(2.0) * sigma
    area = erf((offset + 0.5) / scale) - erf((offset - 0.5) / scale)
    return np.asarray(np.sqrt(0.5 * np.pi) * sigma * area)


def bound_px(drawn: Drawn) -> Floats:
    """Give the (stripe, row) bound as a standard deviation, px; infinite where nothing can be known."""
    truth = drawn.stripes
    each = (truth.x_px, truth.sigma_px, truth.amplitude, drawn.background, drawn.contrast)
    columns = [np.ravel(one) for one in each]
    bound = np.empty(truth.x_px.size)
    for first in range(0, bound.size, _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        bound[part] = _bound(*(column[part, None] for column in columns), drawn.light)
    return bound.reshape(truth.x_px.shape)


def _bound(
    x_px: Floats, sigma: Floats, height: Floats, background: Floats, contrast: Floats, light: Light
) -> Floats:
    offset = np.rint(x_px) + _REACH - x_px
    right, left = (offset + 0.5) / sigma, (offset - 0.5) / sigma
    at_right, at_left = np.exp(-0.5 * right**2), np.exp(-0.5 * left**2)
    profile = pixel_profile(offset, sigma)
    laser, wider = height * profile, height * (profile / sigma - (right * at_right - left * at_left))
    slopes = np.stack([height * (at_left - at_right), profile, wider, np.ones_like(profile)], axis=-1)
    gain = light.grey_per_electron
    variance = gain * (laser + background) + light.read_noise**2 + _ROUNDING
    white = laser + background > _WHITE_ABOVE
    if not contrast.any():
        weight = np.where(white, 0.0, 1.0 / variance + 0.5 * gain**2 / variance**2)
        information = np.einsum("npi,np,npj->nij", slopes, weight, slopes)
    else:
        near = np.exp(-((_REACH[:, None] - _REACH[None]) ** 2) / (4.0 * SPECKLE_PX**2))
        speckle = contrast * laser
        covariance = speckle[:, :, None] * speckle[:, None, :] * near
        covariance += np.eye(_REACH.size) * np.where(white, 1e9, variance)[:, None, :]
        information = np.swapaxes(slopes, 1, 2) @ np.linalg.solve(covariance, slopes)
    return np.asarray(np.sqrt(np.linalg.inv(information)[:, 0, 0]))


@dataclass(frozen=True)
class Found:
    """Positions that a method gave; `std_px` NaN where it states none."""

    row: Floats
    x_px: Floats
    std_px: Floats


@dataclass(frozen=True)
class Hits:
    """Errors and stated uncertainties at the (stripe, row) of the truth, NaN where missed; and the rest.

    A peak within 2 px of a lit stripe's centre is a hit; of several the nearest. All others are false. Rows
    inside a gap are neither missed nor found.
    """

    error_px: Floats
    std_px: Floats
    lit: int
    false: int

    @property
    def missed(self) -> int:
        """How many lit crossings have no peak."""
        return self.lit - int(np.isfinite(self.error_px).sum())


def hits(truth: Stripes, found: Found) -> Hits:
    """Match peaks to the truth; a method may give rows between whole ones."""
    rows = truth.x_px.shape[1]
    error, std = np.full((2, *truth.x_px.shape), np.nan)
    lit = int(truth.lit.sum())
    if not len(found.row):
        return Hits(error, std, lit, 0)
    row = np.clip(found.row, 0, rows - 1)
    below = np.minimum(np.floor(row).astype(int), max(rows - 2, 0))
    part, above = row - below, np.minimum(below + 1, rows - 1)
    off = found.x_px - (truth.x_px[:, below] * (1.0 - part) + truth.x_px[:, above] * part)
    stripe = np.abs(off).argmin(axis=0)
    off = off[stripe, np.arange(off.shape[1])]
    nearest_row = np.rint(row).astype(int)
    hit = np.flatnonzero((np.abs(off) <= HIT_PX) & truth.lit[stripe, nearest_row])
    hit = hit[np.argsort(-np.abs(off[hit]), kind="stable")]  # the nearest is written last, and stays
    error[stripe[hit], nearest_row[hit]] = off[hit]
    std[stripe[hit], nearest_row[hit]] = found.std_px[hit]
    return Hits(error, std, lit, len(found.row) - int(np.isfinite(error).sum()))


def rms(values: Floats) -> float:
    """Give the root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
