"""Gauge studies: published worked examples to the digits printed, statsmodels as oracle, intervals that
hold.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roemetry.errors import ConfigurationError, DataError
from roemetry_study.gauge import gauge_study, samples_for_mean, simulated
from roemetry_study.table import Reading, StudyTable, read_table
from roemetry_study.variance import analyse, average_range, range_constants

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def aiag() -> StudyTable:
    return read_table([HERE / "aiag.csv"], "deviation_mm")


def test_analysis_of_variance_of_the_aiag_study(aiag: StudyTable) -> None:
    found = analyse(aiag)
    squares = {effect.name: effect.squares for effect in found.effects}
    assert squares["part"] == pytest.approx(88.3619, abs=5e-5)
    assert squares["operator"] == pytest.approx(3.16726, abs=5e-6)
    assert squares["interaction"] == pytest.approx(0.35898, abs=5e-6)
    assert squares["repeatability"] == pytest.approx(2.75893, abs=5e-6)
    inner = next(effect for effect in found.effects if effect.name == "interaction")
    assert (round(inner.f, 4), round(inner.p, 3)) == (0.4337, 0.974)
    assert found.pooled
    expected = {"repeatability": 0.199933, "operator": 0.226838, "part": 1.042327, "total": 1.0853}
    for name, value in expected.items():
        assert found.std[name] == pytest.approx(value, abs=5e-7 if name != "total" else 5e-5)
    assert found.std["gauge"] == pytest.approx(0.302372, abs=1e-6)
    study = gauge_study(aiag)
    assert (round(study.gauge_percent, 2), study.categories, study.verdict) == (27.86, 4, "conditional")


def test_average_and_range_of_the_aiag_study(aiag: StudyTable) -> None:
    found = average_range(aiag).std
    expected = {"repeatability": 0.20186, "operator": 0.22967, "gauge": 0.30577, "part": 1.10460}
    for name, value in {**expected, "total": 1.14613}.items():
        assert found[name] == pytest.approx(value, abs=1e-5), name
    study = gauge_study(aiag, method="average-range")
    assert (round(study.gauge_percent, 2), study.categories) == (26.68, 5)
    assert math.isnan(study.gauge_percent_interval[0])


def test_constants_of_ranges_are_those_of_the_tables() -> None:
    for size, mean, std in ((2, 1.128, 0.853), (3, 1.693, 0.888), (10, 3.078, 0.797)):
        assert range_constants(size) == pytest.approx((mean, std), abs=5e-4)


def test_a_significant_interaction_is_kept() -> None:
    """Montgomery's thermal impedance: 10 parts, 3 operators, 3 trials."""
    table = read_table([HERE / "impedance.csv"], "impedance")
    found = analyse(table)
    assert not found.pooled
    squares = {effect.name: round(effect.squares, 2) for effect in found.effects}
    assert squares == {"part": 3935.96, "operator": 39.27, "interaction": 48.51, "repeatability": 30.67}
    variances = {name: round(std**2, 2) for name, std in found.std.items()}
    assert (variances["part"], variances["operator"]) == (48.29, 0.56)
    assert (variances["interaction"], variances["repeatability"]) == (0.73, 0.51)


def test_restricted_maximum_likelihood_agrees_where_no_component_is_clipped(aiag: StudyTable) -> None:
    import pandas
    import statsmodels.formula.api as formulas

    frame = pandas.DataFrame(
        [(r.operator, r.part, float(r.value)) for r in aiag.readings], columns=["of", "part", "y"]
    )
    frame["one"] = 1
    model = formulas.mixedlm(
        "y ~ 1", frame, groups="one", re_formula="0", vc_formula={"of": "0 + C(of)", "part": "0 + C(part)"}
    ).fit(reml=True)
    found = analyse(aiag).std
    assert found["repeatability"] == pytest.approx(math.sqrt(model.scale), abs=1e-4)
    oracle = dict(zip(model.model.exog_vc.names, np.sqrt(model.vcomp), strict=True))
    assert found["operator"] == pytest.approx(oracle["of"], abs=1e-4)
    assert found["part"] == pytest.approx(oracle["part"], abs=1e-4)


