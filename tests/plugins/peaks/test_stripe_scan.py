"""The scan of 128 rows at a time against one pixel after the other; noise and speckle of an image."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import image_noise, plain_layout
from roemetry_peaks.peak_scan import stripe_tops
from roemetry_peaks.peak_window import Stripes
from roemetry_peaks.searching import Area
from roemetry_peaks.speckle_contrast import contrasts_along


def in_words(row, threshold):
    """(first, last) of each top, by the definition, with lists."""
    tops, begin = [], 0
    while True:
        low, rise = row[begin], None
        for x in range(begin, len(row)):
            low = min(low, row[x])
            if row[x] > low + threshold:
                rise = x
                break
        if rise is None:
            return tops
        fall = next((x for x in range(rise, len(row)) if row[x] < max(row[rise : x + 1]) - threshold), None)
        if fall is None:
            return tops
        first = row.index(max(row[rise:fall]), rise)
        last = first
        while row[last + 1] == row[first]:
            last += 1
        tops.append((first, last))
        begin = fall


@kernel
def one_by_one(image, threshold, row, first, last):
    """The same, one pixel after the other, fast enough for many rows; gives the number of peaks."""
    count = 0
    for y in range(image.shape[0]):
        f = image[y]
        low = np.int64(f[0])
        rising = False
        high = low
        begin = end = 0
        for x in range(1, f.shape[0]):
            level = np.int64(f[x])
            if not rising:
                low = min(low, level)
                if level > low + threshold:
                    rising = True
                    high = level
                    begin = end = x
            elif level > high:
                high = level
                begin = end = x
            elif level == high and end == x - 1:
                end = x
            elif level < high - threshold:
                row[count], first[count], last[count] = y, begin, end
                count += 1
                rising = False
                low = level
    return count


def reference(image, threshold):
    room = image.size // 2 + 1
    out = [np.empty(room, np.int32) for _ in range(3)]
    count = one_by_one(image, threshold, *out)
    return [values[:count] for values in out]


def scanned(image, threshold, area=None):
    rows, columns = image.shape
    return stripe_tops(plain_layout(image), threshold, area or Area(0, rows, 0, columns))


def same(found, wanted):
    """Say whether tops are the same."""
    return all(np.array_equal(one, other) for one, other in zip(found, wanted, strict=True))


def rows_of_every_kind(rng, count, columns, kind=np.uint8):
    """Noise, few levels (plateaux), walks, stripes: a quarter each."""
    quarter = count // 4
    noise = rng.integers(0, 256, (quarter, columns), dtype=np.uint8)
    steps = rng.choice(np.array([0, 60, 100, 101, 200, 255], np.uint8), (quarter, columns))
    walk = np.cumsum(rng.integers(-40, 41, (quarter, columns), dtype=np.int8), axis=1, dtype=np.int16)
    walks = np.clip(walk + 120, 0, 255).astype(np.uint8)
    x = np.arange(columns, dtype=np.float32)
    centre = rng.uniform(0, columns, (quarter, 1)).astype(np.float32)
    height = rng.uniform(60, 400, (quarter, 1)).astype(np.float32)
    stripes = height * np.exp(-0.5 * ((x - centre) / np.float32(2.5)) ** 2) + noise // 16
    return np.concatenate([noise, steps, walks, np.minimum(stripes, 255).astype(np.uint8)]).astype(kind)


@pytest.mark.parametrize("threshold", [12, 100])
def test_many_random_rows_agree_with_the_scan_of_one_pixel_after_the_other(threshold, rng):
    for columns in (24, 31):
        image = rows_of_every_kind(rng, 60_000, columns)
        assert same(scanned(image, threshold), reference(image, threshold))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("threshold", [12, 40])
def test_dark_parts_between_lines_are_left_out_without_a_difference(threshold, kind, rng):
    """A few lines on ground that grows darker and brighter along the rows, by more and less than counts."""
    columns = np.arange(488)
    image = 60.0 + 40.0 * np.sin(columns / 90.0) + rng.normal(0.0, 2.0, (700, columns.size))
    for lit in rng.integers(0, 700 - 150, 6):
        at = rng.uniform(0, columns.size) + 0.2 * np.arange(150)
        image[lit : lit + 150] += 90.0 * np.exp(-0.5 * ((columns - at[:, None]) / 1.6) ** 2)
    image = np.clip(np.rint(image), 0, 255).astype(kind)
    for area in (None, Area(3, 650, 8, 480), Area(0, 700, 1, 487)):
        found = scanned(image, threshold, area)
        top, bottom, left, right = area or (0, 700, 0, columns.size)
        row, first, last = reference(plain_layout(image[top:bottom, left:right]), threshold)
        assert len(row) > 300
        assert same(found, (row + top, first + left, last + left))


@settings(deadline=None, max_examples=150)
@given(
    st.lists(st.sampled_from([0, 1, 20, 99, 100, 101, 120, 121, 200, 254, 255]), min_size=1, max_size=45),
    st.sampled_from([0, 1, 20, 100, 154, 254]),
    st.sampled_from([np.uint8, np.uint16]),
)
def test_any_row_agrees_with_the_search_in_words(row, threshold, kind):
    image = np.array([row], kind)
    tops = scanned(image, threshold)
    assert list(zip(tops.first.tolist(), tops.last.tolist(), strict=True)) == in_words(row, threshold)
    assert same(tops, reference(image, threshold))


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 300), st.integers(1, 200), st.data())
def test_any_shape_and_any_part_of_it(rows, columns, data):
    kind = data.draw(st.sampled_from([np.uint8, np.uint16]))
    top, bottom = sorted(data.draw(st.lists(st.integers(0, rows), min_size=2, max_size=2, unique=True)))
    left, right = sorted(data.draw(st.lists(st.integers(0, columns), min_size=2, max_size=2, unique=True)))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    image = rng.integers(0, np.iinfo(kind).max + 1, (rows, columns)).astype(kind)
    found = scanned(image, 30, Area(top, bottom, left, right))
    row, first, last = reference(plain_layout(image[top:bottom, left:right]), 30)
    assert same(found, (row + top, first + left, last + left))


def test_more_peaks_than_room_was_made_for():
    image = np.tile(np.array([0, 200], np.uint8), (300, 150))
    assert len(scanned(image, 30).row) == 300 * 149


def test_pixels_that_begin_at_an_odd_place_in_memory(rng):
    memory = rng.integers(0, 256, 64 * 200 + 1, dtype=np.uint8)
    odd = memory[1:].reshape(200, 64)
    assert same(scanned(odd, 30), reference(odd.copy(), 30))


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
