"""Intervals, limits of agreement, verdicts, recalls, probabilities and folds, each against an oracle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t

from roemetry_tools.compare import agreement
from roemetry_tools.compare.agreement import (
    Bootstrap,
    Graded,
    PairedValue,
    Terms,
    _balanced,
    against_each_other,
    against_truth,
    agreement_of,
    balanced_interval,
    balanced_shift,
    is_true,
    mean_of,
    nearer,
    recalls_of,
    reliability_of,
)
from roemetry_tools.compare.ranking import Compared, choose_by_class, choose_by_error
from roemetry_tools.compare.tables import first_lines_of
from roemetry_tools.compare.variants import Variant


def values(estimates: list[float], true: float | None, each: int = 1) -> dict[str, PairedValue]:
    """One product an estimate, `each` estimates a specimen."""
    known = math.nan if true is None else true
    return {
        f"p{k}": PairedValue(estimate, known, f"p{k}", f"s{k // each}")
        for k, estimate in enumerate(estimates)
    }


def test_the_interval_of_a_mean_is_students(rng: np.random.Generator) -> None:
    drawn = rng.normal(3.0, 2.0, 400)
    low, high = Bootstrap([str(k) for k in range(400)], 1).interval(drawn[:, None], mean_of)
    half = t.ppf(0.975, 399) * drawn.std(ddof=1) / 20.0
    assert (low, high) == pytest.approx((drawn.mean() - half, drawn.mean() + half), abs=0.03)


def test_an_interval_of_few_products_is_as_wide_as_students() -> None:
    """Means drawn from twelve values scatter too little by √(11/12), and by what t is wider than normal."""
    twelve = np.arange(12.0)
    drawn = [Bootstrap([*"abcdefghijkl"], seed).interval(twelve[:, None], mean_of) for seed in range(20)]
    half = t.ppf(0.975, 11) * twelve.std(ddof=1) / math.sqrt(12.0)
    assert 0.5 * np.diff(drawn, axis=1).mean() == pytest.approx(half, rel=0.02)


def test_intervals_hold_the_truth_as_often_as_they_say(rng: np.random.Generator) -> None:
    """With few specimens too, each measured three times over with nearly the same result."""
    held = 0
    for seed in range(200):
        each = np.repeat(rng.normal(0.0, 1.0, 8), 3) + rng.normal(0.0, 0.05, 24)
        low, high = Bootstrap([str(k // 3) for k in range(24)], seed).interval(each[:, None], mean_of)
        held += low <= 0.0 <= high
    assert 0.89 <= held / 200 <= 0.99


def test_measuring_the_same_products_again_makes_no_interval_narrower() -> None:
    once = np.arange(12.0)
    alone = Bootstrap([str(k) for k in range(12)], 5).interval(once[:, None], mean_of)
    thrice = Bootstrap([str(k // 3) for k in range(36)], 5).interval(np.repeat(once, 3)[:, None], mean_of)
    assert thrice == pytest.approx(alone, abs=1e-12)


@pytest.mark.parametrize("alike", [True, False])
def test_many_products_give_the_intervals_that_drawing_each_gives(
    alike: bool, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors with rare failures; or two classes, of which one has 20 products: no sum of normal errors."""
    n = 4000
    if alike:
        rare = np.arange(n) < 20
        right = rng.random(n) < np.where(rare, 0.5, 0.9)
        columns = np.column_stack([right & rare, right & ~rare, rare, ~rare]).astype(float)
    else:
        columns = np.where(rng.random((n, 1)) < 0.02, 30.0, rng.normal(0.0, 2.0, (n, 1)))
    statistic = _balanced if alike else mean_of
    found = []
    for many in (n, 100):
        monkeypatch.setattr(agreement, "MANY", many)
        found.append(Bootstrap([str(k) for k in range(n)], 1).interval(columns, statistic))
    each, together = found
    assert together == pytest.approx(each, abs=0.06 * (each.high - each.low))


