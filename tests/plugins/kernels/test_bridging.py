"""Which runs near the belt are where a product thins out, and which are belt that its rim cuts."""

import numpy as np
import pytest

from roemetry_kernels.bridging import off_belt_and_bridged

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
