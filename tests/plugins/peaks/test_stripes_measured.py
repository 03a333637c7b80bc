"""Stripes measured side by side against each of them alone; their width and background."""

import numpy as np
import pytest

from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.image_levels import plain_layout
from roemetry_peaks.gaussian import gaussian_centres
from roemetry_peaks.log_parabola import log_parabola_centres, logarithms
from roemetry_peaks.peak_scan import stripe_tops
from roemetry_peaks.peak_window import Stripes, stripes_around
from roemetry_peaks.searching import Area

SENSOR = 1.08, 0.0255  # variance of a black pixel, grey levels per electron


def stripes_of(kind, rng):
    rows, columns = 150, 320
    x = np.arange(columns)
    level = np.full((rows, columns), 20.0)
    for at in np.arange(20.0, columns, 40.0):
        centre, sigma = at + rng.uniform(-2.0, 2.0, (rows, 1)), rng.uniform(1.0, 5.0, (rows, 1))
        level += rng.uniform(40.0, 500.0, (rows, 1)) * np.exp(-0.5 * ((x - centre) / sigma) ** 2)
    level += rng.normal(0.0, 1.0, level.shape)
    white = int(np.iinfo(kind).max)
    image = plain_layout(np.clip(np.rint(level * (white / 255)), 0, white).astype(kind))
    area = Area(0, rows, 0, columns)
    tops = stripe_tops(image, 25 * white // 255, area)
    limits = {"white": white, "width_min_px": 1.5, "width_max_px": 40.0}
    return image, stripes_around(image, tops, area, **limits), white


@pytest.mark.parametrize(
    ("kind", "contrast", "each"), [(np.uint8, 0.0, False), (np.uint16, 0.15, False), (np.uint8, 0.15, True)]
)
@pytest.mark.parametrize(
    ("centres", "settings"),
    [(gaussian_centres, ()), (log_parabola_centres, (3,)), (log_parabola_centres, (5,))],
)
def test_a_stripe_is_measured_the_same_whatever_stands_beside_it(
    centres, settings, kind, contrast, each, rng
):
    image, together, white = stripes_of(kind, rng)
    levels, columns, count = image.reshape(-1), image.shape[1], together.row.shape[0]
    assert count > 1000
    noise = np.array([*SENSOR, 0.8])
    # As one number for all, and as one for each stripe.
    contrast2 = contrast**2 * rng.uniform(0.2, 2.0, count) if each else np.array([contrast**2])
    x_px, x_std_px = np.empty((2, count))
    centres(levels, columns, together, white, noise, contrast2, x_px, x_std_px, *settings)
    for i in range(0, count, 13):
        one = Stripes(*(values[i : i + 1] for values in together))
        alone = np.empty((2, 1))
        own = contrast2[i : i + 1] if each else contrast2
        centres(levels, columns, one, white, noise, own, *alone, *settings)
        np.testing.assert_allclose(alone[0, 0], x_px[i], atol=1e-9)  # px
        np.testing.assert_allclose(alone[1, 0], x_std_px[i], rtol=1e-9)


@float_kernel
def taken(v, count):
    logarithms(v, 0, count, count)


def test_logarithms_and_reciprocals(rng):
    count = 1000
    numbers = np.exp(rng.uniform(np.log(1e-3), np.log(7e4), count))
    numbers[:4] = 1.0, 0.001, 65535.0, np.sqrt(2.0)
    v = np.concatenate([numbers, np.zeros(count)])
    taken(v, count)
    np.testing.assert_allclose(v[:count], np.log(numbers), atol=1e-10)
    np.testing.assert_allclose(v[count:], 1.0 / numbers, rtol=1e-13)


def around(image, threshold=25, **limits):
    rows, columns = image.shape
    area = Area(0, rows, 0, columns)
    plain = plain_layout(image)
    limits = {"white": int(np.iinfo(image.dtype).max), "width_min_px": 0.0, "width_max_px": 1000.0} | limits
    return stripes_around(plain, stripe_tops(plain, threshold, area), area, **limits)


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
