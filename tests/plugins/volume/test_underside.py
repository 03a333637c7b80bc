"""From visible to true volume."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from roemetry.testing.solids import HALF_ELLIPSOID, product_of
from roemetry_volume.slice_estimators import SliceOptions, SlicePchip
from roemetry_volume.underside import fitted_share


def estimate(**options):
    return SlicePchip(SliceOptions(**options)).estimate(product_of(HALF_ELLIPSOID))


def test_unknown_states_no_true_volume() -> None:
    assert estimate().true_mm3 is None


def test_flat_is_the_visible_volume() -> None:
    volume = estimate(underside="flat")
    assert volume.true_mm3.value == volume.visible_mm3.value
    assert volume.true_mm3.std == pytest.approx(volume.visible_mm3.std)


def test_rounded_takes_a_share_and_says_how_sure() -> None:
    volume = estimate(underside="rounded", true_share=0.85, true_share_std=0.05)
    assert volume.true_mm3.value == pytest.approx(0.85 * volume.visible_mm3.value)
    assert volume.true_mm3.budget["underside"] == pytest.approx(0.05 * volume.visible_mm3.value)
    drawn = [
        SlicePchip(SliceOptions(underside="rounded", true_share=0.85, true_share_std=0.05))
        .estimate(product_of(HALF_ELLIPSOID), rng=np.random.default_rng(seed))
        .true_mm3.value
        for seed in range(200)
    ]
    assert np.std(drawn) == pytest.approx(volume.true_mm3.std, rel=0.2)


def test_an_air_gap_is_taken_off_over_the_footprint() -> None:
    volume = estimate(underside="air-gap", gap_mm=1.0, gap_std_mm=0.2)
    foot = np.pi / 4.0 * 60.0 * 30.0
    assert volume.visible_mm3.value - volume.true_mm3.value == pytest.approx(foot, rel=0.02)  # mm³


@pytest.mark.parametrize(
    "options",
    [
        {"underside": "rounded"},
        {"underside": "rounded", "true_share": 0.9},
        {"underside": "air-gap", "true_share": 0.9},
        {"true_share": 0.9},
    ],
)
def test_a_model_has_its_own_numbers_and_no_others(options) -> None:
    with pytest.raises(ValidationError, match="needs|belongs to"):
        SliceOptions(**options)


def test_the_share_is_fitted_to_weighed_samples(rng: np.random.Generator) -> None:
    visible = rng.uniform(1e4, 3e4, 400)
    share, std = fitted_share(visible, visible * rng.normal(0.86, 0.03, 400))
    assert share == pytest.approx(0.86, abs=0.006)
    assert std == pytest.approx(0.03, abs=0.004)
    with pytest.raises(ValueError, match="three samples"):
        fitted_share([1.0, 2.0], [1.0, 2.0])


def test_a_gap_under_some_products_widens_the_intervals_of_all(rng: np.random.Generator) -> None:
    """One product in fifteen stands on air: a standard deviation alone would leave those out."""
    gap = rng.random(2000) < 1.0 / 15.0
    true = np.where(gap, rng.normal(0.75, 0.02, 2000), rng.normal(0.92, 0.01, 2000))
    share, std = fitted_share(np.ones(1000), true[:1000])
    assert 0.92 < np.mean(np.abs(true[1000:] - share) < 1.96 * std) < 0.98
