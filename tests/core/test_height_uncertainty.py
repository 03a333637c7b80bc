"""The largest height's uncertainty: against a closed form, and against the scatter of noisy repeats."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from roemetry.records import Estimate, ProductTrace
from roemetry.run.monte_carlo import Chain, Scene, propagate
from roemetry.run.open_parts import split_products
from roemetry.testing.scenes import LinearRig
from roemetry_paper.block_linear import BlockLinear

RIG = LinearRig()
TRIANGULATOR = BlockLinear()
OMEGA_RELATIVE = 0.01
STD_PX = 0.2


def drawn(noise_px: np.ndarray | float, std_px: float, omega_relative: float, draws: int) -> Estimate:
    """Put noise on the stripes of a dome, and draw the largest height's uncertainty."""
    exact = RIG.calibration()
    omega = exact.parameters["omega_mm_per_px"]
    covariance = np.zeros_like(exact.covariance)
    covariance[: omega.size, : omega.size] = omega_relative**2 * np.outer(omega, omega)
    calibration = replace(exact, covariance=covariance)
    stripes = RIG.stripe_map(RIG.dome())
    stripes = replace(
        stripes,
        x_px=np.where(stripes.seen, stripes.x_px + noise_px, stripes.x_px),
        x_std_px=np.where(stripes.seen, std_px, np.nan),
    )
    profiles = TRIANGULATOR.triangulate(stripes, calibration)
    (product,) = split_products(profiles, (), calibration, "a")
    chain = Chain(TRIANGULATOR, None, None, None)
    found = ProductTrace(product, None, None, None)
    (traced,) = propagate((found,), Scene("a", stripes, (), calibration), chain, draws=draws)
    assert traced.height_max_mm is not None
    return traced.height_max_mm


def test_a_scale_in_common_moves_it_in_proportion() -> None:
    height = drawn(0.0, 1e-9, OMEGA_RELATIVE, draws=1000)
    assert height.std == pytest.approx(OMEGA_RELATIVE * height.value, rel=0.1)
    assert height.budget["calibration"] == pytest.approx(height.std, rel=0.15)
    assert height.budget["peak noise"] < 1e-6 * height.value
    low, high = height.interval
    assert high - height.value == pytest.approx(height.value - low, abs=1e-9)  # mm


def test_a_cause_that_does_not_touch_it_is_not_in_its_budget() -> None:
    height = drawn(0.0, STD_PX, 0.0, draws=60)
    assert set(height.budget) == {"peak noise"}


def test_its_interval_holds_the_true_height_though_noise_lifts_the_largest(rng: np.random.Generator) -> None:
    true_mm = drawn(0.0, STD_PX, 0.0, draws=2).value
    shape = RIG.stripe_map(RIG.dome()).x_px.shape
    found = [drawn(rng.normal(0.0, STD_PX, shape), STD_PX, 0.0, draws=50) for _ in range(100)]
    off_mm = np.array([height.value - true_mm for height in found])
    assert off_mm.mean() > 2 * off_mm.std() / math.sqrt(off_mm.size), (
        "noise lifts the largest of many heights"
    )
    held = sum(height.interval[0] < true_mm < height.interval[1] for height in found)
    assert held >= 90
    rms_mm = math.sqrt(float(np.mean(off_mm**2)))
    assert np.median([height.std for height in found]) == pytest.approx(rms_mm, rel=0.35)


def test_without_the_peaks_uncertainty_only_the_budget_says_what_is_known() -> None:
    height = drawn(0.0, math.nan, OMEGA_RELATIVE, draws=200)
    assert math.isnan(height.std)
    assert math.isnan(height.interval[0])
    assert set(height.budget) == {"calibration"}
