"""The dominant peak, against rows worked by hand and against the paper's search written out with lists."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from roemetry.errors import DataError
from roemetry.records import EDGE, SATURATED, Frame
from roemetry_paper.dominant_peak import DominantPeak, DominantPeakOptions

STARTS = ("fixed", "lowest")


def frame_of(rows, dtype=np.uint8, bit_depth=None):
    """A frame whose inner rows are `rows`: the first and last image row are not searched."""
    rows = np.atleast_2d(np.asarray(rows, dtype))
    pixels = np.vstack([np.zeros_like(rows[:1]), rows, np.zeros_like(rows[:1])])
    return Frame(pixels, bit_depth=bit_depth or 8 * rows.dtype.itemsize)


def peaks_of(row, start="fixed", threshold=100.0):
    options = DominantPeakOptions(start=start, threshold=threshold)
    return DominantPeak(options).extract(frame_of(row)).x_px.astype(int).tolist()


def through(*points, columns=None):
    """A row that goes in straight lines through (x, grey level) points."""
    x, level = zip(*points, strict=True)
    return np.interp(np.arange((columns or x[-1]) + 1), x, level).round().astype(np.uint8)


def search(row, threshold, start_rule):
    """Section 3.2 as it stands in words: lists of maxima and minima, a start and an end that move on."""
    last = len(row) - 1
    inner = range(1, last)
    maxima = [x for x in inner if row[x + 1] - row[x] < 0 and row[x] - row[x - 1] >= 0]
    minima = [x for x in inner if row[x + 1] - row[x] >= 0 and row[x] - row[x - 1] < 0]
    if not maxima:
        return []
    found, start = [], 0
    for end in [x for x in minima if x > maxima[0]] + [last]:
        if start_rule == "lowest":
            # The lowest valley so far, but not one behind a higher peak that only waits for its end.
            between = [x for x in minima if start < x < end and row[x] < row[start]]
            for valley in between:
                if row[valley] < row[start]:
                    start = valley
        candidates = [x for x in maxima if start < x < end]
        if not candidates:
            continue
        peak = max(candidates, key=lambda x: row[x])
        if row[peak] - row[start] > threshold and row[peak] - row[end] > threshold:
            found.append(peak)
            start = end
    return found


def hysteresis(row, threshold):
    """A peak search with hysteresis, which ``start: lowest`` must equal."""
    found, low, top, peak = [], row[0], None, None
    last = len(row) - 1
    for x in range(1, last + 1):
        if top is None:
            if row[x] - low > threshold and x < last:
                top, peak = row[x], x
            low = min(low, row[x])
        elif row[x] > top or (row[x] == top and peak == x - 1):
            top, peak = row[x], x
        elif top - row[x] > threshold:
            found.append(peak)
            top, low = None, row[x]
    return found


# The paper's Figure 8 as we read it: nine maxima, eight minima, four stripes. P1, P3 and P5 stand before
# their stripe's peak, P7 and P9 behind it, and the row ends in a fall with no minimum after P9.
FIGURE_8 = {
    "origin": (0, 10), "P1": (4, 60), "V1": (6, 45), "P2": (10, 200), "V2": (16, 30),
    "P3": (20, 70), "V3": (22, 55), "P4": (27, 220), "V4": (33, 20),
    "P5": (37, 90), "V5": (39, 75), "P6": (43, 240), "V6": (46, 180), "P7": (48, 200), "V7": (55, 40),
    "P8": (60, 230), "V8": (63, 150), "P9": (65, 190), "end": (71, 20),
}  # fmt: skip


@pytest.mark.parametrize("start", STARTS)
def test_figure_8_has_the_dominant_peaks_p2_p4_p6_p8(start):
    row = through(*FIGURE_8.values())
    assert peaks_of(row, start) == [FIGURE_8[name][0] for name in ("P2", "P4", "P6", "P8")]


def test_the_last_pixel_of_a_plateau_is_the_peak():
    assert peaks_of([0, 0, 50, 255, 255, 255, 50, 0, 0]) == [5]


def test_of_separate_equal_maxima_the_leftmost_is_the_peak():
    assert peaks_of([0, 0, 200, 190, 200, 190, 0, 0]) == [2]


def test_bright_left_border_loses_the_stripe_by_the_paper_and_not_with_lowest():
    row = through((0, 180), (10, 20), (20, 20), (25, 240), (30, 20), (45, 20), (50, 240), (55, 20), (60, 20))
    assert peaks_of(row, "fixed") == []
    assert peaks_of(row, "lowest") == [25, 50]


def test_a_step_on_the_slope_raises_the_start_by_the_paper_and_not_with_lowest():
    # The first pixel of the step (at 100) is a minimum; the second stripe exceeds it by 60 only.
    row = [0, 0, 120, 240, 100, 100, 40, 0, 0, 0, 80, 160, 80, 0, 0]
    assert peaks_of(row, "fixed") == [3]
    assert peaks_of(row, "lowest") == [3, 11]


@pytest.mark.parametrize("start", STARTS)
def test_a_row_that_ends_without_a_minimum_ends_at_its_last_pixel(start):
    assert peaks_of([10, 10, 10, 150, 240, 200, 120, 60], start) == [4]
    # Not fallen far enough at the last pixel: no peak.
    assert peaks_of([10, 10, 10, 150, 240, 200, 180, 140], start) == []


@pytest.mark.parametrize("start", STARTS)
def test_a_threshold_that_is_just_met_is_not_exceeded(start):
    assert peaks_of([20, 20, 120, 20, 20], start) == []
    assert peaks_of([20, 20, 121, 20, 20], start) == [2]
    assert peaks_of([20, 20, 121, 21, 21], start) == []


@pytest.mark.parametrize("start", STARTS)
def test_first_and_last_row_and_column_are_not_searched(start):
    stripe = [0, 0, 200, 0, 0]
    pixels = np.array([stripe] * 4, np.uint8)
    peaks = DominantPeak(DominantPeakOptions(start=start)).extract(Frame(pixels))
    assert peaks.row.tolist() == [1, 2]
    assert peaks_of([200, 0, 0, 0, 200], start) == []


@pytest.mark.parametrize("start", STARTS)
def test_every_column_but_the_border_can_hold_a_peak(start):
    columns = 70  # more than two of the kernel's blocks
    for x in range(1, columns - 1):
        row = np.zeros(columns, np.uint8)
        row[x] = 200
        assert peaks_of(row, start) == [x]


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("level", [0, 77, 255])
def test_a_frame_of_one_grey_level_has_no_peaks(start, level):
    peaks = DominantPeak(DominantPeakOptions(start=start)).extract(Frame(np.full((9, 40), level, np.uint8)))
    assert len(peaks) == 0
    assert peaks.image_size == (9, 40)


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (2, 2), (3, 2), (3, 3)])
def test_frames_with_little_or_no_inside_are_no_error(shape):
    assert len(DominantPeak().extract(Frame(np.zeros(shape, np.uint8)))) == 0


def random_rows(count, columns, seed):
    """Rows of every kind that matters: noise, few levels (plateaux), walks, stripes on a dark ground."""
    rng = np.random.default_rng(seed)
    quarter = count // 4
    noise = rng.integers(0, 256, (quarter, columns))
    steps = rng.choice([0, 60, 100, 101, 200, 255], (quarter, columns))
    walks = np.clip(np.cumsum(rng.integers(-60, 61, (quarter, columns)), axis=1) + 120, 0, 255)
    x = np.arange(columns)
    centre = rng.uniform(0, columns, (quarter, 2, 1))
    stripes = (rng.uniform(60, 400, (quarter, 2, 1)) * np.exp(-0.5 * ((x - centre) / 2.5) ** 2)).sum(axis=1)
    stripes = np.clip(stripes + rng.normal(15, 6, (quarter, columns)), 0, 255)
    return np.concatenate([noise, steps, walks, stripes]).astype(np.uint8)


@pytest.mark.parametrize("start", STARTS)
def test_twenty_thousand_random_rows_agree_with_the_search_in_words(start):
    rows = random_rows(20_000, 50, seed=20)
    peaks = DominantPeak(DominantPeakOptions(start=start)).extract(frame_of(rows))
    for y, row in enumerate(rows.tolist(), start=1):
        found = peaks.x_px[peaks.row_start[y] : peaks.row_start[y + 1]].tolist()
        assert found == search(row, 100, start), row
        if start == "lowest":
            assert found == hysteresis(row, 100), row


@settings(deadline=None, max_examples=400)
@given(
    st.lists(st.sampled_from([0, 1, 20, 99, 100, 101, 120, 121, 200, 254, 255]), min_size=3, max_size=45),
    st.sampled_from([0, 1, 20, 100, 154]),
    st.sampled_from(STARTS),
)
def test_any_row_agrees_with_the_search_in_words(row, threshold, start):
    assert peaks_of(row, start, threshold) == search(row, threshold, start)


@pytest.mark.parametrize("start", STARTS)
def test_sixteen_bits_find_what_eight_bits_find(start):
    rows = random_rows(2_000, 60, seed=21)
    extractor = DominantPeak(DominantPeakOptions(start=start))
    eight = extractor.extract(frame_of(rows))
    sixteen = extractor.extract(frame_of(rows.astype(np.uint16) * 257, np.uint16))
    twelve = extractor.extract(frame_of(rows.astype(np.uint16) * 16, np.uint16, bit_depth=12))
    np.testing.assert_array_equal(eight.row, sixteen.row)
    np.testing.assert_array_equal(eight.x_px, sixteen.x_px)
    np.testing.assert_array_equal(eight.flags, sixteen.flags)
    np.testing.assert_allclose(sixteen.amplitude, 257 * eight.amplitude, atol=0)
    np.testing.assert_allclose(sixteen.width_px, eight.width_px, atol=1e-9)  # px
    # 100 levels of 8 bits are 1605.9 of 12: between 16 times 100 and 16 times 101.
    np.testing.assert_array_equal(eight.x_px, twelve.x_px)


@pytest.mark.parametrize("start", STARTS)
def test_brightness_offset_changes_the_background_only(start):
    rows = random_rows(2_000, 60, seed=22) // 2
    extractor = DominantPeak(DominantPeakOptions(start=start, threshold=50.0))
    dark, bright = extractor.extract(frame_of(rows)), extractor.extract(frame_of(rows + 100))
    np.testing.assert_array_equal(dark.x_px, bright.x_px)
    np.testing.assert_array_equal(dark.amplitude, bright.amplitude)
    np.testing.assert_allclose(dark.width_px, bright.width_px, atol=1e-9)  # px
    np.testing.assert_array_equal(dark.background + 100, bright.background)


def test_strided_pixels_give_the_same_peaks():
    rows = random_rows(400, 60, seed=23)
    wide = np.zeros((rows.shape[0], 120), np.uint8)
    wide[:, ::2] = rows
    straight, strided = DominantPeak().extract(Frame(rows)), DominantPeak().extract(Frame(wide[:, ::2]))
    np.testing.assert_array_equal(straight.x_px, strided.x_px)


def test_more_peaks_than_room_was_made_for():
    # 64 peaks a row have room at first; here every second pixel is one.
    row = np.tile([0, 200], 150)
    peaks = DominantPeak().extract(frame_of([row] * 5))
    assert len(peaks) == 5 * 149
    assert (np.diff(peaks.row_start)[1:-1] == 149).all()


def test_measures_of_a_triangle():
    # Rises by 20 from 20 to 220 and falls by 40 to 60: half of 160 above 60 is 140, met at 6.0 and 12.0.
    row = [20, *range(20, 221, 20), 180, 140, 100, 60, 60, 60]
    peaks = DominantPeak().extract(frame_of(row))
    assert peaks.x_px.tolist() == [11.0]
    assert peaks.background.tolist() == [60.0]
    assert peaks.amplitude.tolist() == [160.0]
    assert peaks.width_px[0] == pytest.approx(13.0 - 7.0, abs=1e-12)
    assert math.isnan(peaks.x_std_px[0])
    assert peaks.flags.tolist() == [0]


def test_width_of_a_gaussian_stripe_is_that_of_its_half_height():
    sigma_px, x = 3.0, np.arange(80)
    row = (20 + 200 * np.exp(-0.5 * ((x - 40) / sigma_px) ** 2)).round()
    peaks = DominantPeak().extract(frame_of(row))
    assert peaks.x_px.tolist() == [40.0]
    assert peaks.width_px[0] == pytest.approx(2 * math.sqrt(2 * math.log(2)) * sigma_px, abs=0.03)  # px


def test_saturated_and_edge_are_flagged():
    row = np.zeros(40, np.uint8)
    row[[2, 3, 20, 36, 37]] = [200, 0, 255, 0, 200]
    flags = DominantPeak().extract(frame_of(row)).flags.tolist()
    assert flags == [EDGE, SATURATED, EDGE]
    twelve = frame_of(row.astype(np.uint16) * 16, np.uint16, bit_depth=12)
    assert not (DominantPeak().extract(twelve).flags & SATURATED).any()  # 4080 of 4095


def test_colour_is_refused_with_what_to_do():
    with pytest.raises(DataError, match=r"colours.*\n.*channel"):
        DominantPeak().extract(Frame(np.zeros((5, 5, 3), np.uint8), name="a.png"))


def test_grey_levels_beyond_the_bit_depth_are_refused():
    frame = Frame(np.full((5, 5), 5000, np.uint16), bit_depth=12, name="a.png")
    with pytest.raises(DataError, match=r"5000.*12.*4095"):
        DominantPeak().extract(frame)


def test_options_are_bounded():
    with pytest.raises(ValidationError):
        DominantPeakOptions(threshold=-1.0)
    with pytest.raises(ValidationError):
        DominantPeakOptions(threshold=256.0)
    assert DominantPeak().options.threshold == 100.0
    assert DominantPeak().options.start == "fixed"
