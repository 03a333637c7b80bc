"""Kappa against hand-worked values, shares by parts, intervals that hold; bias, linearity, type 1, control
rules.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from roemetry.errors import DataError
from roemetry.run.control_chart import limits_of, signals
from roemetry_study.agreement import agreement
from roemetry_study.reference import biases, catchweigher_words, linearity, type_one
from roemetry_study.table import Reading, StudyTable


def _classes(rows: list[tuple[str, str, str, str]]) -> StudyTable:
    """Part, operator, value, reference."""
    return StudyTable(
        tuple(Reading(p, o, f"{k}", v, "t", r) for k, (p, o, v, r) in enumerate(rows)), "grade", "t"
    )


def test_cohens_kappa_of_a_table_worked_by_hand() -> None:
    """20 both good, 15 both bad, 5 and 10 apart: agreed 0.7, by chance 0.5, kappa 0.4."""
    said = [("good", "good")] * 20 + [("bad", "bad")] * 15 + [("good", "bad")] * 5 + [("bad", "good")] * 10
    rows = []
    for k, (one, other) in enumerate(said):
        rows += [(f"{k}", "A", one, ""), (f"{k}", "B", other, "")]
    found = agreement(_classes(rows), "good")
    assert found.pairs[0][2].value == pytest.approx(0.4)
    low, high = found.pairs[0][2].low, found.pairs[0][2].high
    # asymptotic standard error of Fleiss, Cohen and Everitt: 0.1268
    assert high - low == pytest.approx(2.0 * 2.01 * 0.1268, rel=0.06)


def test_misses_and_false_alarms_are_counted_against_the_reference() -> None:
    rows = []
    for k in range(20):
        true = "good" if k < 12 else "dent"
        for trial in range(2):
            said = "good" if k in (12, 13) or (k < 12 and k != 0) else "dent"
            said = "dent" if k == 1 and trial else said
            rows.append((f"{k}", "A", said, true))
    (one,) = agreement(_classes(rows), "good").operators
    assert one.missed.value == pytest.approx(4 / 16)
    assert one.false_alarm.value == pytest.approx(3 / 24)
    assert one.repeats.value == pytest.approx(19 / 20)
    assert one.bias == pytest.approx(25 / 24 - 1.0)
    # two readings of a part are worth hardly more than one
    assert one.missed.high - one.missed.low > 0.5


@pytest.mark.thorough
def test_intervals_of_agreement_hold(rng: np.random.Generator) -> None:
    """150 studies of 60 parts, two readings each that hang together: 95 % are 142.5 ± 2.7, within four of
    these.
    """
    held = {"missed": 0, "kappa": 0}
    hard, easy = 0.4, 0.04  # every fifth part is hard: its readings are wrong together
    true = 0.2 * hard + 0.8 * easy
    kappa = 1.0 - 2.0 * true  # both classes as often
    for _ in range(150):
        rows = []
        for k in range(60):
            truth = "good" if k % 2 else "bad"
            chance = hard if rng.random() < 0.2 else easy
            rows += [
                (f"{k}", "A", truth if rng.random() >= chance else ("bad" if k % 2 else "good"), truth)
                for _ in range(2)
            ]
        (one,) = agreement(_classes(rows), "good").operators
        held["missed"] += one.missed.low <= true <= one.missed.high
        held["kappa"] += one.kappa.low <= kappa <= one.kappa.high
    assert all(count >= 132 for count in held.values()), held


def test_one_class_throughout_is_refused() -> None:
    with pytest.raises(DataError, match="agreement beyond chance has no meaning"):
        agreement(_classes([(f"{k}", "A", "good", "good") for k in range(12)]), "good")
    with pytest.raises(DataError, match="2 parts, expected 10"):
        agreement(_classes([("1", "A", "good", ""), ("2", "A", "bad", "")]), "good")


def _numbers(values: dict[float, list[float]]) -> StudyTable:
    readings = [
        Reading(f"{reference:g}", "–", f"{k}", repr(value), "t", repr(reference))
        for reference, many in values.items()
        for k, value in enumerate(many)
    ]
    return StudyTable(tuple(readings), "mass_g", "t.csv")


def test_bias_and_linearity_of_a_line() -> None:
    exact = _numbers({x: [1.02 * x - 0.1 + off for off in (0, 1e-6, -1e-6)] for x in (2.0, 5.0, 10.0)})
    line = linearity(exact)
    assert line is not None
    assert (line.slope, line.intercept) == pytest.approx((0.02, -0.1), abs=1e-6)
    assert line.largest == pytest.approx(0.1, abs=1e-6)
    assert line.significant
    assert [one.bias for one in biases(exact)] == pytest.approx([-0.06, 0.0, 0.1], abs=1e-6)
    assert linearity(_numbers({2.0: [2.0, 2.1], 3.0: [3.0, 3.1]})) is None


def test_type_one_figures_worked_by_hand() -> None:
    values = [10.0 + 0.1 * (-1) ** k for k in range(50)]
    found = type_one(_numbers({9.95: values}), tolerance=6.0)
    s = 0.1 * math.sqrt(50 / 49)
    assert found.cg == pytest.approx(0.2 * 6.0 / (6.0 * s))
    assert found.cgk == pytest.approx((0.6 - 0.05) / (3.0 * s))
    assert found.verdict == "capable"
    assert found.cg_interval[0] < found.cg < found.cg_interval[1]
    with pytest.raises(DataError, match="resolution hides"):
        type_one(_numbers({10.0: [10.0] * 12}), 1.0)
    with pytest.raises(DataError, match="at the very least 10"):
        type_one(_numbers({10.0: [10.0, 10.1]}), 1.0)


def test_weights_are_held_against_catchweigher_classes() -> None:
    """At 20 g class X(1) allows 0.096 g, at 150 g 0.36 g."""
    exact = _numbers({20.0: [20.0 + 0.048, 20.0 - 0.048] * 25, 150.0: [150.0 + 0.18, 150.0 - 0.18] * 25})
    assert "0.50 times the limit" in catchweigher_words(exact)
    assert catchweigher_words(exact).endswith(": class X(1)")
    assert "no class" in catchweigher_words(_numbers({20.0: [21.0, 19.0] * 25}))


def test_control_rules_one_by_one() -> None:
    base = [0.0, 1.128, 0.0, -1.128, 0.0, 1.128, 0.0, -1.128]
    limits = limits_of(base)
    assert limits is not None
    assert limits == pytest.approx((0.0, 1.0))
    assert limits_of(base[:7]) is None
    for more, rule in (
        ([3.1], "3 sigma"),
        ([2.1, -0.5, 2.1], "2 of 3"),
        ([1.1, 1.1, -0.1, 1.1, 1.1], "4 of 5"),
        ([0.3] * 8, "8 in a row"),
        ([1.9, 0.9] * 3 + [1.9], "EWMA"),
    ):
        assert [one.rule for one in signals([*base, *more], limits)][:1] == [rule]
    assert signals(base, limits) == ()


def test_a_quiet_process_seldom_alarms(rng: np.random.Generator) -> None:
    """All rules together: about one alarm in 40 values, with centre and scatter of eight values."""
    alarms = 0
    for _ in range(200):
        values = rng.normal(0.0, 1.0, 18)
        limits = limits_of(values)
        assert limits is not None
        alarms += sum(one.at >= 8 for one in signals(values, limits))
    assert alarms / 2000 < 0.14


def test_a_small_shift_is_seen_within_a_dozen_checks(rng: np.random.Generator) -> None:
    late = 0
    for _ in range(100):
        values = np.concatenate([rng.normal(0.0, 1.0, 8), rng.normal(1.5, 1.0, 12)])
        limits = limits_of(values)
        assert limits is not None
        late += not signals(values, limits)
    assert late <= 10
