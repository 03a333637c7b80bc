"""The belt's scatter about its rest lines against numpy's own medians."""

import numpy as np
import pytest

from roemetry_kernels.rest_lines import _scatter


@pytest.mark.parametrize("rows", [1, 2, 3, 24, 301])
@pytest.mark.parametrize("steps", [None, 0.5])
def test_scatter_is_the_median_absolute_deviation(rows, steps, rng):
    rest_px = np.array([20.0, 60.0, 100.0])[:, None] + np.zeros(rows)
    off = rng.normal(0.3, 0.8, (rows, 3)).clip(-4.0, 4.0)
    if steps is not None:
        off = np.round(off / steps) * steps
    row = np.repeat(np.arange(rows), 3)
    count, mad, mean = _scatter(row, (rest_px.T + off).reshape(-1), rest_px, row.size, row.size, 8.0)
    off = (rest_px.T + off - rest_px.T).reshape(-1)
    assert count == off.size
    assert mad == pytest.approx(np.median(np.abs(off - np.median(off))), abs=1e-13)
    assert mean == pytest.approx(off.mean(), abs=1e-13)


def test_no_peak_near_a_line_has_no_scatter():
    rest_px = np.full((1, 4), 20.0)
    count, _, _ = _scatter(np.arange(4), np.full(4, 90.0), rest_px, 4, 4, 8.0)
    assert count == 0