def test_units_and_origin_change_nothing_but_the_unit(rng: np.random.Generator) -> None:
    table = simulated(rng, (6, 3, 2), 3.0, 0.5, 0.4, 0.3)
    readings = (replace(r, value=repr(1000.0 * (float(r.value) + 7.0))) for r in table.readings)
    moved = replace(table, readings=tuple(readings))
    one, other = analyse(table).std, analyse(moved).std
    for name, std in one.items():
        assert other[name] == pytest.approx(1000.0 * std, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("gaps", [0.0, 0.12])
def test_intervals_hold_what_they_promise(gaps: float) -> None:
    """Of 150 studies 95 % are 142.5 ± 2.7, so within four of these."""
    true = {"part": 5.0, "operator": 1.0, "interaction": 0.7, "repeatability": 1.0}
    true["gauge"] = math.sqrt(1.0 + 0.49 + 1.0)
    held = dict.fromkeys(true, 0)
    for seed in range(150):
        own = np.random.default_rng([seed, 90])
        table = simulated(own, (8, 3, 2), 5.0, 1.0, 1.0, 0.7)
        table = replace(table, readings=tuple(r for r in table.readings if own.random() >= gaps))
        found = analyse(table)
        for name, value in true.items():
            low, high = found.interval(lambda draws, of=name: draws[of])
            held[name] += low <= value <= high
    assert all(132 <= count <= 150 for count in held.values()), held


def test_nested_parts_belong_to_their_operator(rng: np.random.Generator) -> None:
    readings = []
    for operator in "ABC":
        for part in range(20):
            level = 10.0 * (operator == "B") + rng.normal(0.0, 2.0)
            for trial in range(2):
                value = repr(level + rng.normal(0.0, 0.5))
                readings.append(Reading(f"{part}", operator, f"{trial}", value, f"{operator}{part}"))
    own = tuple(replace(r, part=f"{r.operator}{r.part}") for r in readings)
    found = analyse(StudyTable(own, "v", "t"), nested=True).std
    assert found["part"] == pytest.approx(2.0, abs=0.6)
    assert found["repeatability"] == pytest.approx(0.5, abs=0.12)
    assert found["interaction"] == 0.0
    with pytest.raises(DataError, match="crossed, not nested"):
        analyse(StudyTable(tuple(readings), "v", "t"), nested=True)


def _table(cells: dict[tuple[str, str], list[float]]) -> StudyTable:
    readings = [
        Reading(part, operator, f"{k}", repr(value), "t:1")
        for (part, operator), values in cells.items()
        for k, value in enumerate(values)
    ]
    return StudyTable(tuple(readings), "mass_g", "t.csv")


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ({("1", "A"): [1.0, 1.1, 1.2]}, "one part"),
        ({("1", "A"): [1.0], ("2", "A"): [2.0]}, "no part was measured twice"),
        ({("1", "A"): [1.0, 1.0], ("2", "A"): [1.0, 1.0]}, "no variation"),
        ({("1", "A"): [1.0, 1.0], ("2", "A"): [2.0, 2.0]}, "below the resolution"),
        ({("1", "A"): [1.0, 1.1], ("2", "B"): [2.0, 2.3]}, "cannot be told from the other effects"),
    ],
)
def test_what_no_variance_can_be_found_of_is_refused(
    cells: dict[tuple[str, str], list[float]], said: str
) -> None:
    with pytest.raises(DataError, match=said):
        analyse(_table(cells))
    with pytest.raises(DataError, match="equally often"):
        average_range(_table({("1", "A"): [1.0, 1.1], ("2", "A"): [2.0, 2.1, 2.2]}))


def test_what_limits_a_study_is_said_beside_it() -> None:
    table = _table({("1", "A"): [1.0, 1.1], ("2", "A"): [2.0, 2.1]})
    found = gauge_study(table)
    assert any("one operator" in words for words in found.words)
    assert any("2 parts" in words for words in found.words)
    assert "reproducibility" not in {line.name for line in found.lines}
    small = replace(table, readings=tuple(replace(r, std=0.01) for r in table.readings))
    assert any("does not repeat as well as it states" in words for words in gauge_study(small).words)


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("part,mass_g\n1,1.0\n1,x\n", DataError, "expected a number"),
        ("part\n1\n", ConfigurationError, "no column `mass_g`"),
        ("part,operator,trial,mass_g\n1,A,1,1.0\n1,A,1,1.1\n", DataError, "stands at"),
        ("part,trial,mass_g,image_sha256\n1,1,1.0,ab\n1,2,1.1,ab\n", DataError, "is the same file"),
        (
            "part,operator,trial,mass_g\n1,A,1,20.0\n1,B,1,0.7\n1,A,2,20.0\n1,B,2,0.7\n",
            DataError,
            "not in one unit",
        ),
        ("part,mass_g\n1,1.0,7\n", DataError, "another number of cells"),
        ("part,mass_g\n", DataError, "the table is empty"),
    ],
)
def test_tables_without_sense_are_refused_with_their_place(
    text: str, error: type[Exception], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(error, match=said) as caught:
        read_table([path], "mass_g").numbers()
    assert "t.csv" in str(caught.value)


def test_samples_that_fix_a_mean() -> None:
    """t(0.975, 17) · 1 / √18 = 0.4973 and t(0.975, 16) · 1 / √17 = 0.5142."""
    assert samples_for_mean(1.0, 0.5) == 18
