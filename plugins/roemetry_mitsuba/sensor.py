"""From light to grey levels: vignetting, speckle, PSF, pixel gains, shot noise, full well, read noise, steps.

Speckle multiplies the laser's light. Its intensity is drawn as that of fully developed speckle averaged over
M = 1/C² independent patterns, which is gamma distributed with mean 1 and contrast C (Goodman 2007), from a
Gaussian field of the told grain by a table of quantiles. So it is skewed as real speckle is: bright grains
are brighter than dark ones are dark.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry_mitsuba.rig import Camera

Floats = NDArray[np.float64]

_FIXED_PATTERN_SEED = 915
"""Of the pixels' gains: they belong to the camera, so they are the same in every image of every set."""


@dataclass(frozen=True)
class Sensor:
    """What the camera does to light: see the scene's camera part; all levels in grey levels."""

    grey_per_electron: float
    read_noise_grey: float
    black_level_grey: float
    psf_sigma_px: float
    full_well_e: float
    bit_depth: int
    vignetting: float
    prnu: float
    speckle_contrast: float
    speckle_sigma_px: float


def expose(laser: Floats, other: Floats, camera: Camera, sensor: Sensor, seed: int) -> NDArray[Any]:
    """Take a picture of light in grey levels over black; uint8, or uint16 where there are more bits."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng([seed, 57])
    light = other + (laser * _speckle(rng, laser.shape, sensor) if laser.any() else 0.0)
    light = light * _falloff(camera, sensor.vignetting)
    if sensor.psf_sigma_px > 0.0:
        light = gaussian_filter(light, sensor.psf_sigma_px, mode="nearest")
    if sensor.prnu > 0.0:
        gains = np.random.default_rng(_FIXED_PATTERN_SEED).standard_normal(light.shape)
        light = light * (1.0 + sensor.prnu * gains)
    electrons = rng.poisson(np.maximum(light, 0.0) / sensor.grey_per_electron).astype(np.float64)
    electrons = np.minimum(electrons, sensor.full_well_e)
    grey = electrons * sensor.grey_per_electron + sensor.black_level_grey
    grey += sensor.read_noise_grey * rng.standard_normal(light.shape)
    white = 2**sensor.bit_depth - 1
    return np.clip(np.rint(grey), 0, white).astype(np.uint8 if sensor.bit_depth <= 8 else np.uint16)


def _falloff(camera: Camera, strength: float) -> Floats:
    """Relative brightness over the image."""
    x = (np.arange(camera.width_px) - camera.principal_px[0]) / camera.focal_px
    y = (np.arange(camera.height_px) - camera.principal_px[1]) / camera.focal_px
    fall: Floats = 1.0 / (1.0 + strength * np.add.outer(y * y, x * x)) ** 2
    return fall


def _speckle(rng: np.random.Generator, shape: tuple[int, ...], sensor: Sensor) -> Floats:
    """Draw a gamma field of mean 1 with the sensor's contrast and grain."""
    if sensor.speckle_contrast <= 0.0:
        return np.ones(shape)
    from scipy.ndimage import gaussian_filter
    from scipy.stats import gamma, norm

    field = rng.standard_normal(shape)
    if sensor.speckle_sigma_px > 0.0:
        field = gaussian_filter(field, sensor.speckle_sigma_px, mode="wrap")
        field /= field.std()
    count = 1.0 / sensor.speckle_contrast**2
    at = np.linspace(-5.5, 5.5, 1101)
    return np.asarray(np.interp(field, at, gamma.ppf(norm.cdf(at), count) / count))


def diffraction_grain_px(
    wavelength_nm: float, f_number: float, focal_mm: float, distance_mm: float, pixel_um: float
) -> float:
    """Deviation of the grain that diffraction at the aperture gives: λ N (1 + m) wide at half height."""
    magnification = focal_mm / max(distance_mm - focal_mm, 1.0)
    width_um = 1e-3 * wavelength_nm * f_number * (1.0 + magnification)
    return width_um / pixel_um / (2.0 * math.sqrt(2.0 * math.log(2.0)))
