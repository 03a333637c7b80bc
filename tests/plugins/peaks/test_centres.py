"""The centres of drawn stripes, smoothed or not: scatter against the bound, bias, hard cases."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from roemetry.errors import StageError
from roemetry.records import NOTHING, SATURATED, Frame, StripeMap
from roemetry_peaks.centre_of_gravity import CentreOfGravity, CentreOfGravityOptions
from roemetry_peaks.gaussian import Gaussian, GaussianOptions
from roemetry_peaks.local_polynomial import LocalPolynomial, LocalPolynomialOptions
from roemetry_peaks.log_parabola import LogParabola, LogParabolaOptions
from roemetry_peaks.zero_crossing import ZeroCrossing, ZeroCrossingOptions
from tests.plugins.peaks.drawing import GAIN, READ, SENSOR, errors_px, exposed, integrated, rms, speckled

COLUMNS, MIDDLE = 64, 31.5

MADE = {
    "three": lambda **more: LogParabola(LogParabolaOptions(points="three", **more)),
    "five": lambda **more: LogParabola(LogParabolaOptions(**more)),
    "gravity": lambda **more: CentreOfGravity(CentreOfGravityOptions(**more)),
    "gaussian": lambda **more: Gaussian(GaussianOptions(**more)),
    "crossing": lambda **more: ZeroCrossing(ZeroCrossingOptions(**more)),
}
BIAS_PX = {"three": 0.003, "five": 0.003, "gravity": 0.003, "gaussian": 0.003, "crossing": 0.009}
"""The zero crossing is put on a straight line between two pixels; the derivative is not quite one."""

every = pytest.mark.parametrize("name", MADE)


def profile(centre, sigma, amplitude):
    """(row, column) light of one stripe a row."""
    return integrated(centre, sigma, amplitude, COLUMNS)


def drawn(rng, rows):
    """Draw rows of one stripe each with noise; centres, widths, heights, background beside it."""
    centre = MIDDLE + rng.uniform(-2.0, 2.0, rows)
    sigma, amplitude = rng.uniform(1.5, 3.0, rows), rng.uniform(60.0, 220.0, rows)
    background = 10.0 + 0.1 * np.arange(COLUMNS)
    return centre, sigma, amplitude, exposed(profile(centre, sigma, amplitude) + background, rng)


def bound_px(sigma, amplitude):
    """Cramér-Rao bound of centres: centre, height, width, background and its slope unknown."""
    off = np.arange(-24, 25)
    parts = []
    for s, a in zip(sigma, amplitude, strict=True):
        g = np.exp(-0.5 * (off / s) ** 2)
        level = a * g + 13.0
        jacobian = np.stack(
            [a * g * off / s**2, g, a * g * off**2 / s**3, np.ones_like(g), off.astype(float)], axis=1
        )
        weight = 1.0 / (GAIN * level + READ**2 + 1.0 / 12.0)
        parts.append(np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian))[0, 0])
    return np.sqrt(parts)


def frame(pixels):
    return Frame(pixels, sensor=SENSOR)


@pytest.mark.parametrize(
    ("name", "most"),
    [("gaussian", 1.06), ("gravity", 1.35), ("crossing", 1.2), ("five", 2.0), ("three", 5.0)],
)
def test_scatter_is_near_the_bound_and_as_stated(name, most, rng):
    centre, sigma, amplitude, pixels = drawn(rng, 20_000)
    # These rows are drawn apart: what one says of the next is nothing to tell speckle from.
    peaks = MADE[name](speckle_contrast=0.0).extract(frame(pixels))
    assert peaks.row.tolist() == list(range(20_000)), "one peak in each row"
    error, stated = peaks.x_px - centre, peaks.x_std_px
    every_tenth = slice(None, None, 10)
    bound = np.sqrt(np.mean(bound_px(sigma[every_tenth], amplitude[every_tenth]) ** 2))
    assert np.sqrt(np.mean(error**2)) <= most * bound
    for by in (amplitude, sigma):
        for fifth in np.array_split(np.argsort(by), 5):
            ratio = np.sqrt(np.mean(stated[fifth] ** 2) / np.mean(error[fifth] ** 2))
            assert 0.9 <= ratio <= 1.1


@every
def test_there_is_no_bias_at_any_phase_height_or_width(name, rng):
    extractor, rows = MADE[name](), 4_000
    for sigma in (1.5, 2.2, 3.0):
        for amplitude in (60.0, 200.0):
            centre = MIDDLE + np.tile(np.arange(10) / 10.0, rows // 10)
            level = profile(centre, sigma, amplitude) + 15.0
            error = extractor.extract(frame(exposed(level, rng))).x_px - centre
            by_phase = error.reshape(-1, 10)
            unsure = by_phase.std(axis=0).max() / math.sqrt(rows / 10)
            assert np.abs(by_phase.mean(axis=0)).max() <= BIAS_PX[name] + 3.5 * unsure


def bent(contrast, rng, *, rows=960, stripes=6):
    """Draw bent stripes with breaks, and their centres by (stripe, row)."""
    row = np.arange(rows)
    phase = rng.uniform(0.0, 6.0, (stripes, 1))
    centre = 40.3 + 60.0 * np.arange(stripes)[:, None] + 8.0 * np.sin(row / 40.0 + phase)
    light = np.zeros((rows, 60 * stripes + 20))
    for k in range(stripes):
        light += integrated(centre[k], rng.uniform(1.6, 2.8), rng.uniform(70.0, 170.0), light.shape[1])
    light[::97] = 0.0
    lit = speckled(light, contrast, rng) if contrast else light
    return centre, exposed(lit + 15.0, rng)


@every
@pytest.mark.parametrize("contrast", [0.0, 0.1, 0.25])
def test_the_contrast_is_found_and_stated(name, contrast, rng):
    centre, pixels = bent(contrast, rng)
    peaks = MADE[name]().extract(frame(pixels))
    assert 0.9 <= rms(peaks.x_std_px) / rms(errors_px(peaks, centre)) <= 1.1
    assert (peaks.correlation_rows > 0.0) == (contrast > 0.0)


@pytest.mark.parametrize("name", ["gaussian", "gravity", "crossing"])
def test_speckle_that_is_told_is_in_what_is_stated(name, rng):
    centre = MIDDLE + rng.uniform(-2.0, 2.0, 12_000)
    pixels = exposed(speckled(profile(centre, 2.2, 150.0), 0.15, rng) + 15.0, rng)
    peaks = MADE[name](speckle_contrast=0.15).extract(frame(pixels))
    assert peaks.row.size == 12_000
    assert 0.9 <= rms(peaks.x_std_px) / rms(peaks.x_px - centre) <= 1.1


def test_finding_the_contrast_makes_the_gaussian_better(rng):
    centre, pixels = bent(0.15, rng)

    def error(**told):
        return rms(errors_px(MADE["gaussian"](**told).extract(frame(pixels)), centre))

    assert error() < 0.8 * error(speckle_contrast=0.0)
    assert error() < 1.02 * error(speckle_contrast=0.15)


@every
def test_a_clipped_stripe_is_where_its_flanks_say(name, rng):
    centre = MIDDLE + rng.uniform(-1.0, 1.0, 1_000)
    pixels = exposed(profile(centre, 2.5, 900.0) + 12.0, rng)
    peaks = MADE[name]().extract(frame(pixels))
    assert (peaks.flags & SATURATED).all()
    assert np.abs(peaks.x_px - centre).max() < 0.2  # px
    assert np.sqrt(np.mean((peaks.x_px - centre) ** 2)) < 0.05  # px


@every
def test_a_sloping_background_does_not_pull(name):
    centre = MIDDLE + np.arange(20) / 20.0
    level = profile(centre, 2.2, 120.0) + 40.0 + 0.8 * (np.arange(COLUMNS) - MIDDLE)
    error = MADE[name]().extract(frame(exposed(level))).x_px - centre
    assert abs(error.mean()) < 0.01  # px


@every
def test_spikes_and_glare_are_left_out(name, rng):
    level = np.full((40, 320), 20.0)
    level[::2, 50] = 200.0  # one pixel
    level += 150.0 * np.exp(-0.5 * ((np.arange(320) - 200) / 25.0) ** 2)  # 59 px wide
    assert len(MADE[name]().extract(frame(exposed(level, rng)))) == 0
    wide = MADE[name](width_max_px=80.0, threshold=60.0).extract(frame(exposed(level)))
    assert len(wide) == 40
    assert wide.width_px == pytest.approx(np.full(40, 58.9), abs=3.0)  # px


@every
def test_a_rough_stripe_is_one_and_two_stripes_are_two(name):
    rough = np.array([[20] * 20 + [30, 80, 180, 140, 190, 90, 30] + [20] * 20] * 5, np.uint8)
    assert len(MADE[name]().extract(frame(rough))) == 5
    centre = np.full(30, 30.3)
    two = profile(centre, 1.6, 150.0) + profile(centre + 9.0, 1.6, 90.0) + 20.0
    peaks = MADE[name]().extract(frame(exposed(two)))
    assert len(peaks) == 60
    assert np.abs(peaks.x_px[::2] - 30.3).max() < 0.06  # px
    assert np.abs(peaks.x_px[1::2] - 39.3).max() < 0.06  # px


@every
def test_what_is_found_in_a_region_is_what_is_found_in_all(name, rng):
    _, _, _, pixels = drawn(rng, 60)
    pixels = np.hstack([pixels, pixels])
    told = {"threshold": 25.0, "speckle_contrast": 0.0}
    whole = MADE[name](**told).extract(frame(pixels))
    part = MADE[name](**told, region=(10, 50, 64, 128)).extract(frame(pixels))
    mine = (whole.row >= 10) & (whole.row < 50) & (whole.x_px > 64)
    np.testing.assert_array_equal(part.row, whole.row[mine])
    np.testing.assert_allclose(part.x_px, whole.x_px[mine], atol=0.02)  # px: the background ends elsewhere
    with pytest.raises(StageError, match="does not lie within the image"):
        MADE[name](region=(0, 10, 0, 900)).extract(frame(pixels))


def test_speckle_of_neighbouring_rows_is_alike_and_other_errors_are_independent():
    image = frame(exposed(profile(np.full(9, MIDDLE), 2.0, 150.0) + 15.0))
    told = {"speckle_contrast": 0.2, "speckle_length_px": 1.1}
    assert MADE["gaussian"](**told).extract(image).correlation_rows == pytest.approx(1.1)
    assert MADE["gaussian"]().extract(image).correlation_rows == 0.0


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
