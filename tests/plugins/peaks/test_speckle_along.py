"""The contrast that the scatter from row to row tells, against drawn scatter."""

import numpy as np
import pytest

from roemetry_peaks.peak_window import Stripes
from roemetry_peaks.speckle_contrast import contrasts_along

ROWS, WIDTH = 600, 5.0
PX_A_CONTRAST = WIDTH * np.sqrt(0.125) / (2.0 * np.log(2.0))
"""Scatter of the middle of two crossings at half height at a contrast of 1, from a Gaussian's slope."""
UNKNOWN = np.array([np.nan, np.nan, 0.8])
COLUMNS = 640


def stripes(middle, *, amplitude=100.0):
    """Make stripes from their (row, stripe) middles; rows where it is NaN have none."""
    row, number = np.nonzero(np.isfinite(middle))
    n = row.size
    ones = np.ones(n)
    places = np.zeros(n, np.int32)
    return Stripes(
        row, places, places, np.zeros(n, np.uint8), middle[row, number], WIDTH * ones, amplitude * ones,
        20.0 * ones, 0.0 * ones, 0.0 * ones,
    )  # fmt: skip


def lines(rng, contrast, *, rows=ROWS):
    """Draw a tilted, a bent and an upright line that scatter by a contrast."""
    y = np.arange(rows)
    there = np.stack([30.0 + 0.5 * y, 400.0 + 20.0 * np.sin(y / 60.0), 500.0 + 0.0 * y], axis=1)
    return there + contrast * PX_A_CONTRAST * rng.standard_normal(there.shape)


def contrast_along(there, rows, noise):
    """Give the contrast of an image that is found to have one only."""
    found = contrasts_along(there, rows, COLUMNS, noise)
    assert found.shape == (1,)
    return np.sqrt(found[0])


@pytest.mark.parametrize("contrast", [0.05, 0.15, 0.4])
def test_scatter_tells_the_contrast_also_beside_breaks_and_steps(contrast, rng):
    middle = lines(rng, contrast)
    assert contrast_along(stripes(middle), ROWS, UNKNOWN) == pytest.approx(contrast, rel=0.2)
    middle[rng.random(middle.shape) < 0.1] = np.nan
    middle[100:130, 0] += 12.0
    assert contrast_along(stripes(middle), ROWS, UNKNOWN) == pytest.approx(contrast, rel=0.25)


def test_the_sensors_noise_is_no_speckle(rng):
    dark, gain, light = 4.0, 0.05, 50.0
    pixel = (dark + gain * (20.0 + light)) / 1.5 / light**2
    noise = np.array([dark, gain, 0.8])
    assert contrast_along(stripes(lines(rng, np.sqrt(pixel))), ROWS, noise) < 0.3 * np.sqrt(pixel)
    both = contrast_along(stripes(lines(rng, np.sqrt(pixel + 0.15**2))), ROWS, noise)
    assert both == pytest.approx(0.15, rel=0.2)


def test_few_rows_say_nothing(rng):
    assert contrast_along(stripes(lines(rng, 0.3, rows=20)), 20, UNKNOWN) == 0.0
    assert contrast_along(stripes(np.full((5, 0), 0.0)), 5, UNKNOWN) == 0.0
    # nor do rows whose stripes lie far from each other
    assert contrast_along(stripes(rng.uniform(0.0, 600.0, (ROWS, 1))), ROWS, UNKNOWN) == 0.0


def test_two_materials_have_a_contrast_each(rng):
    """Twelve lines; in the middle third of the rows of six of them the contrast is three times as high."""
    y = np.arange(ROWS)[:, None]
    there = 25.0 + 50.0 * np.arange(12)[None] + 0.02 * y
    product = (np.abs(y - ROWS / 2) < ROWS / 6) & (np.abs(there - COLUMNS / 2) < 150.0)
    contrast = np.where(product, 0.24, 0.08)
    middle = there + contrast * PX_A_CONTRAST * rng.standard_normal(there.shape)
    s = stripes(middle)
    found = contrasts_along(s, ROWS, COLUMNS, UNKNOWN)
    assert found.shape == s.row.shape
    # Away from the materials' border by a tile and the rows that a difference takes.
    along, across = np.abs(s.row - ROWS / 2), np.abs(s.middle - COLUMNS / 2)
    inside, outside = (along < ROWS / 6 - 45) & (across < 110.0), (along > ROWS / 6 + 45) | (across > 200.0)
    assert np.sqrt(found[inside].mean()) == pytest.approx(0.24, rel=0.15)
    assert np.sqrt(found[outside].mean()) == pytest.approx(0.08, rel=0.2)


def test_speckle_on_the_product_only_is_found(rng):
    """Most of the lines do not scatter but for the sensor's noise, so the image as a whole says none."""
    dark, gain, light = 4.0, 0.05, 50.0
    noise = np.array([dark, gain, 0.8])
    pixel = (dark + gain * (20.0 + light)) / 1.5 / light**2
    y = np.arange(ROWS)[:, None]
    there = 25.0 + 50.0 * np.arange(12)[None] + 0.0 * y
    product = (np.abs(y - ROWS / 2) < ROWS / 5) & (np.abs(there - COLUMNS / 2) < 150.0)
    middle = there + np.sqrt(pixel + 0.2**2 * product) * PX_A_CONTRAST * rng.standard_normal(there.shape)
    s = stripes(middle)
    found = contrasts_along(s, ROWS, COLUMNS, noise)
    inside = (np.abs(s.row - ROWS / 2) < ROWS / 5 - 45) & (np.abs(s.middle - COLUMNS / 2) < 110.0)
    assert np.sqrt(found[inside].mean()) == pytest.approx(0.2, rel=0.15)
    assert np.median(found[np.abs(s.row - ROWS / 2) > ROWS / 5 + 45]) < 0.05**2
