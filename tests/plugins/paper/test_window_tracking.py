"""Coding: right, or refused; never silently wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.coded.literal import Literal
from roemetry.errors import StageError
from roemetry.records import AMBIGUOUS, BELT, NOTHING, Frame, Peaks, StripeMap
from roemetry_paper.dominant_peak import DominantPeak, DominantPeakOptions
from roemetry_paper.window_tracking import WindowTracking, WindowTrackingOptions


def peaks_of(rig, x_px: np.ndarray, rng: np.random.Generator | None = None) -> Peaks:
    frame = Frame(rig.image(x_px, rng))
    return DominantPeak(DominantPeakOptions(threshold=60, start="lowest")).extract(frame)


def wrong_points(stripes: StripeMap, x_px: np.ndarray) -> int:
    """Seen points that are nearer to another stripe's true centre than to their own."""
    wrong = 0
    for stripe, row in np.argwhere(stripes.seen):
        off = np.abs(x_px[:, row] - stripes.x_px[stripe, row])
        wrong += int(np.nanargmin(off) != stripe)
    return wrong


def coded_share(stripes: StripeMap, x_px: np.ndarray) -> float:
    """Share of the visible points that are labelled; the paper's peaks leave out the first and last row."""
    visible = np.isfinite(x_px[:, 1:-1])
    return float((stripes.seen[:, 1:-1] & visible).sum() / visible.sum())


def test_a_dome_is_labelled_whole_without_a_calibration(rig, rng) -> None:
    x_px = rig.x_px(rig.dome(12.0))
    stripes = WindowTracking().code(peaks_of(rig, x_px, rng), None)
    assert wrong_points(stripes, x_px) == 0
    assert coded_share(stripes, x_px) > 0.995
    assert set(np.unique(stripes.product)) <= {NOTHING, BELT, 1}


def test_the_papers_order_is_shifted_by_a_hidden_body(rig, rng) -> None:
    """Why the letter of the paper is not followed: it is silently wrong here, and nothing says so."""
    heights = np.zeros((rig.stripes, rig.rows))
    heights[1:6, 80:160] = 12.0
    x_px = rig.x_px(heights)
    x_px[1, 78:162] = np.nan
    found = peaks_of(rig, x_px, rng)
    assert wrong_points(Literal().code(found, rig.calibration()), x_px) > 100
    assert wrong_points(WindowTracking().code(found, rig.calibration()), x_px) == 0
    x_px[:, 80:120] = np.nan
    for coder in (Literal(), WindowTracking()):  # what is compared is the coding, not what is refused
        with pytest.raises(StageError, match="rows"):
            coder.code(peaks_of(rig, x_px, rng), rig.calibration())


def test_short_gaps_are_bridged_by_straight_lines_and_long_ones_are_not(rig) -> None:
    heights = rig.dome(12.0)
    x_px = rig.x_px(heights)
    x_px[3, 110:125] = np.nan
    x_px[2, 100:130] = np.nan
    stripes = WindowTracking().code(peaks_of(rig, x_px), rig.calibration())
    assert not stripes.seen[3, 110:125].any()
    assert (stripes.product[3, 110:125] == 1).all()
    ends = stripes.x_px[3, 109], stripes.x_px[3, 125]
    np.testing.assert_allclose(stripes.x_px[3, 110:125], np.linspace(*ends, 17)[1:-1], rtol=0, atol=1e-9)
    assert np.isnan(stripes.x_px[2, 101:129]).all()


def test_two_products_have_two_numbers(rig, rng) -> None:
    row = np.arange(rig.rows)
    heights = np.zeros((rig.stripes, rig.rows))
    heights[1:3] = 8.0 * np.exp(-0.5 * ((row - 110) / 15.0) ** 2)
    heights[4:6] = 6.0 * np.exp(-0.5 * ((row - 130) / 15.0) ** 2)
    stripes = WindowTracking().code(peaks_of(rig, rig.x_px(heights), rng), rig.calibration())
    assert set(np.unique(stripes.product[1:3])) >= {1}
    assert set(np.unique(stripes.product[4:6])) >= {2}
    assert 2 not in stripes.product[:3]


def test_dirt_on_the_belt_is_said_and_left_out(rig) -> None:
    heights = np.zeros((rig.stripes, rig.rows))
    heights[3, 100:118] = 4.0
    stripes = WindowTracking().code(peaks_of(rig, rig.x_px(heights)), rig.calibration())
    assert not (stripes.product > 0).any()
    assert any(reason.code == "dirt" for reason in stripes.reasons)


