"""The belt's scatter about its rest lines against numpy's own medians."""

import numpy as np
import pytest

from roemetry.testing.scenes import LinearRig
from roemetry_kernels.rest_lines import _scatter, calibrated_rest_lines


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
