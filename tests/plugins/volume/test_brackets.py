"""Where stripes end on a product, which says whether an outline is its own."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_volume.agreement import LEAST_ROWS, ends_of_stripes


@pytest.mark.parametrize("glare_rows", [1, LEAST_ROWS - 1])
def test_light_left_over_at_a_shadow_is_no_end_of_a_stripe(glare_rows: int) -> None:
    """A stripe on the belt, its shadow, the product; the shadow's edge shows a speck aside."""
    rows = np.arange(60)
    product = np.where(rows < 15, 0, np.where(rows < 25, -1, np.where(rows < 50, 1, 0))).astype(np.int16)
    x_px = np.where(product == 1, 30.0, 20.0) + 0.1 * rows
    x_px[product < 0] = np.nan
    product[15 : 15 + glare_rows], x_px[15 : 15 + glare_rows] = 1, 22.5
    seen = np.isfinite(x_px)
    ends, beyond = ends_of_stripes(x_px[None], seen[None], product[None], 1, LEAST_ROWS)
    assert ends[:, 1].tolist() == [25.0, 49.0]
    assert np.allclose(ends[:, 0], [32.5, 34.9])
    assert beyond[:, 1].tolist() == [14.0, 50.0]


def test_a_piece_of_a_stripe_as_long_as_a_speck_may_be_has_no_ends() -> None:
    product = np.zeros((1, 20), np.int16)
    product[0, 8 : 8 + LEAST_ROWS - 1] = 1
    ends, beyond = ends_of_stripes(np.full((1, 20), 5.0), product >= 0, product, 1, LEAST_ROWS)
    assert not len(ends) and not len(beyond)
