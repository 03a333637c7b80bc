"""Width and background of stripes: the same in 8 and 16 bit, and what is left out."""

import numpy as np
import pytest

from roemetry_kernels.image_levels import plain_layout
from roemetry_peaks.peak_scan import Area, stripe_tops
from roemetry_peaks.peak_window import stripes_around


def around(image, threshold=25, **limits):
    rows, columns = image.shape
    area = Area(0, rows, 0, columns)
    plain = plain_layout(image)
    limits = {"white": int(np.iinfo(image.dtype).max), "width_min_px": 0.0, "width_max_px": 1000.0} | limits
    return stripes_around(plain, stripe_tops(plain, threshold, area), area, **limits)


def stripes(rng, rows, columns, pitch, noise):
    x = np.arange(columns)
    level = np.full((rows, columns), 20.0)
    for at in np.arange(pitch / 2, columns, pitch):
        centre = at + rng.uniform(-2.0, 2.0, (rows, 1))
        height, sigma = rng.uniform(60.0, 260.0, (rows, 1)), rng.uniform(1.0, 4.0, (rows, 1))
        level += height * np.exp(-0.5 * ((x - centre) / sigma) ** 2)
    return np.clip(np.rint(level + rng.normal(0.0, noise, level.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("pitch", "noise"), [(40.0, 0.0), (57.3, 0.0), (31.0, 1.5)])
def test_the_same_grey_levels_in_8_and_16_bit_give_the_same_stripes(pitch, noise, rng):
    image = stripes(rng, 301, 320, pitch, noise)
    narrow, wide = around(image), around(image.astype(np.uint16), white=255)
    for name in narrow._fields:
        np.testing.assert_array_equal(getattr(narrow, name), getattr(wide, name), err_msg=name)


def test_a_wide_stripe_is_measured():
    x = np.arange(400)
    image = np.tile(20.0 + 150.0 * np.exp(-0.5 * ((x - 200.3) / 12.0) ** 2), (6, 1)).round().astype(np.uint8)
    found = around(image)
    np.testing.assert_allclose(found.middle, 200.3, atol=0.1)  # px
    np.testing.assert_allclose(found.width, 28.26, atol=0.6)  # px
    np.testing.assert_allclose(found.background, 20.0, atol=0.3)


def test_what_is_much_lower_than_the_stripes_is_left_out_if_wanted():
    x = np.arange(300)

    def at(place, height):
        return height * np.exp(-0.5 * ((x - place) / 2.0) ** 2)

    image = np.tile(20.0 + at(60, 200.0) + at(74, 14.0) + at(140, 18.0) + at(220, 14.0), (40, 1))
    image[30:] = 20.0 + at(60, 80.0) + at(74, 8.0)
    image = image.round().astype(np.uint8)
    # 8 % of 200 is 16: the third stripe stays, the ripple beside the first and what is too dim do not
    found = around(image, threshold=5, share_min=0.08)
    assert np.bincount(found.row, minlength=40).tolist() == [2] * 30 + [1] * 10
    np.testing.assert_allclose(np.unique(found.middle.round()), [60.0, 140.0])
    assert np.bincount(around(image, threshold=5).row).tolist() == [4] * 30 + [2] * 10
