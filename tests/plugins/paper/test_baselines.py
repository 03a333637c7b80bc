"""The extractors the paper compares against: fixed thresholds and every local maximum."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roemetry.errors import DataError
from roemetry.records import EDGE, SATURATED, Frame
from roemetry_paper.dominant_peak import (
    BinaryThreshold,
    BinaryThresholdOptions,
    DominantPeak,
    DominantPeakOptions,
    LocalMaximum,
    LocalMaximumOptions,
)


def frame_of(row, dtype=np.uint8):
    row = np.asarray(row, dtype)
    return Frame(np.vstack([np.zeros_like(row), row, np.zeros_like(row)]), bit_depth=8 * row.dtype.itemsize)


def runs(row, threshold=128.0):
    return BinaryThreshold(BinaryThresholdOptions(threshold=threshold)).extract(frame_of(row))


def maxima(row, floor=0.0):
    return LocalMaximum(LocalMaximumOptions(floor=floor)).extract(frame_of(row))


ROW = st.lists(st.integers(0, 255), min_size=3, max_size=60)


def test_one_peak_in_the_middle_of_each_run():
    peaks = runs([0, 0, 0, 200, 220, 200, 0, 0, 130, 250, 0, 0, 0, 140, 0, 0, 0])
    assert peaks.x_px.tolist() == [4.0, 8.5, 13.0]
    assert peaks.amplitude.tolist() == [220.0, 250.0, 140.0]
    assert peaks.row.tolist() == [1, 1, 1]
    assert np.isnan(peaks.x_std_px).all()
    assert peaks.flags.tolist() == [0, 0, 0]


def test_threshold_just_met_is_not_above():
    assert len(runs([0, 0, 128, 0, 0])) == 0
    assert runs([0, 0, 129, 0, 0]).x_px.tolist() == [2.0]


def test_low_threshold_joins_stripes_and_high_one_loses_the_dim_one():
    row = [0, 0, 0, 90, 250, 90, 60, 60, 100, 120, 100, 0, 0, 0]
    assert len(runs(row, 50.0)) == 1
    assert len(runs(row, 110.0)) == 2
    assert len(runs(row, 200.0)) == 1


def test_a_run_cut_by_the_border_is_flagged_and_one_that_fills_the_row_is_none():
    peaks = runs([200, 200, 200, 200, 0, 0, 0, 200, 0, 0, 0, 200, 200, 200, 200])
    assert peaks.x_px.tolist() == [2.0, 7.0, 12.0]
    assert peaks.flags.tolist() == [EDGE, 0, EDGE]
    wide = runs([200] * 20 + [0] * 20)
    assert wide.flags.tolist() == [EDGE]
    assert len(runs([200] * 40)) == 0


@settings(deadline=None, max_examples=300)
@given(ROW, st.integers(0, 255))
def test_runs_agree_with_plain_python(row, threshold):
    above = [level > threshold for level in row[1:-1]]
    expected, first = [], None
    for x, high in enumerate([*above, False], start=1):
        if high and first is None:
            first = x
        elif not high and first is not None:
            expected.append((first + x - 1) / 2)
            first = None
    assert runs(row, threshold).x_px.tolist() == ([] if all(above) else expected)


def test_maxima_worked_by_hand():
    # A plateau (last pixel), a step on a slope (its last pixel, amplitude 0), a single pixel.
    peaks = maxima([0, 0, 90, 90, 50, 50, 20, 10, 30, 10, 10])
    assert peaks.x_px.tolist() == [3.0, 5.0, 8.0]
    assert peaks.amplitude.tolist() == [40.0, 0.0, 20.0]
    assert peaks.background.tolist() == [50.0, 50.0, 10.0]
    assert math.isnan(peaks.width_px[1])
    assert peaks.width_px[2] == pytest.approx(1.0, abs=1e-12)  # px


@settings(deadline=None, max_examples=300)
@given(ROW, st.sampled_from([0, 1, 100, 255]))
def test_maxima_agree_with_the_definition(row, floor):
    expected = [
        x
        for x in range(1, len(row) - 1)
        if row[x + 1] - row[x] < 0 and row[x] - row[x - 1] >= 0 and row[x] >= floor
    ]
    assert maxima(row, floor).x_px.tolist() == expected


@settings(deadline=None, max_examples=200)
@given(ROW)
def test_dominant_peaks_are_maxima(row):
    for start in ("fixed", "lowest"):
        dominant = DominantPeak(DominantPeakOptions(start=start)).extract(frame_of(row))
        assert set(dominant.x_px) <= set(maxima(row).x_px)
        assert (dominant.amplitude > 100).all()


@settings(deadline=None, max_examples=200)
@given(ROW)
def test_half_height_is_met_at_the_ends_of_the_width(row):
    peaks = maxima(row)
    half = peaks.background + 0.5 * peaks.amplitude
    for x, width, level in zip(peaks.x_px, peaks.width_px, half, strict=True):
        if math.isnan(width):
            continue
        x_px = np.arange(len(row))
        # The walk outwards, pixel by pixel, with a fine grid of linear interpolation.
        fine = np.linspace(0, len(row) - 1, 200 * (len(row) - 1) + 1)
        below = np.interp(fine, x_px, row) < level - 1e-9
        left = fine[below & (fine < x)].max()
        right = fine[below & (fine > x)].min()
        assert width == pytest.approx(right - left, abs=0.011)  # px: two steps of the grid


@pytest.mark.parametrize("extractor", [BinaryThreshold(), LocalMaximum(), DominantPeak()])
class TestEveryExtractor:
    @pytest.mark.parametrize("level", [0, 255])
    def test_black_and_white_frames_are_empty(self, extractor, level):
        assert len(extractor.extract(Frame(np.full((20, 30), level, np.uint8)))) == 0

    def test_sixteen_bits_find_what_eight_bits_find(self, extractor):
        pixels = np.random.default_rng(5).integers(0, 256, (40, 80)).astype(np.uint8)
        eight = extractor.extract(Frame(pixels))
        sixteen = extractor.extract(Frame(pixels.astype(np.uint16) * 257, bit_depth=16))
        assert len(eight) > 50
        np.testing.assert_array_equal(eight.row, sixteen.row)
        np.testing.assert_array_equal(eight.x_px, sixteen.x_px)
        np.testing.assert_array_equal(eight.flags, sixteen.flags)

    def test_first_and_last_row_are_not_searched(self, extractor):
        peaks = extractor.extract(Frame(np.tile(np.array([0, 0, 0, 200, 0, 0, 0], np.uint8), (5, 1))))
        assert peaks.row.tolist() == [1, 2, 3]
        assert peaks.x_px.tolist() == [3.0, 3.0, 3.0]

    def test_saturated_is_flagged(self, extractor):
        peaks = extractor.extract(frame_of([0, 0, 0, 255, 0, 0, 0, 254, 0, 0, 0]))
        assert (peaks.flags == [SATURATED, 0]).all()

    def test_colour_is_refused(self, extractor):
        with pytest.raises(DataError, match="colours"):
            extractor.extract(Frame(np.zeros((5, 5, 3), np.uint8)))

    def test_the_frame_is_left_alone(self, extractor):
        pixels = np.random.default_rng(6).integers(0, 256, (20, 30)).astype(np.uint8)
        before = pixels.copy()
        extractor.extract(Frame(pixels))
        np.testing.assert_array_equal(pixels, before)
        assert pixels.flags.writeable


def test_the_papers_figures_7_and_9_can_be_made_again(tmp_path, capsys):
    figures = pytest.importorskip("benchmarks.paper_figures", reason="only in a checkout")
    import xml.etree.ElementTree as ElementTree

    import cv2

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
@pytest.mark.parametrize(
    "extractor",
    [
        DominantPeak(DominantPeakOptions(threshold="auto")),
        BinaryThreshold(BinaryThresholdOptions(threshold="auto")),
    ],
)
def test_an_automatic_threshold_finds_stripes_of_any_brightness(extractor, ground, height, rng):
    peaks = extractor.extract(stripes_on(ground, height, rng))
    assert len(peaks) == 3 * 78
    assert np.abs(peaks.x_px.reshape(-1, 3) - [30, 70, 110]).max() <= 2.0  # px: whole pixels, with noise


@pytest.mark.parametrize(("ground", "height"), [(10.0, 40.0), (90.0, 120.0)])
def test_an_automatic_floor_leaves_out_the_dark(ground, height, rng):
    peaks = LocalMaximum(LocalMaximumOptions(floor="auto")).extract(stripes_on(ground, height, rng))
    off = np.abs(peaks.x_px[:, None] - [30, 70, 110]).min(axis=1)
    assert off.max() <= 4.0  # px
    assert len(peaks) >= 3 * 78


def test_an_automatic_threshold_leaves_out_what_is_faint_beside_a_stripe():
    row = np.full(60, 10)
    row[30:33] = 150, 230, 150
    row[40:43] = 20, 25, 20
    frame = Frame(np.tile(row.astype(np.uint8), (20, 1)))
    assert len(DominantPeak(DominantPeakOptions(threshold=8.0)).extract(frame)) == 2 * 18
    assert DominantPeak(DominantPeakOptions(threshold="auto")).extract(frame).x_px.tolist() == [31.0] * 18
