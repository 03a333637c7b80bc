"""The paper's extractor against rows worked by hand, and against the paper's words written out."""

import math
import xml.etree.ElementTree as ElementTree

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry.records import EDGE, SATURATED, Frame
from roemetry_paper.dominant_peak import DominantPeak, DominantPeakOptions

STARTS = ("fixed", "lowest")
ROW = st.lists(st.integers(0, 255), min_size=3, max_size=60)
both_starts = pytest.mark.parametrize("start", STARTS)


def frame_of(rows, dtype=np.uint8, bit_depth=None):
    """A frame whose inner rows are `rows`: the first and last image row are not searched."""
    rows = np.atleast_2d(np.asarray(rows, dtype))
    pixels = np.vstack([np.zeros_like(rows[:1]), rows, np.zeros_like(rows[:1])])
    return Frame(pixels, bit_depth=bit_depth or 8 * rows.dtype.itemsize)


def peaks_of(row, start="fixed", threshold=100.0):
    options = DominantPeakOptions(start=start, threshold=threshold)
    return DominantPeak(options).extract(frame_of(row)).x_px.astype(int).tolist()


def through(*points):
    """A row that goes in straight lines through (x, grey level) points."""
    x, level = zip(*points, strict=True)
    return np.interp(np.arange(x[-1] + 1), x, level).round().astype(np.uint8)


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
            for valley in [x for x in minima if start < x < end and row[x] < row[start]]:
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


# The paper's Figure 8 as we read it: nine maxima, eight minima, four stripes. P1, P3 and P5 stand before
# their stripe's peak, P7 and P9 behind it, and the row ends in a fall with no minimum after P9.
FIGURE_8 = {
    "origin": (0, 10), "P1": (4, 60), "V1": (6, 45), "P2": (10, 200), "V2": (16, 30),
    "P3": (20, 70), "V3": (22, 55), "P4": (27, 220), "V4": (33, 20),
    "P5": (37, 90), "V5": (39, 75), "P6": (43, 240), "V6": (46, 180), "P7": (48, 200), "V7": (55, 40),
    "P8": (60, 230), "V8": (63, 150), "P9": (65, 190), "end": (71, 20),
}  # fmt: skip


@both_starts
def test_figure_8_has_the_dominant_peaks_p2_p4_p6_p8(start):
    row = through(*FIGURE_8.values())
    assert peaks_of(row, start) == [FIGURE_8[name][0] for name in ("P2", "P4", "P6", "P8")]


@pytest.mark.parametrize(
    ("row", "fixed", "lowest"),
    [
        ([0, 0, 50, 255, 255, 255, 50, 0, 0], [5], [5]),  # the last pixel of a plateau
        ([0, 0, 200, 190, 200, 190, 0, 0], [2], [2]),  # of separate equal maxima the leftmost
        ([10, 10, 10, 150, 240, 200, 120, 60], [4], [4]),  # without a minimum it ends at the last pixel
        ([10, 10, 10, 150, 240, 200, 180, 140], [], []),  # not fallen far enough there
        ([20, 20, 120, 20, 20], [], []),  # a threshold that is just met is not exceeded
        ([20, 20, 121, 20, 20], [2], [2]),
        ([20, 20, 121, 21, 21], [], []),
        ([200, 0, 0, 0, 200], [], []),  # first and last column are not searched
        # a step on the slope (at 100) is a minimum; the second stripe exceeds it by 60 only
        ([0, 0, 120, 240, 100, 100, 40, 0, 0, 0, 80, 160, 80, 0, 0], [3], [3, 11]),
        # a bright left border
        (through((0, 180), (10, 20), (20, 20), (25, 240), (30, 20), (45, 20), (50, 240), (55, 20), (60, 20)),
         [], [25, 50]),
    ],
)  # fmt: skip
def test_rows_worked_by_hand(row, fixed, lowest):
    assert [peaks_of(row, start) for start in STARTS] == [fixed, lowest]


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


@both_starts
def test_thousands_of_random_rows_agree_with_the_search_in_words(start):
    rows = random_rows(4_000, 70, seed=20)  # more columns than two of the kernel's blocks
    eight = DominantPeak(DominantPeakOptions(start=start)).extract(frame_of(rows))
    for y, row in enumerate(rows.tolist(), start=1):
        found = eight.x_px[eight.row_start[y] : eight.row_start[y + 1]].tolist()
        assert found == search(row, 100, start), row
    # 100 levels of 8 bits are 1605.9 of 12: between 16 times 100 and 16 times 101
    for factor, bits in ((257, 16), (16, 12)):
        frame = frame_of(rows.astype(np.uint16) * factor, np.uint16, bit_depth=bits)
        more = DominantPeak(DominantPeakOptions(start=start)).extract(frame)
        np.testing.assert_array_equal(eight.x_px, more.x_px)
        np.testing.assert_allclose(more.amplitude, factor * eight.amplitude, atol=0)


