"""JCGM 101's worked examples, comparisons with reference values, causes that would have to shrink."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Estimate, Measurement
from roemetry_study.study_files import formula, read_model
from roemetry_study.uncertainty import Input, causes, compare, comparison_words, evaluate, shortest_interval


def sum_of(**inputs: np.ndarray) -> np.ndarray:
    return np.sum(list(inputs.values()), axis=0)


def test_additive_model_of_normal_inputs() -> None:
    """JCGM 101, 9.2.2: u = 2.0, interval ± 3.92; JCGM 100 is validated."""
    found = evaluate(sum_of, dict.fromkeys("abcd", Input(0.0, 1.0)), seed=3, draws=400_000)
    assert (found.gum.std, found.gum.high) == pytest.approx((2.0, 3.92), abs=5e-3)
    assert found.monte_carlo.std == pytest.approx(2.0, abs=0.01)
    assert found.monte_carlo.high == pytest.approx(3.92, abs=0.04)


def test_additive_model_of_rectangular_inputs() -> None:
    """JCGM 101, 9.2.3: u = 2.0, interval ± 3.88 where the law of propagation says ± 3.92."""
    inputs = dict.fromkeys("abcd", Input(0.0, shape="rectangular", half=math.sqrt(3.0)))
    found = evaluate(sum_of, inputs, seed=3, draws=400_000)
    assert found.gum.high == pytest.approx(3.92, abs=5e-3)
    assert 0.5 * (found.monte_carlo.high - found.monte_carlo.low) == pytest.approx(3.88, abs=0.015)


def test_mass_calibration() -> None:
    """JCGM 101, 9.3: 1.2340 mg, u 0.0754 mg, [1.0834, 1.3825] mg; the law of propagation says 0.0539 and
    fails.
    """

    def model(m_rc: np.ndarray, dm: np.ndarray, a: np.ndarray, w: np.ndarray, r: np.ndarray) -> np.ndarray:
        return (m_rc + dm) * (1.0 + (a - 1.2) * (1.0 / w - 1.0 / r)) - 1e5

    inputs = {
        "m_rc": Input(1e5, 0.05),
        "dm": Input(1.234, 0.02),
        "a": Input(1.2, shape="rectangular", half=0.1),
        "w": Input(8e3, shape="rectangular", half=1e3),
        "r": Input(8e3, shape="rectangular", half=50.0),
    }
    found = evaluate(model, inputs, seed=3, draws=500_000)
    assert found.gum.std == pytest.approx(0.0539, abs=1e-4)
    assert found.monte_carlo.value == pytest.approx(1.2340, abs=5e-4)
    assert found.monte_carlo.std == pytest.approx(0.0754, abs=3e-4)
    assert (found.monte_carlo.low, found.monte_carlo.high) == pytest.approx((1.0834, 1.3825), abs=4e-3)
    assert not found.validated


@pytest.mark.parametrize(
    ("x1", "value", "std", "high"),
    [(0.0, 50e-6, 50e-6, 150e-6), (0.010, 150e-6, 112e-6, 367e-6), (0.050, 2551e-6, 502e-6, 3543e-6)],
)
def test_comparison_loss(x1: float, value: float, std: float, high: float) -> None:
    """JCGM 101, 9.4.2: x₁² + x₂² with u = 0.005, where the linear law gives zero uncertainty at the
    origin.
    """
    inputs = {"a": Input(x1, 0.005), "b": Input(0.0, 0.005)}
    found = evaluate(lambda a, b: a**2 + b**2, inputs, seed=3, draws=500_000).monte_carlo
    assert found.value == pytest.approx(value, abs=1e-6)
    assert found.std == pytest.approx(std, abs=1e-6)
    assert found.high == pytest.approx(high, abs=8e-6)


@pytest.mark.parametrize("shape", ["rectangular", "triangular", "arcsine", "t"])
def test_draws_have_the_standard_uncertainty_that_is_assigned(shape: str, rng: np.random.Generator) -> None:
    one = Input(3.0, 0.5, shape, half=0.7, freedom=30.0)  # type: ignore[arg-type]
    drawn = one.draw(rng, 200_000)
    expected = 0.5 * math.sqrt(30.0 / 28.0) if shape == "t" else one.standard
    assert float(drawn.std()) == pytest.approx(expected, rel=0.01)
    assert float(drawn.mean()) == pytest.approx(3.0, abs=0.01)


def test_degrees_of_freedom_by_welch_and_satterthwaite() -> None:
    found = evaluate(sum_of, dict.fromkeys("ab", Input(0.0, 1.0, "t", freedom=4.0)), seed=1, draws=1000)
    assert found.freedom == pytest.approx(8.0)


def test_the_shortest_interval_of_an_exponential_begins_at_zero(rng: np.random.Generator) -> None:
    low, high = shortest_interval(rng.exponential(size=100_000))
    assert low == pytest.approx(0.0, abs=0.01)
    assert high == pytest.approx(-math.log(0.05), abs=0.06)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("__import__('os')", "expected"),
        ("a.b + c", "Attribute"),
        ("a + ", "cannot be read"),
        ("a + x", "`x` is no input"),
        ("a", "`c` is not used"),
        ("a + c + 'x'", "Constant"),
        ("sqrt(a, c)", "of one value"),
    ],
)
def test_formulas_are_arithmetic_alone(text: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        formula(text, {"a", "c"}, "m.yaml")


def test_a_model_file_is_read_with_places(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(
        "roemetry_model: 1\nquantity: volume_cm3\nformula: (air_g − water_g) / density\n"
        "inputs:\n  air_g: {value: 20.0, std: 0.01}\n  water_g: {value: 2.0, std: 0.01}\n"
        "  density: {value: 0.998, half: 0.001, shape: rectangular}\n",
        encoding="utf-8",
    )
    file, model = read_model(path)
    found = evaluate(model, {name: one.made() for name, one in file.inputs.items()}, seed=1, draws=10_000)
    assert found.gum.value == pytest.approx(18.0 / 0.998)
    path.write_text(path.read_text("utf-8").replace("half: 0.001, ", ""), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"m\.yaml:7.*needs `half`"):
        read_model(path)


def _row(name: str, mass_g: float, std: float, **budget: float) -> Measurement:
    from roemetry.records import Weight

    half = 1.96 * std
    estimate = Estimate(mass_g, std, budget, (mass_g - half, mass_g + half))
    return Measurement(name, name, 1, "measured", weight=Weight(estimate))


def test_causes_and_what_would_halve_the_whole() -> None:
    std, found = causes([_row("a", 20.0, 5.0, outline=4.0, rim=3.0)], "mass_g")
    assert std == pytest.approx(5.0)
    assert [one.name for one in found] == ["outline", "rim"]
    assert found[0].percent == pytest.approx(64.0)
    assert math.isnan(found[0].to_halve_percent), "even without the outline 3 of 5 remain"
    assert found[1].to_halve_percent == pytest.approx(50.0)
    with pytest.raises(DataError, match="states the parts"):
        causes([_row("a", 20.0, math.nan)], "mass_g")


def test_scores_against_reference_values(rng: np.random.Generator) -> None:
    rows = [_row(f"{k}", 20.0 + rng.normal(0.0, 0.3), 0.3, outline=0.3) for k in range(40)]
    honest = compare(rows, "mass_g", {row.id: (20.0, 0.01) for row in rows})
    assert "confirmed" in comparison_words(honest)[-1]
    assert honest[0].zeta == pytest.approx((honest[0].value - 20.0) / math.hypot(0.3, 0.01))
    expanded = math.hypot(1.96 * 0.3, 0.02)
    assert honest[0].en == pytest.approx(honest[0].zeta * math.hypot(0.3, 0.01) / expanded)
    sure = [_row(f"{k}", 20.5, 0.1, outline=0.1) for k in range(10)]
    bold = compare(sure, "mass_g", {row.id: (20.0, 0.01) for row in sure})
    assert "not confirmed" in comparison_words(bold)[-1]
    with pytest.raises(DataError, match="no product has both"):
        compare(rows, "mass_g", {"other": (1.0, 0.1)})
