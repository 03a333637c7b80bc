"""The noise that is read from an image."""

import numpy as np
import pytest

from roemetry_kernels.image_levels import image_noise, plain_layout


def noise_in(image):
    rows, columns = image.shape
    return image_noise(plain_layout(image), 255, 0, rows, 0, columns)


@pytest.mark.parametrize("sigma", [1.5, 4.0, 12.0])
def test_white_noise_is_told_to_a_twentieth(sigma, rng):
    image = rng.normal(100.0, sigma, (480, 640)).round().astype(np.uint8)
    assert noise_in(image) == pytest.approx(np.hypot(sigma, 12**-0.5), rel=0.05)


def test_stripes_and_a_slope_do_not_count(rng):
    x = np.arange(640)
    stripes = 20.0 + 0.05 * x + 150.0 * np.exp(-0.5 * ((x % 53 - 26) / 2.0) ** 2)
    image = (stripes + rng.normal(0.0, 2.0, (480, 640))).round().clip(0, 255).astype(np.uint8)
    # half of all blocks hold a part of a stripe: what is left is a little too much
    assert noise_in(image) == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("pitch", [12, 16, 20])
def test_stripes_that_fill_the_image_do_not_count(pitch, rng):
    x = np.arange(640)
    stripes = 20.0 + 150.0 * np.exp(-0.5 * ((x % pitch - pitch / 2) / 2.0) ** 2)
    image = (stripes + rng.normal(0.0, 1.5, (480, 640))).round().clip(0, 255).astype(np.uint8)
    assert noise_in(image) == pytest.approx(1.5, rel=0.1)


def test_an_even_image_has_the_noise_of_rounding():
    assert noise_in(np.full((50, 64), 7, np.uint8)) == pytest.approx(12**-0.5)
    assert noise_in(np.zeros((3, 5), np.uint16)) == pytest.approx(12**-0.5)