@settings(max_examples=200)
@given(
    st.lists(st.sampled_from([0, 1, 20, 99, 100, 101, 120, 121, 200, 254, 255]), min_size=3, max_size=45),
    st.sampled_from([0, 1, 20, 100, 154]),
    st.sampled_from(STARTS),
)
def test_any_row_agrees_with_the_search_in_words(row, threshold, start):
    assert peaks_of(row, start, threshold) == search(row, threshold, start)


def test_more_peaks_than_room_was_made_for():
    # 64 peaks a row have room at first; here every second pixel is one.
    peaks = DominantPeak().extract(frame_of([np.tile([0, 200], 150)] * 5))
    assert len(peaks) == 5 * 149
    assert (np.diff(peaks.row_start)[1:-1] == 149).all()


def test_measures_of_a_triangle():
    # Rises by 20 from 20 to 220 and falls by 40 to 60: half of 160 above 60 is 140, met at 6.0 and 12.0.
    peaks = DominantPeak().extract(frame_of([20, *range(20, 221, 20), 180, 140, 100, 60, 60, 60]))
    assert peaks.x_px.tolist() == [11.0]
    assert (peaks.background[0], peaks.amplitude[0], peaks.flags[0]) == (60.0, 160.0, 0)
    assert peaks.width_px[0] == pytest.approx(13.0 - 7.0, abs=1e-12)
    assert math.isnan(peaks.x_std_px[0])


def test_saturated_edge_and_the_rows_that_are_searched():
    extractor = DominantPeak()
    row = np.zeros(40, np.uint8)
    row[[2, 3, 20, 36, 37]] = [200, 0, 255, 0, 200]
    assert extractor.extract(frame_of(row)).flags.tolist() == [EDGE, SATURATED, EDGE]
    twelve = frame_of(row.astype(np.uint16) * 16, np.uint16, bit_depth=12)
    assert not (extractor.extract(twelve).flags & SATURATED).any()  # 4080 of 4095
    peaks = extractor.extract(Frame(np.tile(np.array([0, 0, 0, 200, 0, 0, 0], np.uint8), (5, 1))))
    assert peaks.row.tolist() == [1, 2, 3]
    assert peaks.x_px.tolist() == [3.0, 3.0, 3.0]


def test_the_papers_figures_7_and_9_can_be_made_again(tmp_path, capsys):
    figures = pytest.importorskip("benchmarks.paper_figures", reason="only in a checkout")
    x = np.arange(120)
    row = sum(peak * np.exp(-0.5 * ((x - at) / 2.0) ** 2) for peak, at in ((240, 20), (150, 60), (110, 100)))
    cv2.imwrite(str(tmp_path / "a & b.png"), np.tile(row.round().astype(np.uint8), (50, 1)))
    figures.main([str(tmp_path / "a & b.png"), "--row", "20", "--out", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    assert "threshold A (200)          1: 20" in printed
    assert "threshold C (40)           3: 20, 60, 100" in printed
    assert "dominant peak (by 100)     3: 20, 60, 100" in printed
    svg = ElementTree.parse(tmp_path / "out" / "figure_7.svg").getroot()
    assert len(svg.findall("{http://www.w3.org/2000/svg}g")) == 5
    # Four pictures of 120 × 50 px with 8 px beside them and a caption below.
    assert cv2.imread(str(tmp_path / "out" / "figure_9.png")).shape == (50 + 8 + 34, 4 * (120 + 16), 3)
    with pytest.raises(SystemExit):
        figures.main([str(tmp_path / "a & b.png"), "--row", "0", "--out", str(tmp_path / "out")])


def stripes_on(ground, height, rng):
    """(row, column) three stripes 40 px apart, the last one at 60 % of the height, with noise."""
    x = np.arange(160)
    light = sum(h * np.exp(-0.5 * ((x - c) / 2.0) ** 2) for h, c in ((1.0, 30), (1.0, 70), (0.6, 110)))
    level = ground + height * light + rng.normal(0.0, 1.0, (80, 160))
    return Frame(np.clip(np.rint(level), 0, 255).astype(np.uint8))


@pytest.mark.parametrize(("ground", "height"), [(10.0, 40.0), (10.0, 200.0), (90.0, 120.0)])
def test_an_automatic_threshold_finds_stripes_of_any_brightness(ground, height, rng):
    peaks = DominantPeak(DominantPeakOptions(threshold="auto")).extract(stripes_on(ground, height, rng))
    assert np.abs(peaks.x_px[:, None] - [30, 70, 110]).min(axis=1).max() <= 2.0  # whole pixels, with noise
    assert len(peaks) == 3 * 78


def test_an_automatic_threshold_leaves_out_what_is_faint_beside_a_stripe():
    row = np.full(60, 10)
    row[30:33] = 150, 230, 150
    row[40:43] = 20, 25, 20
    frame = Frame(np.tile(row.astype(np.uint8), (20, 1)))
    assert len(DominantPeak(DominantPeakOptions(threshold=8.0)).extract(frame)) == 2 * 18
    assert DominantPeak(DominantPeakOptions(threshold="auto")).extract(frame).x_px.tolist() == [31.0] * 18
