"""The Cramér-Rao lower bound of one row's centre: how well any unbiased method can do.

Four unknowns a row: centre, height, width, background. Pixels at white carry nothing. Without speckle the
pixels are independent, and the shot noise's dependence on the light is information, too. With speckle their
covariance is C² m m′ exp(−Δ²/4ℓ²) besides the sensor's noise (ℓ: the standard deviation of the filter that
made the speckle).
"""

from __future__ import annotations

import numpy as np

from benchmarks.extraction.drawing import HALF_WINDOW, SPECKLE_PX, Drawn, pixel_profile
from roemetry.records.arrays import Floats

_ROUNDING = 1.0 / 12.0
_WHITE_ABOVE = 252.0
_NOTHING_KNOWN = 1e9
_AT_ONCE = 4096


def bound_px(drawn: Drawn) -> Floats:
    """Give the (stripe, row) bound as a standard deviation, px; infinite where nothing can be known."""
    truth = drawn.stripes
    columns = [
        np.ravel(each)
        for each in (truth.x_px, truth.sigma_px, truth.amplitude, drawn.background, drawn.contrast)
    ]
    bound = np.empty(truth.x_px.size)
    for first in range(0, bound.size, _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        bound[part] = _bound(*(column[part, None] for column in columns), drawn)
    return bound.reshape(truth.x_px.shape)


def _bound(
    x_px: Floats, sigma: Floats, height: Floats, background: Floats, contrast: Floats, drawn: Drawn
) -> Floats:
    reach = np.arange(-HALF_WINDOW, HALF_WINDOW + 1)
    offset = np.rint(x_px) + reach - x_px
    right, left = (offset + 0.5) / sigma, (offset - 0.5) / sigma
    at_right, at_left = np.exp(-0.5 * right**2), np.exp(-0.5 * left**2)
    profile = pixel_profile(offset, sigma)
    laser = height * profile
    slopes = np.stack(
        [
            height * (at_left - at_right),
            profile,
            height * (profile / sigma - (right * at_right - left * at_left)),
            np.ones_like(profile),
        ],
        axis=-1,
    )
    gain = drawn.light.grey_per_electron
    variance = gain * (laser + background) + drawn.light.read_noise**2 + _ROUNDING
    white = laser + background > _WHITE_ABOVE
    if not contrast.any():
        weight = np.where(white, 0.0, 1.0 / variance + 0.5 * gain**2 / variance**2)
        information = np.einsum("npi,np,npj->nij", slopes, weight, slopes)
    else:
        near = np.exp(-((reach[:, None] - reach[None]) ** 2) / (4.0 * SPECKLE_PX**2))
        speckle = contrast * laser
        covariance = speckle[:, :, None] * speckle[:, None, :] * near
        covariance += np.eye(reach.size) * np.where(white, _NOTHING_KNOWN, variance)[:, None, :]
        information = np.swapaxes(slopes, 1, 2) @ np.linalg.solve(covariance, slopes)
    return np.asarray(np.sqrt(np.linalg.inv(information)[:, 0, 0]))
