"""The fit and the residuals' expectation against the same algebra written out with whole matrices."""

from __future__ import annotations

import numpy as np
import pytest

from roemetry_peaks.fisher_scoring import CLIPPED, FAILED, FITTED, Gaussians, PeakNoise, fit_peaks
from roemetry_peaks.smoothed_peaks import neighbours
from roemetry_peaks.speckle_noise import CAUSES, residual_products

VARIANCE, GAIN, RHO = 1.1, 0.03, 0.6


def profiles(rng: np.random.Generator, contrast: float, rows: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """One stripe a row, in 16 bit so that rounding does not count, and its (row, 3) centre, height, σ."""
    truth = np.column_stack(
        [rng.uniform(28, 32, rows), rng.uniform(500, 2000, rows), rng.uniform(1.3, 4.0, rows)]
    )
    u = np.arange(60)[None, :] - truth[:, :1]
    m = truth[:, 1:2] * np.exp(-0.5 * (u / truth[:, 2:]) ** 2)
    noise = rng.standard_normal(m.shape) * np.sqrt(VARIANCE + GAIN * (m + 100) + (contrast * m) ** 2)
    return np.rint(m + 100 + noise).astype(np.uint16), truth


def fit(
    image: np.ndarray, start: np.ndarray, contrast: float, rho: float, white: float = 65535.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(peak, 3) fits, (peak,) standard uncertainties, states; the light beside is known."""
    found = fit_peaks(image, white, on_light(start), noise_of(start, contrast, rho))
    return np.column_stack(found[:3]), found.x_std_px, found.state


def on_light(peaks: np.ndarray) -> Gaussians:
    """The (peak, 3) centres, heights, σ, one a row, on light of 100 grey levels."""
    count = len(peaks)
    return Gaussians(np.arange(count), *peaks.T.copy(), np.full(count, 100.0), np.zeros(count))


def noise_of(peaks: np.ndarray, contrast: float, rho: float) -> PeakNoise:
    """The noise that `profiles` draws."""
    return PeakNoise(VARIANCE, GAIN, rho, np.full(len(peaks), contrast**2), np.zeros(len(peaks)))


def jacobian(fitted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of the window, (pixel,) light of the stripe, (pixel, 3) derivatives by centre, height, ln σ."""
    x, a, s = fitted
    at = np.arange(int(np.ceil(x - 3.2 * s)), int(np.floor(x + 3.2 * s)) + 1)
    e = np.exp(-0.5 * ((at - x) / s) ** 2)
    return at, a * e, np.column_stack([a * e * (at - x) / s**2, e, a * e * ((at - x) / s) ** 2])


def markov_weights(m: np.ndarray, contrast: float, rho: float) -> np.ndarray:
    """Inverse covariance of a Markov chain with the right variances and the right neighbours' covariances."""
    v = VARIANCE + GAIN * (m + 100) + (contrast * m) ** 2
    whiten = np.diag(1 / np.sqrt(v))
    for i in range(1, m.size):
        t = rho * contrast**2 * m[i] * m[i - 1] / np.sqrt(v[i] * v[i - 1])
        whiten[i] /= np.sqrt(1 - t * t)
        whiten[i, i - 1] = -t / np.sqrt(v[i - 1]) / np.sqrt(1 - t * t)
    return whiten.T @ whiten


@pytest.mark.parametrize(("contrast", "rho"), [(0.0, 0.0), (0.1, 0.0), (0.1, RHO)])
def test_a_fit_solves_its_equations_and_states_the_variance_they_give(
    contrast: float, rho: float, rng: np.random.Generator
) -> None:
    image, truth = profiles(rng, contrast)
    fitted, std, state = fit(image, truth * [1, 0.8, 1.03] + [0.2, 0, 0], contrast, rho)
    assert (state == FITTED).all()
    steps, ratios = [], []
    for p in range(len(truth)):
        at, m, j = jacobian(fitted[p])
        r = image[p, at] - 100.0 - m
        v = VARIANCE + GAIN * (m + 100) + (contrast * m) ** 2
        if (np.abs(r) > 4.5 * np.sqrt(v)).any():
            continue  # left out or not: the fit asks with the model before the last step
        w = markov_weights(m, contrast, rho)
        normal = j.T @ w @ j
        step = np.linalg.solve(normal, j.T @ w @ r)
        lag = np.abs(at[:, None] - at)
        grains = np.where(lag < 5, rho ** (lag.astype(float) ** 2), 0.0) if rho else np.eye(at.size)
        whole = contrast**2 * np.outer(m, m) * grains + np.diag(VARIANCE + GAIN * (m + 100))
        q = np.linalg.solve(normal, j.T @ w)[0]
        expected = np.sqrt(q @ whole @ q)
        steps.append(abs(step[0]) / expected)
        ratios.append(std[p] / expected)
    assert len(steps) > 30
    # Where the window, which is that of some steps before, differs by a pixel at its end, so does the result.
    assert np.median(steps) < 0.01
    assert max(steps) < 0.3
    assert np.median(ratios) == pytest.approx(1.0, abs=2e-3)
    assert np.abs(np.subtract(ratios, 1.0)).max() < 0.05


def test_saturated_pixels_are_left_out(rng: np.random.Generator) -> None:
    image, truth = profiles(rng, 0.0)
    white = 600
    fitted, _, state = fit(np.minimum(image, white), truth, 0.0, 0.0, white)
    clipped = (image >= white).any(axis=1)
    assert (state[clipped] == CLIPPED).all()
    assert (state[~clipped] == FITTED).all()
    assert np.abs(fitted[:, 0] - truth[:, 0]).max() < 0.1


def test_a_start_without_pixels_fails_and_others_do_not(rng: np.random.Generator) -> None:
    image, truth = profiles(rng, 0.0)
    truth[3, 0], truth[5, 0] = 500.0, -80.0
    _, _, state = fit(image, truth, 0.0, 0.0)
    assert (state[[3, 5]] == FAILED).all()
    assert (np.delete(state, [3, 5]) == FITTED).all()


def test_expected_products_are_those_of_whole_matrices(rng: np.random.Generator) -> None:
    contrast = 0.1
    image, truth = profiles(rng, contrast, 6)
    fitted, _, state = fit(image, truth, contrast, 0.0)
    known = noise_of(fitted, contrast, 0.0)
    products = residual_products(image, 65535.0, on_light(fitted), known, state)
    for p in range(6):
        at, m, j = jacobian(fitted[p])
        mu, r = m + 100, image[p, at] - 100.0 - m
        w = np.diag(1 / (VARIANCE + GAIN * mu + (contrast * m) ** 2))
        left = np.eye(at.size) - j @ np.linalg.solve(j.T @ w @ j, j.T @ w)
        lag = np.abs(at[:, None] - at)
        causes = [np.eye(at.size), np.diag(mu), np.diag(m**2)]
        causes += [np.outer(m, m) * (lag == n) for n in (1, 2, 3)]
        square = np.diag(w) ** 2
        kinds = [np.diag(square), np.diag(square * mu), np.diag(square * m**2)]
        kinds += [np.diag((np.diag(w) * m)[:-1] * (np.diag(w) * m)[1:], 1)]
        assert len(causes) == CAUSES
        for kind, weights in enumerate(kinds):
            assert products[p, kind, 0] == pytest.approx((weights * np.outer(r, r)).sum(), rel=1e-9)
            for cause, v in enumerate(causes):
                expected = (weights * (left @ v @ left.T)).sum()
                scale = (np.abs(weights) * np.abs(v)).sum() + (np.diag(weights) * np.diag(v)).sum() + 1e-300
                assert products[p, kind, 1 + cause] == pytest.approx(expected, rel=1e-7, abs=1e-9 * scale)


def test_links_are_the_nearest_both_ways(rng: np.random.Generator) -> None:
    row = np.sort(rng.integers(0, 30, 300))
    x_px = rng.uniform(0, 60, 300)
    order = np.lexsort((x_px, row))
    row, x_px = row[order], x_px[order]
    up, down = neighbours(row, x_px)
    for p in range(300):
        if down[p] >= 0:
            assert up[down[p]] == p
            assert row[down[p]] == row[p] + 1
        below = np.flatnonzero(row == row[p] + 1)
        if not below.size:
            assert down[p] == -1
            continue
        nearest = below[np.abs(x_px[below] - x_px[p]).argmin()]
        back = np.flatnonzero(row == row[p])
        mutual = back[np.abs(x_px[back] - x_px[nearest]).argmin()] == p
        if mutual and abs(x_px[nearest] - x_px[p]) < 3.0:
            assert down[p] == nearest
