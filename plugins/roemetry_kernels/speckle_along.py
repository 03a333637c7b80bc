"""The contrast of speckle, from how much the flanks of stripes jump from row to row; compiled."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import float_kernel, inlined
from roemetry_kernels.stripe_footing import Stripes

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


@float_kernel
def contrast_along(s: Stripes, rows: int, noise: Floats) -> float:
    """Estimate the standard deviation of a stripe's light over its mean, apart from the sensor's noise.

    Where the rows are 3 apart, speckle moves the crossings of half height each time anew, while a stripe is
    smooth. So its third differences (which neither tilt nor even bend enters) tell the scatter; the median of
    their squares, against what the sensor's noise and a contrast of 1 would give, tells the contrast, however
    often the stripe breaks.

    Parameters
    ----------
    s
        Stripes, as `roemetry_kernels.stripe_footing.stripes_around` gave them.
    rows
        Of the image.
    noise
        As for `roemetry_kernels.influence.variance_of`; where the sensor is not known, one with a
        signal-to-noise ratio of 60 at each top is taken for it.

    Returns
    -------
    float
        0 where it is not told from none, or where there are too few rows that follow each other.
    """
    row, _, _, flags, middle, width, amplitude, background, _, _ = s
    count = row.shape[0]
    begins, filled = np.empty(rows + 1, np.int64), 0
    for i in range(count):
        while filled <= row[i]:
            begins[filled] = i
            filled += 1
    begins[filled:] = count
    step = max(1, count // _LOOKED_AT)
    excess, of_sensor = np.empty(count // step + 1), 0.0
    # Each crossing lies between two pixels, whose speckle is less than wholly alike.
    scatter = _VARIANCE_OF_MIDDLE * (2.0 + np.exp(-0.25 / (noise[3] * noise[3]))) / 3.0
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
            # As in `roemetry_kernels.influence.variance_of_middle`.
            pixel = (dark + gain * (background[at] + light)) / (1.5 * light * light) if known else _ASSUMED
            jump += binomial * middle[at]
            unit += binomial * binomial * of_speckle
            sensor += binomial * binomial * _VARIANCE_OF_MIDDLE * width[at] * width[at] * pixel
            if k == 3:
                excess[found] = jump * jump / (_MEDIAN_OF_SQUARE * unit) - sensor / unit
                of_sensor += sensor / unit
                found += 1
                break
            at = _followed(row, middle, begins, rows, at)
            binomial *= -(3.0 - k) / (k + 1.0)
    if found < _FEWEST:
        return 0.0
    squared = np.median(excess[:found])
    if squared <= _NOTHING * of_sensor / found:
        return 0.0
    return np.sqrt(squared / (1.0 + _STRONG * squared))


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