def test_limits_of_agreement_are_bland_and_altmans(rng: np.random.Generator) -> None:
    differences = rng.normal(1.0, 2.0, 300)
    found = agreement_of(differences, [str(k) for k in range(300)], Terms())
    spread = differences.std(ddof=1)
    assert found.limits_pct == pytest.approx(
        (differences.mean() - 1.96 * spread, differences.mean() + 1.96 * spread), abs=1e-9
    )
    # Bland and Altman's own approximation: the standard error of a limit is about √(3/n) · s
    half = 1.96 * math.sqrt(3.0 / 300) * spread
    low, high = found.high_limit_interval_pct
    assert 0.5 * (high - low) == pytest.approx(half, rel=0.2)
    assert found.verdict == ""


@pytest.mark.parametrize(
    ("shift", "tolerance", "verdict"),
    [(0.0, 1.0, "equivalent"), (3.0, 1.0, "different"), (-3.0, 1.0, "different"), (1.0, 1.0, "undecided")],
)
def test_the_verdict_is_that_of_two_one_sided_tests(
    rng: np.random.Generator, shift: float, tolerance: float, verdict: str
) -> None:
    noise = rng.normal(0.0, 1.0, 50)
    differences = shift + noise - noise.mean()
    found = agreement_of(differences, [str(k) for k in range(50)], Terms(tolerance))
    assert found.verdict == verdict
    half = t.ppf(0.95, 49) * differences.std(ddof=1) / math.sqrt(50)
    assert found.verdict_interval_pct == pytest.approx((shift - half, shift + half), abs=0.05)


def test_variants_are_compared_on_the_same_products_with_or_without_truth() -> None:
    mine, others = values([110.0, 220.0, 330.0], None), values([100.0, 200.0], None)
    found = against_each_other(mine, others, Terms())
    assert (found.n, found.mean_pct) == (2, pytest.approx(200.0 * 10.0 / 210.0))
    assert against_truth(mine, Terms()) is None
    assert nearer(mine, others, Terms()) is None
    shift = nearer(values([102.0, 103.0], 100.0), values([105.0, 95.0], 100.0), Terms())
    assert shift.value == pytest.approx(-2.5)


def graded(table: list[tuple[str, str, float]], each: int = 1) -> list[Graded]:
    """(true, given, probability) as products."""
    return [Graded(f"p{k}", f"s{k // each}", *row) for k, row in enumerate(table)]


def test_recall_and_precision_are_counted_by_class() -> None:
    found = graded([("a", "a", 0.9), ("a", "b", 0.6), ("b", "b", 0.8), ("b", "", math.nan)])
    first, second = recalls_of(found)
    assert (first.name, first.n, first.recall, first.called, first.precision) == ("a", 2, 0.5, 1, 1.0)
    assert (second.recall, second.called, second.precision) == (0.5, 2, 0.5)
    low, high = balanced_interval(found * 10, Terms())
    assert low < 0.5 < high


def test_the_shift_of_balanced_accuracy_is_paired() -> None:
    """Where one is right on one more product of each class, the shift is that, whatever the rest does."""
    base = graded([("a", "a" if k else "b", 1.0) for k in range(10)] + [("b", "b", 1.0)] * 10)
    same = {one.product: one for one in base}
    better = [one._replace(given=one.true) for one in base]
    shift = balanced_shift(better, same, Terms())
    assert shift.value == pytest.approx(0.05)
    none = balanced_shift(base, same, Terms())
    assert (none.value, *none.interval) == (0.0, 0.0, 0.0)


def test_probabilities_that_mean_what_they_say_lie_on_the_line(rng: np.random.Generator) -> None:
    stated = rng.uniform(0.3, 1.0, 4000)
    right = rng.random(4000) < stated
    made = graded([("a", "a" if hit else "b", float(p)) for p, hit in zip(stated, right, strict=True)])
    found = reliability_of(made, Terms())
    assert found.n == 4000
    assert found.excess.interval.low < 0.0 < found.excess.interval.high
    assert found.calibration_error < 0.03
    assert sum(one.right_interval.low <= one.stated <= one.right_interval.high for one in found.bins) >= 6
    sure = reliability_of([one._replace(probability=1.0) for one in made], Terms())
    assert sure.excess.interval.low > 0.3
    assert sure.brier == pytest.approx(1.0 - right.mean())


