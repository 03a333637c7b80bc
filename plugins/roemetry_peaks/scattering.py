"""Light that comes out of a translucent product beside the stripe: how far a profile is from a Gaussian.

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
noise change from row to row and average out along a stripe; light from inside a body does not. So the
excess is averaged over the rows within `_REACH_ROWS`, and counts as far as it is larger than its own scatter
allows.

Assumed: neighbouring rows see the same material; width at half height is hardly changed by the skirts. Fails
where stripes stand nearer together than about 7 σ (their skirts overlap), and where a stripe is so short that
its rows do not average: d is then taken from the same row's next stripes.

Source: subsurface scattering by a narrow beam, Farrell, Patterson, Wilson (1992), Medical Physics 19:879–888;
a variance for the error of a model after Kennedy, O'Hagan (2001), J. R. Statist. Soc. B 63:425–464. The rest
is ours.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_INNER, _OUTER = 2.0, 3.2
"""Where the skirts are looked at, standard deviations from the middle: inside, the peak's own light and
errors of the width outweigh them; outside ends the window of the fit."""
_REACH_ROWS = 6
"""Rows on either side that are averaged. Fewer leave speckle in the mean, more smear the edge of a body."""
_ROWS_MIN = 5
"""Rows below which an average is not told from speckle."""
_SCATTERS = 2.0
"""Standard errors that count as chance: an opaque surface keeps d = 0 in all but about 5 % of its rows."""
_START_ERROR = 0.015
"""Excess over the peak's height that counts as an error of the start's width and of pixels that integrate: on
drawn Gaussians of σ 1.5 to 5 px it stays below that; skirts of tissue are 0.02 to 0.1."""
_SHARE = 2.0
"""Model error over the measured excess. The excess is what stands above a line through the light farther out,
which the skirts have lifted already, and its mean hides texture: so the error is larger. Between 1.5 and 4
the precision on scattering bodies changes by less than 5 %; at 1 the stated uncertainty is a third too
small."""


@kernel
def model_error(
    image: NDArray[Any],
    white: float,
    row: Integers,
    x_px: Floats,
    amplitude: Floats,
    sigma_px: Floats,
    height: Floats,
    slope: Floats,
    down: Integers,
    up: Integers,
) -> tuple[Floats, Flags]:
    """Give d², the variance of the profile model's error over the square of the peak's height.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Grey levels.
    white
        Grey level from which on a pixel is saturated.
    row, x_px, amplitude, sigma_px
        (peak,) where fits start: image row; middle at half height, px; height, grey levels; width, px.
    height, slope
        (peak,) light beside the stripe at `x_px`, grey levels, and its growth, grey levels per px.
    down, up
        (peak,) the same stripe's peak in the next and in the last row; −1 for none.

    Returns
    -------
    tuple
        (peak,) d², and whether the error is light beside the peak, and not a lack of it: a profile with flat
        top and steep flanks is no Gaussian either.
    """
    peaks, columns = row.shape[0], image.shape[1]
    excess = np.zeros((peaks, 2))
    for p in range(peaks):
        for side in range(2):
            sign = 2 * side - 1
            total, pixels = 0.0, 0
            near, far = _INNER * sigma_px[p], _OUTER * sigma_px[p]
            other = p + sign
            if 0 <= other < peaks and row[other] == row[p]:
                far = min(far, abs(x_px[other] - x_px[p]) - _OUTER * sigma_px[other])
            first, last = x_px[p] + sign * near, x_px[p] + sign * far
            for x in range(math.ceil(min(first, last)), math.floor(max(first, last)) + 1):
                if far <= near or x < 0 or x >= columns or image[row[p], x] >= white:
                    continue
                u = x - x_px[p]
                gaussian = amplitude[p] * math.exp(-0.5 * (u / sigma_px[p]) ** 2)
                total += image[row[p], x] - height[p] - slope[p] * u - gaussian
                pixels += 1
            excess[p, side] = total / (pixels * amplitude[p]) if pixels else np.nan
        # Where the border cuts a stripe off, the middle and the width that it starts from are no measure.
        if x_px[p] < _OUTER * sigma_px[p] or x_px[p] > columns - 1 - _OUTER * sigma_px[p]:
            excess[p, 0] = excess[p, 1] = np.nan
    error2, lit = np.full(peaks, np.nan), np.zeros(peaks, np.bool_)
    for p in range(peaks):
        known, sum2, sum1 = 0, 0.0, 0.0
        for side in range(2):
            count, total, squares = 0, 0.0, 0.0
            for links, start in ((down, p), (up, up[p])):
                at = start
                for _ in range(_REACH_ROWS + 1):
                    if at < 0:
                        break
                    value = excess[at, side]
                    if not math.isnan(value):
                        count += 1
                        total += value
                        squares += value * value
                    at = links[at]
            if count < _ROWS_MIN:
                continue
            mean = total / count
            chance2 = _SCATTERS * _SCATTERS * max(squares / count - mean * mean, 0.0) / (count - 1)
            sum2 += max(mean * mean - chance2 - _START_ERROR * _START_ERROR, 0.0)
            sum1 += mean
            known += 1
        if known:
            error2[p] = sum2 / known
            lit[p] = sum2 > 0.0 and sum1 > 0.0
    # Where stripes crowd or are short, the same row's next stripes are most likely of the same material.
    filled = error2.copy()
    for p in range(peaks):
        if math.isnan(error2[p]):
            filled[p] = 0.0
            for other in (p - 1, p + 1):
                if 0 <= other < peaks and row[other] == row[p] and error2[other] > filled[p]:
                    filled[p], lit[p] = error2[other], lit[other]
        if x_px[p] < _OUTER * sigma_px[p] or x_px[p] > columns - 1 - _OUTER * sigma_px[p]:
            filled[p] = 0.0  # what the rows above and below say is not of the part that is seen
    return _SHARE * _SHARE * filled, lit
