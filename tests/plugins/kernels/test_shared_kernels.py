"""Kernels that several plugins share against plain references: bridging, steps, medians, fits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roemetry.errors import DataError
from roemetry.records import Frame
from roemetry.run.transport_faults import check_joins
from roemetry.testing.scenes import LinearRig
from roemetry_kernels.bridging import off_belt_and_bridged
from roemetry_kernels.frame_checks import count_steps, lines_differ
from roemetry_kernels.image_levels import median_of, nth_smallest, quantile_of
from roemetry_kernels.rest_lines import _scatter, calibrated_rest_lines
from roemetry_kernels.robust_fit import robust_fit

ROWS, TOLERANCE_PX, REACH_PX, GAP_ROWS = 120, 1.0, 3.0, 20
ON = slice(30, 90)


def stripes(*offsets_px, side=1.0):
    """Give (stripe, row) points and rest lines; each stripe lies so far off its own, on the rows `ON`."""
    rest_px = np.repeat(40.0 * np.arange(len(offsets_px))[:, None], ROWS, axis=1)
    x_px = rest_px.copy()
    for s, offset_px in enumerate(offsets_px):
        x_px[s, ON] += side * offset_px
    return x_px, rest_px


def on_product(x_px, rest_px):
    """Give (stripe,) the share of the rows `ON` that is off the belt."""
    return off_belt_and_bridged(x_px, rest_px, TOLERANCE_PX, REACH_PX, GAP_ROWS)[:, ON].mean(axis=1)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_product_thins_out_over_several_stripes_on_either_side(side):
    thinning = stripes(0.5, 1.5, 2.2, 8.0, 9.0, 2.5, 1.4, 0.0, side=side)
    assert on_product(*thinning).tolist() == [0, 1, 1, 1, 1, 1, 1, 0]


def test_what_lies_near_the_belt_beside_no_product_is_belt():
    assert on_product(*stripes(0.0, 2.0, 2.5, 0.0, 8.0)).tolist() == [0, 0, 0, 0, 1]


def test_belt_that_the_shadow_cuts_stays_belt():
    assert on_product(*stripes(8.0, 9.0, -2.0)).tolist() == [1, 1, 0]


def test_scraps_of_belt_that_the_lit_side_cuts_stay_belt():
    x_px, rest_px = stripes(8.0, 9.0, 2.0)
    scraps = np.isin(np.arange(ROWS), np.arange(ON.start, ON.stop, 7))
    x_px[2, ON] = np.where(scraps[ON], x_px[2, ON], np.nan)
    assert on_product(x_px, rest_px).tolist() == [1, 1, 0]


def test_a_thin_end_with_gaps_is_product_and_the_gaps_are_its():
    x_px, rest_px = stripes(8.0, 9.0, 2.0)
    x_px[2, 40:60:2] = np.nan
    assert on_product(x_px, rest_px).tolist() == [1, 1, 1]
    assert np.isfinite(x_px).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_belt_that_a_shadow_shifts_behind_a_gap_is_not_the_products_end(side):
    x_px, rest_px = stripes(8.0, side=side)
    x_px[0, 60:75] = np.nan
    x_px[0, 75:80] = rest_px[0, 75:80] - 1.3 * side
    x_px[0, 80:ROWS] = rest_px[0, 80:ROWS]
    off_belt = off_belt_and_bridged(x_px, rest_px, TOLERANCE_PX, REACH_PX, GAP_ROWS)[0]
    assert off_belt[ON.start : 75].all()
    assert not off_belt[75:].any()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 3), (17, 9), (257, 64), (300, 333)])
def test_steps_are_those_of_whole_arrays(
    kind: type[np.unsignedinteger], shape: tuple[int, int], rng: np.random.Generator
) -> None:
    top = np.iinfo(kind).max
    pixels = rng.integers(0, top + 1, shape).astype(kind)
    pixels[:, : shape[1] // 3] = top // 3  # a part where nothing changes
    light = pixels.astype(np.int64)
    for least in (top // 20, top // 4, top // 2):
        by_row, by_column, breaks = count_steps(pixels, least)
        step = np.abs(np.diff(light, axis=1))
        np.testing.assert_array_equal(by_row, (np.abs(np.diff(light, axis=0)) > least).sum(axis=1))
        np.testing.assert_array_equal(by_column, (step > least).sum(axis=0))
        if shape[1] > 3:
            far, near = np.abs(light[:, 3:] - light[:, :-3]), step[:, 1:-1]
            wanted = ((near > least) & (np.maximum(far - near, 0) <= near // 2)).sum(axis=0)
            np.testing.assert_array_equal(breaks[1:-1], wanted)


@pytest.mark.parametrize("part", ["none", "rows", "columns", "every second row"])
def test_the_check_says_the_same_with_counted_steps(part: str, rng: np.random.Generator) -> None:
    frame, other = (
        np.clip(np.rint(light + rng.normal(0.0, 1.2, light.shape)), 0, 255).astype(np.uint8)
        for light in (_lines(0.0), _lines(12.0))
    )
    if part == "rows":
        frame[150:] = other[150:]
    elif part == "columns":
        frame[:, 200:] = other[:, 200:]
    elif part == "every second row":
        frame[1::2] = other[1::2]
    said = []
    for counted in ((), (count_steps,)):
        try:
            check_joins(Frame(frame), *counted)
            said.append("")
        except DataError as error:
            said.append(str(error))
    assert said[0] == said[1]
    assert (said[0] == "") == (part == "none")


def _lines(shift_px: float) -> np.ndarray:
    rows, columns = np.mgrid[0:300, 0:400]
    off = (columns - shift_px - 0.02 * rows) % 25.0 - 12.5
    return 11.0 + 180.0 * np.exp(-0.5 * (off / 1.8) ** 2)


@pytest.mark.parametrize("rows", [1, 2, 3, 24, 301])
@pytest.mark.parametrize("steps", [None, 0.5])
def test_scatter_is_the_median_absolute_deviation(rows, steps, rng):
    off = rng.normal(0.3, 0.8, (rows, 3)).clip(-4.0, 4.0)
    if steps is not None:
        off = np.round(off / steps) * steps
    off = off.reshape(-1)
    count, mad, mean = _scatter(off, off.size, off.size, 8.0, 0.0)
    assert count == off.size
    assert mad == pytest.approx(np.median(np.abs(off - np.median(off))), abs=1e-13)
    assert mean == pytest.approx(off.mean(), abs=1e-13)


@pytest.mark.parametrize("rows", [1, 2, 3, 24, 301])
@pytest.mark.parametrize("std_px", [0.02, 0.15, 0.25])
def test_scatter_below_what_matters_is_given_as_that(rows, std_px, rng):
    """Whether or not the median has to be found for it, and wherever the mean is dragged by a few strays."""
    for _ in range(60):
        off = rng.normal(0.3, std_px, rows)
        off[rng.random(rows) < rng.choice([0.0, 0.1, 0.45])] += rng.uniform(-2.0, 2.0)
        _, mad, _ = _scatter(off, off.size, off.size, 8.0, 0.17)
        assert mad == pytest.approx(max(np.median(np.abs(off - np.median(off))), 0.17), abs=1e-13)


def test_peaks_lie_on_their_nearest_line(rng):
    """Line and counts are those that a search over all lines finds, with peaks missing and false ones."""
    linear = LinearRig()
    rest_px = linear.x_px(linear.belt())
    x_px = rest_px + rng.normal(0.0, 0.3, rest_px.shape) + 6.0 * (rng.random(rest_px.shape) < 0.1)
    x_px[rng.random(rest_px.shape) < 0.1] = np.nan
    peaks = linear.peaks(x_px).peaks
    rest = calibrated_rest_lines(peaks, linear.calibration())
    off = np.abs(peaks.x_px - rest.x_px[:, peaks.row])
    expected = np.where(off.min(axis=0) <= rest.tolerance_px, off.argmin(axis=0), -1)
    np.testing.assert_array_equal(rest.line, expected)
    np.testing.assert_array_equal(rest.on_line, [(expected == s).sum() for s in range(rest.x_px.shape[0])])


FLOATS = st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=60)


@given(FLOATS)
def test_ranks_and_medians_are_those_of_sorted_values(numbers: list[float]) -> None:
    values = np.array(numbers)
    kept = values.copy()
    assert [nth_smallest(values, n) for n in range(values.size)] == sorted(numbers)
    assert median_of(values) == np.median(kept)
    assert (values == kept).all()


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=200))
def test_many_equal_whole_numbers(numbers: list[int]) -> None:
    values = np.array(numbers)
    assert [nth_smallest(values, n) for n in range(values.size)] == sorted(numbers)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), st.floats(0.0, 1.0))
def test_quantiles_are_numpys(numbers: list[float], share: float) -> None:
    values = np.array(numbers)
    np.testing.assert_allclose(quantile_of(values, share), np.quantile(values, share), rtol=1e-9, atol=1e-9)


def test_a_fifth_that_lies_far_off_hardly_moves_the_fit(rng: np.random.Generator) -> None:
    x = np.linspace(-1.0, 1.0, 201)
    rows = np.stack([np.ones_like(x), x, x * x])
    wanted = np.array([2.0, -1.0, 0.5]) @ rows + 0.01 * rng.standard_normal(x.size)
    wanted[::5] += 3.0
    base, ridge = 0.5 + rng.random(x.size), np.array([0.0, 1e-6, 1e-6])
    fit, weight, off = robust_fit(rows, wanted, base, ridge, 0.005, 20)
    np.testing.assert_allclose(fit, [2.0, -1.0, 0.5], rtol=0, atol=0.02)
    expected, found = base, np.zeros(3)
    for _ in range(20):
        found = np.linalg.solve((rows * expected) @ rows.T + np.diag(ridge), (rows * expected) @ wanted)
        left = wanted - found @ rows
        expected = base / (1.0 + (left / (2.0 * max(1.4826 * np.median(np.abs(left)), 0.005))) ** 2)
    np.testing.assert_allclose(fit, found, rtol=0, atol=1e-10)
    np.testing.assert_allclose(off, left, rtol=0, atol=1e-10)
    np.testing.assert_allclose(weight, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("axis", [0, 1])
def test_lines_of_noise_differ_and_those_that_repeat_are_left_to_the_core(kind, axis, rng):
    noise = rng.integers(0, np.iinfo(kind).max, (400, 320), kind)
    lines = noise if axis == 0 else noise.T
    assert lines_differ(noise)
    assert lines_differ(noise[::-1]) and lines_differ(noise.T.copy())
    for first, second in rng.integers(0, len(lines), (20, 2)):
        kept = lines[first].copy()
        lines[first] = lines[second]
        assert not lines_differ(noise) or first == second
        lines[first] = kept
    assert not lines_differ(noise[:100]) and not lines_differ(noise[:, :4])  # too small to tell
