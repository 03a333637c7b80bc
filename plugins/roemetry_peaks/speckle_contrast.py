"""The contrast of speckle, from how much stripes jump from row to row; and what it does to a centre.

Model. Fully developed speckle multiplies the light by noise of contrast C (standard deviation over mean),
correlated over a length ℓ of about 0.8 px. A crossing of half height moves by noise over slope; so the
middle of two crossings has the variance C² w² · 0.25 · 0.5/(2 ln 2)², w the width. Third differences of one
stripe's middles, 3 rows apart, are free of place, slant and bend: their median square, less the sensor's
share, over that of C = 1 is C². Where parts of the image differ by more than chance, each of 16 × 12 tiles
has its own.

A centre that follows pixel k by p_k then has the variance

    Σ p_k² (R + g y_k) + C² Σ_k Σ_l p_k m_k p_l m_l exp(−(k − l)² / 4ℓ²) + (pull of the background's slope)².

Assumed: surfaces smooth over 10 rows; speckle as long along the stripe as across. Fails, towards larger C,
on rough surfaces.

Source: Dorsch, Häusler, Herrmann (1994), Applied Optics 33:1306–1314, for speckle as the limit; the
estimate is ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.image_levels import median_of
from roemetry_peaks.peak_scan import Pixels
from roemetry_peaks.peak_window import Stripes

_APART = 3  # rows: usual speckle is not correlated over that many
_LOOKED_AT = 500  # places: the contrast is then good to 6 %
_FEWEST = 60  # places, below which nothing is said
_NEAR_PX = 3.0  # that a stripe moves at most over these rows
_MEDIAN_OF_SQUARE = 0.4549364
"""Of the square of a normal deviate of standard deviation 1."""
_VARIANCE_OF_MIDDLE = 0.25 * 0.5 / (2.0 * np.log(2.0)) ** 2
"""Of the middle between the crossings of half height, for a contrast of 1 and a full width of 1."""
_STRONG = 2.5
"""By how much the square comes out too large, in squares: strong speckle bends flanks and tops. Found by
drawing, contrasts of 0.05 to 0.35."""
_ASSUMED = 4.6e-4
"""Square of noise over light at half height by the sensor, where it is not known: 60 at the top."""
_NOTHING = 0.1  # of the sensor's share: less than that is not told from none
_PARTS = 4, 4  # of the image, rows and columns, that are asked whether their contrast differs
_DIFFERENT = 45.0  # sum of 16 squares of normal deviates, at most, where it does not
_TILES = 16, 12  # that have a contrast each where it differs
_LAST_DIGITS = 1e-6  # of a tile: what lies on a border is in one and the same, however it was rounded
_PLACES_MIN = 6  # a tile with fewer has the image's
_CLIP, _CLIPPED_MEAN = 4.0, 0.906  # a square counts as so many means at most; the mean of 20 such squares
_VARIANCE_OF_SQUARE = 1.23  # of such a square of a normal deviate


@float_kernel
def contrasts_along(s: Stripes, rows: int, columns: int, noise: Floats) -> Floats:
    """Estimate the variance of a stripe's light over its mean squared, apart from the sensor's noise.

    Where the rows are 3 apart, speckle moves the crossings of half height each time anew, while a stripe is
    smooth. So its third differences (which neither tilt nor even bend enters) tell the scatter; the median of
    their squares, against what the sensor's noise and a contrast of 1 would give, tells the contrast, however
    often the stripe breaks. A twentieth of the peaks or so is enough for that. Where they scatter differently
    in different parts of the image, all peaks are asked, tile by tile, since there is more than one material.

    Parameters
    ----------
    s
        Stripes, as `roemetry_peaks.peak_window.stripes_around` gave them.
    rows, columns
        Of the image.
    noise
        As for `roemetry_peaks.speckle_contrast.variance_of`; where the sensor is not known, one with a
        signal-to-noise ratio of 60 at each top is taken for it.

    Returns
    -------
    ndarray
        (1,) the square of the contrast, 0 where it is not told from none, or where there are too few rows
        that follow each other; (peak,) where it differs from place to place.
    """
    count = s.row.shape[0]
    begins = _begins(s.row, rows)
    step = max(1, count // _LOOKED_AT)
    square, of_sensor, at = _places(s, begins, rows, noise, step)
    found = square.shape[0]
    of_all = np.zeros(1)
    if found < _FEWEST:
        return of_all
    # what a contrast of 1 would give is 1; the sensor's share is taken off
    squared = median_of(square / _MEDIAN_OF_SQUARE - of_sensor)
    if squared > _NOTHING * of_sensor.sum() / found:
        of_all[0] = squared / (1.0 + _STRONG * squared)
    if not _differs(s, square, of_sensor, at, max(squared, 0.0), rows, columns):
        return of_all
    if step > 1:
        square, of_sensor, at = _places(s, begins, rows, noise, 1)
    by_tile = _by_tile(s, square, of_sensor, at, of_all[0], rows, columns)
    each, per_row, per_px = np.empty(count), _TILES[0] / rows, _TILES[1] / columns
    for i in range(count):
        each[i] = by_tile[_tile(s.row[i], s.middle[i], per_row, per_px, _TILES)]
    return each


@inlined
def _begins(row: NDArray[np.int64], rows: int) -> NDArray[np.int64]:
    """(rows + 1,) number of each row's first peak."""
    begins, filled = np.empty(rows + 1, np.int64), 0
    for i in range(row.shape[0]):
        while filled <= row[i]:
            begins[filled] = i
            filled += 1
    begins[filled:] = row.shape[0]
    return begins