def test_the_choice_among_like_variants_flatters(rng: np.random.Generator) -> None:
    """Twenty variants of pure chance: the best looks better than what it does on products held out."""
    made = {k: values(list(100.0 + rng.normal(0.0, 5.0, 40)), 100.0) for k in range(20)}
    found = choose_by_error("mass_g", made, Terms(folds=5, seed=2))
    assert len(found.chosen) == 5
    assert found.held_out > found.seen
    assert choose_by_error("mass_g", {0: made[0]}, Terms()) is None
    assert choose_by_error("mass_g", made, Terms(folds=21)) is None


def test_all_of_a_specimen_is_in_one_fold() -> None:
    """A variant that is right on even specimens alone is never chosen by what it then is scored on."""
    table = [("a" if k // 4 % 2 else "b", "a", 1.0) for k in range(80)]
    one, other = graded(table, 4), [g._replace(given="b") for g in graded(table, 4)]
    found = choose_by_class({3: one, 7: other}, Terms(folds=4))
    assert found.best in (3, 7)
    assert found.seen == 0.5
    assert set(found.chosen) <= {3, 7}


def test_what_is_not_of_a_class_is_truly_denied() -> None:
    rows = graded([("dent", "not-good", 0.9), ("good", "not-good", 0.9), ("dent", "not-cooked", 0.9)])
    names = {"dent", "good", "not-cooked"}
    assert [is_true(one, names) for one in rows] == [True, False, False]
    assert not any(one.right for one in rows)


@pytest.mark.filterwarnings("error")
def test_one_specimen_measured_often_has_no_interval() -> None:
    assert agreement_of(np.zeros(4), list("abcd"), Terms(50.0)).verdict == "undecided", "too few products"
    assert reliability_of(graded([("a", "a", math.nan)]), Terms()) is None
    assert all(map(math.isnan, Bootstrap("aaa", 3).interval(np.array([[1.0], [2.0], [4.0]]), mean_of)))
    found = agreement_of(np.array([1.0, 2.0, 3.0]), ["a", "a", "a"], Terms(tolerance_pct=5.0))
    assert (found.n, found.specimens, found.mean_pct, found.verdict) == (3, 1, 2.0, "undecided")
    assert math.isnan(found.mean_interval_pct.low) and math.isnan(found.high_limit_interval_pct.high)


def led(errors_pct: Sequence[float], lead: float, rng: np.random.Generator) -> list[Compared]:
    """Two variants on products of true volume 100: the second is off by `lead` more on each."""
    rows = []
    for number, more in enumerate((0.0, lead)):
        off = [e + more + 0.01 * float(rng.standard_normal()) for e in errors_pct]
        values = {f"p{k}": PairedValue(100.0 + e, 100.0, f"p{k}", f"p{k}") for k, e in enumerate(off)}
        figures = SimpleNamespace(
            values={"visible_mm3": values, "true_mm3": {}, "mass_g": {}}, graded=(), refused=0, failed=False
        )
        rows.append(Compared(Variant(number, f"v{number}", {}, None), figures))  # type: ignore[arg-type]
    return rows


@pytest.mark.parametrize(
    ("products", "lead", "says"),
    [
        (12, 1.0, "winner: `v0`: mean absolute error of the visible volume"),
        (5, 1.0, "no clear winner; `v0` is ahead"),
        (12, 1e-4, "products are not enough to decide"),
    ],
)
def test_the_first_line_names_the_winner_only_where_the_products_tell(
    products: int, lead: float, says: str, rng: np.random.Generator
) -> None:
    rows = led(np.linspace(0.5, 2.0, products).tolist(), lead, rng)
    first, *more = first_lines_of(rows, Terms(), "")
    assert says in first
    assert any(line.startswith("warning") for line in more) is (products < 10)


def test_variants_that_measured_the_same_are_named(rng: np.random.Generator) -> None:
    one, _ = led([1.0, 2.0], 0.0, rng)
    other = Compared(Variant(1, "v1", {}, None, left_out=("coder=planes",)), one.figures)
    lines = first_lines_of([one, other], Terms(), "")
    assert lines[0] == "no winner: no two variants differ on the same products"
    assert "`coder=planes` was left out: it is the same recipe as `v1`" in lines
    assert "`v1` measured exactly what `v0` did" in lines[-1]
