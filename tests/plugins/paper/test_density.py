"""Mass from volume, with the arithmetic of the paper's Table 1."""

import math

import numpy as np
import pytest

from roemetry.records import Estimate, Product, Profiles, Shares, Volume
from roemetry.records.calibration import Calibration
from roemetry_paper.density import Density, DensityOptions

# Table 1: volume as printed (headed mm³, cm³ by its own arithmetic), estimated weight (g).
TABLE_1 = {
    "good": (20.64, 22.7),
    "henkei 1": (24.07, 26.5),
    "henkei 2": (34.13, 37.5),
    "henkei 3": (32.81, 36.2),
    "henkei 4": (25.96, 28.6),
}


@pytest.fixture
def product():
    nothing, no_slices = [np.empty((0, 0))] * 5, np.empty(0)
    profiles = Profiles(np.empty((0, 0, 3)), *nothing, no_slices, no_slices, np.empty((0, 4)))
    calibration = Calibration(
        "test", (480, 640), 0, np.empty((0, 1)), np.empty(0), (0.0, 30.0), {}, np.zeros((0, 0))
    )
    return Product(1, profiles, calibration, ("a",))


def volume_of(visible, true=None):
    return Volume(visible, true, Shares(1.0, 0.0, 0.0))


def weigh(product, volume, rng=None, **options):
    return Density(DensityOptions(**options)).weigh(product, volume, rng=rng)


@pytest.mark.parametrize("sample", TABLE_1)
def test_table_1(product, sample):
    """The print rounds to 0.1 g. Henkei 3 is a slip of the print: 32.81 · 1.1 = 36.09, not 36.2."""
    printed, weight_g = TABLE_1[sample]
    mass_g = weigh(product, volume_of(Estimate(printed * 1000.0))).mass_g.value
    assert round(mass_g, 1) == (36.1 if sample == "henkei 3" else weight_g)


def test_the_true_volume_is_taken_or_the_visible_one_and_that_is_told(product):
    visible = weigh(product, volume_of(Estimate(20_000.0)))
    assert visible.mass_g.value == pytest.approx(22.0, abs=1e-12)  # g
    assert [reason.code for reason in visible.reasons] == ["visible-taken-for-true"]
    true = weigh(product, volume_of(Estimate(20_000.0), Estimate(18_000.0)), density_g_per_cm3=1.0)
    assert true.mass_g.value == pytest.approx(18.0, abs=1e-12)  # g
    assert true.reasons == ()


def test_uncertainties_are_combined_by_cause(product):
    """1.1 · 0.6 = 0.66 g from the volume, or of its own causes, 20 · 0.02 = 0.4 g from the density."""
    mass_g = weigh(product, volume_of(Estimate(20_000.0, 600.0)), density_std_g_per_cm3=0.02).mass_g
    assert mass_g.budget == pytest.approx({"volume": 0.66, "density": 0.4}, abs=1e-12)  # g
    assert mass_g.std == pytest.approx(math.hypot(0.66, 0.4), abs=1e-12)  # g
    volume = volume_of(Estimate(20_000.0, 500.0, {"peaks": 300.0, "calibration": 400.0}))
    budget = weigh(product, volume, density_std_g_per_cm3=0.02).mass_g.budget
    assert budget == pytest.approx({"peaks": 0.33, "calibration": 0.44, "density": 0.4}, abs=1e-12)  # g


def test_what_is_not_known_is_not_stated(product):
    for std, density_std in ((math.nan, 0.02), (600.0, None), (math.nan, None)):
        mass_g = weigh(product, volume_of(Estimate(20_000.0, std)), density_std_g_per_cm3=density_std).mass_g
        assert math.isnan(mass_g.std)
        assert mass_g.budget == {}


def test_draws_scatter_by_the_densitys_uncertainty(product):
    rng = np.random.default_rng(7)
    volume = volume_of(Estimate(20_000.0))
    draws = [weigh(product, volume, rng, density_std_g_per_cm3=0.02).mass_g.value for _ in range(4000)]
    assert np.mean(draws) == pytest.approx(22.0, abs=0.03)  # g: 4.7 standard errors
    assert np.std(draws) == pytest.approx(0.4, abs=0.02)  # g
    still = [weigh(product, volume, rng).mass_g.value for _ in range(3)]
    assert still == pytest.approx([22.0] * 3, abs=1e-12)  # g
