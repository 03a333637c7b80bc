"""local-polynomial: scatter as stated, bows not cut short, steps and breaks kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from roemetry.records import NOTHING, StripeMap
from roemetry_peaks.local_polynomial import LocalPolynomial, LocalPolynomialOptions

ROWS = np.arange(400.0)
STD_PX = 0.1


def stripes(x_px: np.ndarray, std_px: float = STD_PX, correlation_rows: float = 0.0) -> StripeMap:
    seen = np.isfinite(x_px)
    return StripeMap(
        x_px=x_px,
        x_std_px=np.where(seen, std_px, np.nan),
        product=np.where(seen, 0, NOTHING),
        seen=seen,
        margin=np.full(x_px.shape, np.nan),
        ambiguous=np.zeros(x_px.shape, np.bool_),
        rest_px=np.full(x_px.shape, np.nan),
        peak_stripe=np.empty(0, np.int16),
        correlation_rows=correlation_rows,
    )


def noisy(path: np.ndarray, rng: np.random.Generator, count: int = 12) -> np.ndarray:
    return path + rng.normal(0.0, STD_PX, (count, path.size))


@pytest.mark.parametrize("length", [0.0, 0.8])
def test_scatter_is_as_stated_also_of_correlated_errors(length: float, rng: np.random.Generator) -> None:
    noise = rng.standard_normal((20, ROWS.size + 40))
    if length:
        noise = gaussian_filter1d(noise, length, axis=1, truncate=8.0)
    noise = STD_PX * (noise / noise.std())[:, 20:-20]
    path = 300.0 + 0.4 * ROWS
    smoothed = LocalPolynomial().smooth(stripes(path + noise, correlation_rows=length))
    error = smoothed.x_px - path
    assert error.std() < (0.40 if length == 0.0 else 0.62) * STD_PX
    assert np.sqrt((smoothed.x_std_px**2).mean()) / error.std() == pytest.approx(1.0, abs=0.06)
    # Sum of the autocorrelation, seen and said.
    lags = np.arange(1, 40)
    seen = [(error[:, lag:] * error[:, :-lag]).mean() / error.var() for lag in lags[:12]]
    said = np.exp(-(lags**2) / (4 * smoothed.correlation_rows**2))
    assert sum(said) == pytest.approx(sum(seen), rel=0.35)
    assert smoothed.reasons[-1].code == "smoothed"
    assert "9 rows" in smoothed.reasons[-1].text


def test_bows_are_not_cut_short(rng: np.random.Generator) -> None:
    turn = 2.0 * np.pi / 60.0
    bow = 1.0 / 16.0  # px a row²: 1 px over 9 rows
    path = 100.0 + 2.0 * bow / turn**2 * np.sin(turn * ROWS)
    error = LocalPolynomial().smooth(stripes(noisy(path, rng, 40))).x_px - path
    crest = np.sin(turn * ROWS)
    inward = (error * -np.sign(crest))[:, np.abs(crest) > 0.95]
    assert abs(inward.mean()) < 0.02
    plain_line = bow * (np.arange(-4, 5) ** 2).mean()
    assert plain_line > 0.4


@pytest.mark.parametrize(("step_px", "beyond_px"), [(0.6, 0.05), (1.0, 0.02), (5.0, 0.005)])
def test_steps_stay_where_they_are(step_px: float, beyond_px: float, rng: np.random.Generator) -> None:
    path = 100.0 + step_px * (ROWS >= 200)
    smoothed = LocalPolynomial().smooth(stripes(noisy(path, rng, 60)))
    mean = (smoothed.x_px - path).mean(axis=0)
    away = np.abs(ROWS - 199.5) > 1.5
    assert np.abs(mean[away]).max() < beyond_px + 4.0 * 0.4 * STD_PX / np.sqrt(60.0)


def test_nothing_is_carried_from_product_to_belt(rng: np.random.Generator) -> None:
    path = 100.0 + np.where(ROWS >= 200, 0.3 * (ROWS - 200), 0.0)
    given = stripes(noisy(path, rng, 4))
    given = replace(given, product=np.where(ROWS >= 200, 1, 0) * np.ones((4, 1), np.int16))
    other = given.x_px.copy()
    other[:, 200:] += 7.0
    one, two = (LocalPolynomial().smooth(replace(given, x_px=x)) for x in (given.x_px, other))
    assert np.array_equal(one.x_px[:, :200], two.x_px[:, :200])
    assert np.allclose(two.x_px[:, 200:] - one.x_px[:, 200:], 7.0)


def test_a_single_wrong_row_is_taken_back(rng: np.random.Generator) -> None:
    path = 100.0 + 0.1 * ROWS
    x_px = noisy(path, rng, 10)
    x_px[:, 150] += 2.0
    error = LocalPolynomial().smooth(stripes(x_px)).x_px - path
    assert np.abs(error[:, 140:160]).max() < 3.0 * STD_PX


def test_what_was_not_seen_stays_and_says_nothing(rng: np.random.Generator) -> None:
    given = stripes(noisy(100.0 + 0.1 * ROWS, rng, 1))
    seen = given.seen.copy()
    seen[0, 100:103] = False
    bridged = given.x_px.copy()
    bridged[0, 100:103] += 50.0
    smoothed = LocalPolynomial().smooth(replace(given, x_px=bridged, seen=seen))
    assert np.array_equal(smoothed.x_px[0, 100:103], bridged[0, 100:103])
    assert np.abs(smoothed.x_px - given.x_px)[0, [95, 99, 103, 108]].max() < 4.0 * STD_PX


def test_points_that_state_nothing_are_smoothed_and_state_nothing(rng: np.random.Generator) -> None:
    path = 100.0 + 0.1 * ROWS
    given = stripes(noisy(path, rng))
    smoothed = LocalPolynomial().smooth(replace(given, x_std_px=np.full(given.x_px.shape, np.nan)))
    assert (smoothed.x_px - path).std() < 0.45 * STD_PX
    assert np.isnan(smoothed.x_std_px).all()


def test_the_shortest_pieces_stay() -> None:
    x_px = np.full((3, 12), np.nan)
    x_px[1, 4] = 5.0
    x_px[2, [2, 3]] = 5.0, 6.0
    smoothed = LocalPolynomial().smooth(stripes(x_px))
    assert np.array_equal(smoothed.x_px, x_px, equal_nan=True)
    with pytest.raises(ValueError, match="odd"):
        LocalPolynomialOptions(rows=4)