@inlined
def _places(
    s: Stripes, begins: NDArray[np.int64], rows: int, noise: Floats, step: int
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Squares of third differences over what a contrast of 1 gives, the sensor's share of them, and where.

    That is the second of the four peaks.
    """
    row, _, _, flags, middle, width, amplitude, background, _, _ = s
    count = row.shape[0]
    square, of_sensor = np.empty(count // step + 1), np.empty(count // step + 1)
    second = np.empty(count // step + 1, np.int64)
    # Each crossing lies between two pixels, whose speckle is less than wholly alike.
    scatter = _VARIANCE_OF_MIDDLE * (2.0 + np.exp(-0.25 / (noise[2] * noise[2]))) / 3.0
    known, dark, gain = noise[0] + noise[1] > 0.0, noise[0], noise[1]
    found = 0
    for i in range(0, count, step):
        at, binomial = i, 1.0
        jump = unit = sensor = 0.0
        for k in range(4):
            if at < 0 or flags[at] != 0:
                break
            of_speckle = scatter * width[at] * width[at]
            light = 0.5 * amplitude[at]
            # As in `roemetry_peaks.speckle_contrast.variance_of_middle`.
            pixel = (dark + gain * (background[at] + light)) / (1.5 * light * light) if known else _ASSUMED
            jump += binomial * middle[at]
            unit += binomial * binomial * of_speckle
            sensor += binomial * binomial * _VARIANCE_OF_MIDDLE * width[at] * width[at] * pixel
            if k == 1:
                second[found] = at
            if k == 3:
                square[found], of_sensor[found] = jump * jump / unit, sensor / unit
                found += 1
                break
            at = _followed(row, middle, begins, rows, at)
            # coefficients of a third difference: 1, −3, 3, −1
            binomial *= -(3.0 - k) / (k + 1.0)
    return square[:found], of_sensor[:found], second[:found]


@inlined
def _followed(row: Floats, middle: Floats, begins: Floats, rows: int, at: int) -> int:
    """Give the peak that goes on with one, some rows further on; −1 where none is near."""
    r = row[at] + _APART
    if r >= rows or begins[r] == begins[r + 1]:
        return -1
    # Most often it is the one with the same number in its row.
    near = min(begins[r] + at - begins[row[at]], begins[r + 1] - 1)
    while near > begins[r] and middle[near] > middle[at]:
        near -= 1
    while near + 1 < begins[r + 1] and abs(middle[near + 1] - middle[at]) < abs(middle[near] - middle[at]):
        near += 1
    return near if abs(middle[near] - middle[at]) <= _NEAR_PX else -1


@inlined
def _tile(row: int, x_px: float, per_row: float, per_px: float, tiles: tuple[int, int]) -> int:
    """Number of the tile that a place lies in, from tiles per row and px; x may lie outside of the image."""
    down, across = tiles
    return min(int(row * per_row), down - 1) * across + min(
        max(int(x_px * per_px + _LAST_DIGITS), 0), across - 1
    )


@inlined
def _differs(
    s: Stripes,
    square: Floats,
    of_sensor: Floats,
    at: NDArray[np.int64],
    contrast2: float,
    rows: int,
    columns: int,
) -> bool:
    """Whether the squares of different parts of the image differ by more than by chance."""
    parts = _PARTS[0] * _PARTS[1]
    count, total = np.zeros(parts), np.zeros(parts)
    per_row, per_px = _PARTS[0] / rows, _PARTS[1] / columns
    for p in range(at.shape[0]):
        # the middle of the four rows
        part = _tile(s.row[at[p]] + _APART // 2, s.middle[at[p]], per_row, per_px, _PARTS)
        count[part] += 1.0
        total[part] += min(square[p] / (contrast2 + of_sensor[p]), _CLIP)
    mean = total.sum() / count.sum()
    apart = 0.0
    # squared deviations of the parts' sums, each over its number
    for part in range(parts):
        off = total[part] - mean * count[part]
        apart += off * off / max(count[part], 1.0)
    return apart > _DIFFERENT * _VARIANCE_OF_SQUARE * mean * mean


@inlined
def _by_tile(
    s: Stripes,
    square: Floats,
    of_sensor: Floats,
    at: NDArray[np.int64],
    of_all: float,
    rows: int,
    columns: int,
) -> Floats:
    """(tile,) square of the contrast, from the mean of the squares; what is far too large counts less."""
    tiles, per_row, per_px = _TILES[0] * _TILES[1], _TILES[0] / rows, _TILES[1] / columns
    begin, tile = np.zeros(tiles + 1, np.int64), np.empty(at.shape[0], np.int64)
    for p in range(at.shape[0]):
        tile[p] = _tile(s.row[at[p]] + _APART // 2, s.middle[at[p]], per_row, per_px, _TILES)
        begin[tile[p] + 1] += 1
    # sorted by tile, so that each has its median
    begin = np.cumsum(begin)
    filled, sorted_ = begin.copy(), np.empty(at.shape[0])
    sensor = np.zeros(tiles)
    for p in range(at.shape[0]):
        sorted_[filled[tile[p]]] = square[p]
        filled[tile[p]] += 1
        sensor[tile[p]] += of_sensor[p]
    found = np.full(tiles, of_all)
    for t in range(tiles):
        count = begin[t + 1] - begin[t]
        if count < _PLACES_MIN:
            continue
        # what lies far beyond the median is no speckle, and counts as the limit
        limit = _CLIP * median_of(sorted_[begin[t] : begin[t + 1]]) / _MEDIAN_OF_SQUARE
        total = 0.0
        for p in range(begin[t], begin[t + 1]):
            total += min(sorted_[p], limit)
        mean = total / (count * _CLIPPED_MEAN)
        squared = max(mean - sensor[t] / count, 0.0)
        found[t] = squared / (1.0 + _STRONG * squared)
    return found


PIXELS_MAX = 512
"""Room for the pixels of one stripe."""

LAGS = 4  # px, within which speckle is taken as correlated


@inlined
def variance_of(
    levels: Pixels,
    white: int,
    first: int,
    count: int,
    pull: Floats,
    light: Floats,
    background: float,
    slope_pull: float,
    unsure: float,
    noise: Floats,
    contrast2: float,
) -> float:
    """Variance of a centre from the pixels' noise, the speckle, and the slope of the background, px².

    Parameters
    ----------
    levels
        Grey levels, row after row.
    white
        Grey level from which on a pixel is saturated, and has no noise.
    first, count
        The pixels that pull: the place of the first, and how many there are.
    pull
        (count or more,) change of the centre with the grey level of a pixel, px per grey level.
    light
        (count or more,) grey levels of the stripe alone, for the speckle.
    background
        Grey level of the background.
    slope_pull
        Change of the centre with the background's slope, px per (grey level per px).
    unsure
        (variance of that slope) / (variance of a background pixel), 1/px².
    noise
        (3,) variance of a black pixel, grey levels²; grey levels per electron; NaN where they are not known;
        correlation length of the speckle, px.
    contrast2
        Square of the speckle's contrast.
    """
    dark, gain, length = noise[0], noise[1], noise[2]
    total = 0.0
    for k in range(count):
        if levels[first + k] < white:
            total += pull[k] * pull[k] * (dark + gain * levels[first + k])
    if contrast2 > 0.0:
        total += contrast2 * _speckled(levels, white, first, count, pull, light, length)
    return total + slope_pull * slope_pull * unsure * (dark + gain * background)


@inlined
def bell(far: float) -> float:
    """Give exp(−far) by the series of its eighth root: to 1e-4 up to 3.4 (2.6 standard deviations)."""
    x = -0.125 * far
    root = 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0))))
    root *= root
    root *= root
    return root * root


@inlined
def fading(far: float) -> float:
    """Give a curve like exp(−far), and darker away from 0: (1 − far/8)⁸."""
    near = 1.0 - 0.125 * far
    near *= near
    near *= near
    return near * near


@inlined
def _speckled(
    levels: Pixels, white: int, first: int, count: int, pull: Floats, light: Floats, length: float
) -> float:
    """Variance by speckle of contrast 1, px²; the parameters are those of `variance_of`."""
    total = 0.0
    for lag in range(LAGS + 1):
        together = 0.0
        for k in range(count - lag):
            if levels[first + k] < white and levels[first + k + lag] < white:
                together += pull[k] * light[k] * pull[k + lag] * light[k + lag]
        # each pair counts twice, a pixel with itself once
        alike = np.exp(-0.25 * (lag / length) ** 2) if lag > 0 else 0.5
        total += 2.0 * alike * together
    return total


@inlined
def variance_of_middle(
    width: float, amplitude: float, background: float, noise: Floats, contrast2: float
) -> float:
    """Variance of the middle between the half-height crossings of a Gaussian stripe, px².

    Each crossing is interpolated between two pixels of which the noise is (on the mean) two thirds of one's.

    Parameters
    ----------
    width
        Full width at half height, px.
    amplitude, background
        Of the stripe, grey levels.
    noise, contrast2
        As for `variance_of`.
    """
    steepness = 2.0 * np.log(2.0) * amplitude / width  # of a Gaussian at half height, grey levels per px
    light = 0.5 * amplitude
    pixel = (noise[0] + noise[1] * (background + light)) / 1.5 + contrast2 * light * light
    return 0.5 * pixel / (steepness * steepness)
