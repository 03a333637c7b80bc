"""Stripes measured side by side against each of them alone, and against what is known."""

import numpy as np
import pytest

from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.image_levels import plain_layout
from roemetry_peaks.gaussian import gaussian_centres
from roemetry_peaks.log_parabola import log_parabola_centres, logarithms
from roemetry_peaks.peak_scan import Area, stripe_tops
from roemetry_peaks.peak_window import SEEN_PX, Stripes, _is_one, _spike_width, join_tops, stripes_around

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


@pytest.mark.parametrize(("contrast", "each"), [(0.0, False), (0.15, False), (0.15, True)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
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
    for i in range(0, count, 7):
        one = Stripes(*(values[i : i + 1] for values in together))
        alone = np.empty((2, 1))
        own = contrast2[i : i + 1] if each else contrast2
        centres(levels, columns, one, white, noise, own, *alone, *settings)
        np.testing.assert_allclose(alone[0, 0], x_px[i], atol=1e-9)  # px
        np.testing.assert_allclose(alone[1, 0], x_std_px[i], rtol=1e-9)


@float_kernel
def joined_one_by_one(levels, columns, width_min_px, row, first, last):
    count = 0
    for i in range(row.shape[0]):
        at = row[i] * columns
        if _spike_width(levels, at + first[i], at + last[i], at, at + columns) < width_min_px:
            continue
        p = count - 1
        if p >= 0 and row[p] == row[i] and first[i] - last[p] <= SEEN_PX:
            tops = at + first[p], at + last[p], at + first[i], at + last[i]
            if _is_one(levels, *tops, at, at + columns):
                last[p] = last[i]
                continue
        row[count], first[count], last[count] = row[i], first[i], last[i]
        count += 1
    return count


@pytest.mark.parametrize("rough", [2.0, 12.0, 40.0])
def test_tops_are_joined_as_if_every_one_were_looked_at_closely(rough, rng):
    rows, columns = 400, 300
    x = np.arange(columns)
    centre = np.arange(15.0, columns, 30.0)[:, None, None] + rng.uniform(-4.0, 4.0, (10, rows, 1))
    level = 20.0 + (150.0 * np.exp(-0.5 * ((x - centre) / rng.uniform(0.5, 6.0, (10, rows, 1))) ** 2)).sum(0)
    level += rough * rng.standard_normal((rows, columns)) * np.sqrt(level / 100.0)
    level[rng.random((rows, columns)) < 0.01] = 255.0
    image = plain_layout(np.clip(np.rint(level), 0, 255).astype(np.uint8))
    tops = stripe_tops(image, 25, Area(0, rows, 0, columns))
    quick, close = ([values.copy() for values in tops] for _ in range(2))
    count = join_tops(image.reshape(-1), columns, 0, columns, 1.5, *quick)
    assert count == joined_one_by_one(image.reshape(-1), columns, 1.5, *close) < tops.row.shape[0]
    for one, other in zip(quick, close, strict=True):
        np.testing.assert_array_equal(one[:count], other[:count])


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


def test_a_kernel_that_could_not_be_kept_on_disk_is_refused():
    def made(called):
        def calling(x):
            return called(x)

        return kernel(calling)

    with pytest.raises(TypeError, match="would never be found again on disk"):
        made(kernel(lambda x: x))
