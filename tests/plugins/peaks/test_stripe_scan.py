"""The scan of 128 rows at a time against one pixel after the other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry_kernels.compiling import kernel
from roemetry_kernels.image_levels import plain_layout
from roemetry_peaks.peak_scan import stripe_tops
from roemetry_peaks.searching import Area


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