def test_a_recipe_that_expects_another_number_of_stripes(rig) -> None:
    x_px = rig.x_px(np.zeros((rig.stripes, rig.rows)))
    coder = WindowTracking(WindowTrackingOptions(stripe_count=9))
    with pytest.raises(StageError, match="expects 9 stripes"):
        coder.code(peaks_of(rig, x_px), rig.calibration())
    with pytest.raises(StageError, match="9 stripes are expected; 7 begin"):
        coder.code(peaks_of(rig, x_px), None)


def test_without_belt_or_calibration_pieces_are_numbered_and_it_says_so(rig) -> None:
    x_px = np.full((rig.stripes, rig.rows), np.nan)
    x_px[:, 60:180] = rig.x_px(rig.dome())[:, 60:180]
    stripes = WindowTracking().code(peaks_of(rig, x_px), None)
    assert [reason.code for reason in stripes.reasons] == ["no-belt"]
    assert np.isnan(stripes.rest_px).all()
    assert not (stripes.product == BELT).any()


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.floats(2.0, 24.0),
    holes=st.integers(0, 12),
    side=st.sampled_from([-1, 1]),
)
def test_never_wrong_on_random_domes_with_holes(rig, seed: int, height: float, holes: int, side: int) -> None:
    """Whatever is missing, what is labelled is labelled right."""
    rig = replace(rig, px_per_mm=2.0 * side)
    rng = np.random.default_rng(seed)
    x_px = rig.x_px(rig.dome(height, first=int(rng.integers(40, 80)), last=int(rng.integers(150, 210))))
    for _ in range(holes):
        stripe, start = rng.integers(rig.stripes), rng.integers(rig.rows)
        x_px[stripe, start : start + rng.integers(3, 60)] = np.nan
    try:
        stripes = WindowTracking().code(peaks_of(rig, x_px, rng), rig.calibration())
    except StageError:
        return
    assert wrong_points(stripes, x_px) == 0
    assert stripes.peak_stripe.min() >= AMBIGUOUS


@pytest.mark.parametrize(("low", "high"), [(20.0, 20.0), (19.0, 21.5)])
def test_a_body_on_its_neighbours_rest_line_where_that_belt_ends(rig, rng, low, high) -> None:
    """At a displacement of one spacing (20 mm here) a body runs straight on from its neighbour's belt."""
    heights = np.zeros((rig.stripes, rig.rows))
    heights[1:5, 80:160] = np.linspace(low, high, 80)
    x_px = rig.x_px(heights)
    x_px[5, 80:160] = np.nan  # its light falls on the product's side, which the camera cannot see
    stripes = WindowTracking().code(peaks_of(rig, x_px, rng), rig.calibration())
    assert wrong_points(stripes, x_px) == 0
    assert low < high or "unexplained-gap" in {reason.code for reason in stripes.reasons}


def test_a_stripe_seen_twice_while_another_is_hidden_is_not_believed(rig, rng) -> None:
    """A fold shows one plane twice in a row; with another body hidden the count is right by chance."""
    x_px = rig.x_px(rig.dome(12.0))
    twice = np.full(rig.rows, np.nan)
    twice[90:150] = x_px[2, 90:150] + 14.0
    shown = x_px.copy()
    shown[4, 90:100] = np.nan
    stripes = WindowTracking().code(peaks_of(rig, np.vstack([shown, twice]), rng), rig.calibration())
    known = np.vstack([shown, twice])
    off = np.abs(known[:, None, :] - np.where(stripes.seen, stripes.x_px, np.nan)[None, :, :])
    off = np.where(np.isnan(off), np.inf, off)
    true = off.argmin(axis=0)
    true[true == rig.stripes] = 2
    wrong = np.isfinite(off.min(axis=0)) & (true != np.arange(rig.stripes)[:, None])
    assert wrong.sum() == 0


def test_a_few_dark_rows_are_no_reason_to_refuse_even_where_nothing_is_bridged(rig) -> None:
    x_px = rig.x_px(rig.dome(12.0))
    x_px[:, 30:33] = np.nan
    coder = WindowTracking(WindowTrackingOptions(longest_gap_rows=0))
    stripes = coder.code(peaks_of(rig, x_px), rig.calibration())
    assert wrong_points(stripes, x_px) == 0
    assert coded_share(stripes, x_px) > 0.9
