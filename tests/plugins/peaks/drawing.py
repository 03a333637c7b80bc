"""Images of stripes whose centres, light and noise are known, for the tests of this folder."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from roemetry.records import Peaks, Sensor
from roemetry.records.arrays import Floats

GAIN, READ = 0.0255, 1.0
"""Grey levels per electron; grey levels."""
SENSOR = Sensor(GAIN, READ)


def integrated(centre_px: Floats, sigma_px, amplitude, columns: int) -> Floats:
    """(row, column) light of a Gaussian stripe by its (row,) centres, summed over each pixel, grey levels."""
    off = np.arange(columns) - np.asarray(centre_px)[:, None]
    s = np.broadcast_to(sigma_px, np.shape(centre_px))[:, None] * np.sqrt(2.0)
    height = np.broadcast_to(amplitude, np.shape(centre_px))[:, None]
    return 0.5 * height * s * np.sqrt(np.pi) * (erf((off + 0.5) / s) - erf((off - 0.5) / s))


def speckled(light: Floats, contrast, rng: np.random.Generator, length_px: float = 0.8) -> Floats:
    """Light with speckle of a contrast, one for all or one for each pixel."""
    grains = gaussian_filter(rng.standard_normal(light.shape), length_px)
    return light * np.exp(contrast * grains / grains.std() - np.square(contrast) / 2.0)


def exposed(level: Floats, rng: np.random.Generator | None = None) -> np.ndarray:
    """Add shot and read noise where a generator is given, round, cut off at white."""
    if rng is not None:
        level = level + rng.standard_normal(level.shape) * np.sqrt(GAIN * level + READ**2)
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def errors_px(peaks: Peaks, x_px: Floats) -> Floats:
    """(peak,) way from the nearest of its row's (stripe, row) centres."""
    off = peaks.x_px - x_px[:, peaks.row]
    return np.take_along_axis(off, np.abs(off).argmin(axis=0)[None], axis=0)[0]


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
