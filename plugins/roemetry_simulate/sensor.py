"""From light to grey levels: optics blur, speckle, shot noise, full well, read noise, clipping, 8–16 bit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """What the camera does to the light.

    Attributes
    ----------
    grey_per_electron : float
        Gain; shot noise has the variance `grey_per_electron` × grey level.
    read_noise_grey : float
        Standard deviation of the noise that is there without light.
    black_level_grey : float
        Grey level without light.
    psf_sigma_px : float
        Gaussian blur of the lens on the sensor.
    speckle_contrast : float
        Standard deviation over mean of the laser light's speckle as the camera sees it.
    speckle_sigma_px : float
        Gaussian filter that sets the grain of the speckle.
    full_well_e : float
        Electrons a pixel holds; what comes beyond is lost.
    bit_depth : int
        8 to 16: the highest grey level is 2**bit_depth − 1.
    """

    grey_per_electron: float = 0.0255
    read_noise_grey: float = 1.0
    black_level_grey: float = 4.0
    psf_sigma_px: float = 0.5
    speckle_contrast: float = 0.10
    speckle_sigma_px: float = 0.7
    full_well_e: float = math.inf
    bit_depth: int = 8


def expose(
    laser: Floats, steady: Floats, sensor: Sensor, seed: int, lens: Callable[[Floats], Floats] | None = None
) -> NDArray[Any]:
    """Take a picture.

    Parameters
    ----------
    laser, steady : ndarray, shape (height, width)
        Light from the laser and from everything else, grey levels without noise.
    sensor : Sensor
        The camera's sensor.
    seed : int
        The same seed gives the same bytes.
    lens : callable or None
        Blurs the image before the sensor's own blur.

    Returns
    -------
    ndarray of uint8, shape (height, width)
        The image; of uint16 where the sensor gives more than 8 bits.
    """
    rng = np.random.default_rng([seed, 29])
    grain = _speckle(rng, laser.shape, sensor) if sensor.speckle_contrast > 0.0 else np.ones(laser.shape)
    light = laser * grain + steady
    light = blurred(light if lens is None else lens(light), sensor.psf_sigma_px)
    electrons = rng.poisson(np.maximum(light, 0.0) / sensor.grey_per_electron)
    if math.isfinite(sensor.full_well_e):
        electrons = np.minimum(electrons, int(sensor.full_well_e))
    grey = electrons * sensor.grey_per_electron + sensor.black_level_grey
    grey += sensor.read_noise_grey * rng.standard_normal(laser.shape)
    white = 2**sensor.bit_depth - 1
    return np.clip(np.floor(grey + 0.5), 0, white).astype(np.uint8 if sensor.bit_depth <= 8 else np.uint16)


def blurred(light: Floats, sigma_px: float) -> Floats:
    """Blur an image by a Gaussian of `sigma_px` pixels; 0 leaves it as it is."""
    if sigma_px <= 0.0:
        return light
    from scipy.ndimage import gaussian_filter

    soft: Floats = gaussian_filter(light, sigma_px, mode="nearest")
    return soft


def _speckle(rng: np.random.Generator, shape: tuple[int, ...], sensor: Sensor) -> Floats:
    """Return a positive field of mean 1 (log-normal) with the sensor's speckle contrast."""
    noise = rng.standard_normal(shape)
    if sensor.speckle_sigma_px > 0.0:
        noise = blurred(noise, sensor.speckle_sigma_px)
        noise /= noise.std()
    spread = np.sqrt(np.log1p(sensor.speckle_contrast**2))
    grain: Floats = np.exp(spread * noise - 0.5 * spread**2)
    return grain
