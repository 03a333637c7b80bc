"""A buyer's table: the first class that fits, guard bands at every limit, faults named with their line."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from roemetry import Recipe
from roemetry.errors import ConfigurationError
from roemetry.records import Decision, Estimate, Grade, Measurement, Outline, Reason, Weight
from roemetry.run.batch import run_recipe
from roemetry.run.record import read_record
from roemetry.testing.runs import volume_of
from roemetry.testing.solids import HALF_ELLIPSOID, product_of
from roemetry_shape.grade_table import GradeTable, GradeTableOptions

HOME = Path(__file__).resolve().parents[3] / "recipes" / "herring_roe"
PRODUCT = product_of(HALF_ELLIPSOID)

TABLE: dict[str, Any] = {
    "classes": [
        {"label": "A", "lane": "1", "shape": ["good"], "limits": {"weight_g": {"at_least": 20.0}}},
        {"label": "B", "lane": "2", "shape": ["good", "bent"], "limits": {"weight_g": {"at_least": 10.0}}},
        {"label": "C", "lane": "3"},
    ],
    "undecided_lane": "hand",
}


def table(*classes: tuple[str, dict[str, dict[str, float]]], **more: Any) -> dict[str, Any]:
    return {"classes": [{"label": label, "limits": limits} for label, limits in classes], **more}


def grading(options: dict[str, Any]) -> GradeTable:
    return GradeTable(GradeTableOptions.model_validate(options))


def decided(
    mass_g: float, std_g: float = 0.1, label: str = "good", probability: float = math.nan, **more: Any
) -> Decision:
    return grading({**TABLE, **more}).decide(
        PRODUCT, None, Weight(whole(mass_g, std_g)), Grade(label, probability)
    )


def whole(value: float, std: float) -> Estimate:
    """Give an estimate whose uncertainty is stated in full."""
    return Estimate(value, std, interval=(value - 2.0 * std, value + 2.0 * std))


def test_the_first_class_that_fits_is_taken_and_every_step_has_a_reason() -> None:
    assert [decided(m).label for m in (25.0, 15.0, 5.0)] == ["A", "B", "C"]
    assert [decided(m, label="bent").label for m in (25.0, 15.0, 5.0)] == ["B", "B", "C"]
    last = decided(5.0)
    assert (last.lane, last.possible) == ("3", ("C",))
    assert [reason.code for reason in last.reasons] == ["class-refused", "class-refused", "class-proven"]
    assert last.reasons[0].text == "A: weight_g is 5 ± 0.1, at least 20 is required"


def test_within_the_guard_band_it_is_undecided() -> None:
    """The band is 1.65 · 0.1 g to either side."""
    assert decided(20.17).label == "A"
    assert decided(19.83).label == "B"
    for mass in (20.16, 20.0, 19.84):
        open_ = decided(mass)
        assert (open_.label, open_.lane, open_.possible) == ("undecided", "hand", ("A", "B"))
        assert [reason.code for reason in open_.reasons] == ["class-open", "class-proven"]
    assert decided(20.0, guard_factor=0.0).label == "A"
    taken = decided(20.0, unproven="next")
    assert (taken.label, taken.lane) == ("B", "2")
    assert taken.reasons[-1].code == "taken-unproven"


def test_an_open_class_that_alone_is_left_is_taken() -> None:
    """Between 8 and 9 g with a band wider than the class: neither kept nor broken, and nothing else fits."""
    between = {"at_least": 8.0, "below": 9.0}
    classes = table(
        ("low", {"weight_g": {"below": 8.0}}),
        ("middle", {"weight_g": between, "dents": {"below": 5.0}}),
        ("odd", {"weight_g": between, "dents": {"at_least": 5.0}}),
        ("high", {"weight_g": {"at_least": 9.0}}),
        std={"dents": 0.1},
    )
    grade = Grade("good", features={"dents": 0.0})
    for std_g, label in ((0.305, "undecided"), (0.302, "middle")):  # 1.65 · 0.305 g reaches both neighbours
        assert grading(classes).decide(PRODUCT, None, Weight(whole(8.5, std_g)), grade).label == label
    lone = grading(table(("A", {"weight_g": {"at_least": 8.0}}), ("B", {})))
    assert lone.decide(PRODUCT, None, None, None).possible == ("A", "B")


def test_guarded_acceptance_keeps_its_risk(rng: np.random.Generator) -> None:
    """Of products right at the limit 5 % are called the better class, 5 % the worse one."""
    labels = [decided(20.0 + 0.1 * float(off)).label for off in rng.standard_normal(4000)]
    for label in ("A", "B"):
        assert labels.count(label) / 4000 == pytest.approx(0.0495, abs=4 * math.sqrt(0.05 * 0.95 / 4000))


@pytest.mark.parametrize(
    ("label", "probability", "features", "wanted"),
    [
        ("good", 0.97, {}, "A"),
        ("good", 0.9, {}, "undecided"),
        ("unknown", math.nan, {}, "undecided"),
        # Not sure which of the two, sure that it is one of them: class A is open, B is not.
        ("bent", 0.7, {"probability_good": 0.29, "probability_bent": 0.7}, "undecided"),
        ("bent", 0.96, {"probability_good": 0.04, "probability_bent": 0.96}, "B"),
        ("not-good", 0.99, {"probability_good": 0.01, "probability_not-good": 0.99}, "C"),
        ("not-good", 0.9, {"probability_good": 0.1, "probability_not-good": 0.9}, "undecided"),
    ],
)
def test_a_shape_must_be_sure(
    label: str, probability: float, features: dict[str, float], wanted: str
) -> None:
    grade = Grade(label, probability, features)
    assert grading(TABLE).decide(PRODUCT, None, Weight(whole(30.0, 0.1)), grade).label == wanted


@pytest.mark.parametrize(
    ("wanted", "label", "stated", "takes"),
    [
        (["bent", "dented"], "not-good", {"bent": 0.6, "dented": 0.39, "not-good": 0.99}, True),
        (["not-good"], "bent", {"bent": 0.97, "not-good": 0.99}, True),
        (["bent"], "not-good", {"bent": 0.6, "dented": 0.39, "not-good": 0.99}, False),
        (["good", "not-good"], "good", {"good": 0.8, "not-good": 0.2}, True),
        (["not-good"], "henkei", {"henkei": 0.97}, True),
        (["not-good"], "bend", {"bend": math.nan}, True),
        (["not-good"], "good", {"good": math.nan}, False),
        # added up, they would be 1.3
        (["bent", "not-good"], "bent", {"bent": 0.6, "not-good": 0.7}, False),
    ],
)
def test_all_defects_together_are_not_added_to_each_of_them(
    wanted: list[str], label: str, stated: dict[str, float], *, takes: bool
) -> None:
    grade = Grade(label, stated[label], {f"probability_{name}": p for name, p in stated.items()})
    classes = [{"label": "A", "shape": wanted}, {"label": "rest"}]
    assert (grading({"classes": classes}).decide(PRODUCT, None, None, grade).label == "A") == takes


def test_size_colour_and_volume_are_asked_of_whoever_knows() -> None:
    limits = {
        "length_mm": {"at_least": 50.0},
        "green_mean": {"below": 90.0},
        "true_volume_cm3": {"at_least": 5.0},
    }
    grader = grading(table(("A", limits), ("B", {}), std={"green_mean": 2.0}))
    assert grader.needs() == {"volume"}
    seen = replace(PRODUCT, outline=Outline(1, np.zeros((4, 2)), features={"green_mean": 80.0}))
    volume = replace(volume_of(9000.0), true_mm3=whole(9000.0, 90.0))
    grade = Grade("good", features={"length_mm": 51.0}, features_std={"length_mm": 0.3})
    part = grader.decide(seen, volume, None, grade)
    assert part.label == "undecided", "noise is a part of what a length is off by"
    assert "length_mm is 51 ± 0.3 or more: its uncertainty is not stated in full" in part.reasons[0].text
    bare = grader.decide(seen, volume, None, Grade("good", features={"length_mm": 51.0}))
    assert bare.label == "undecided", "nothing says how far off the length may be"
    assert "length_mm is 51: its uncertainty is not stated" in bare.reasons[0].text
    whole_length = grading(table(("A", limits), ("B", {}), std={"green_mean": 2.0, "length_mm": 0.2}))
    assert whole_length.decide(seen, volume, None, grade).label == "A"
    risked = grading(table(("A", limits), ("B", {}), guard_factor=0.0))
    assert risked.decide(seen, volume, None, Grade("good", features={"length_mm": 51.0})).label == "A"
    told = grading(table(("A", limits), ("B", {}), std={"green_mean": 2.0, "length_mm": 1.0}))
    assert told.decide(seen, volume, None, grade).label == "undecided", "the run knows a part of its 1 mm"
    missing = whole_length.decide(PRODUCT, volume, None, grade)
    assert missing.label == "undecided"
    assert "there is no green_mean; there are length_mm, true_volume_cm3" in missing.reasons[0].text


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            table(("A", {"weight_g": {"at_least": 20}}), ("B", {"weight_g": {"at_least": 10, "below": 15}})),
            "there is a gap: no class takes weight_g below 10",
        ),
        (
            table(("A", {"weight_g": {"at_least": 20}}), ("B", {"weight_g": {"below": 15}})),
            "no class takes weight_g at least 15 and below 20",
        ),
        (
            table(("A", {"weight_g": {"at_least": 20}}), ("B", {"weight_g": {"at_least": 30}}), ("C", {})),
            "no product comes this far",
        ),
        (
            table(
                ("A", {"weight_g": {"at_least": 10, "below": 20}}),
                ("B", {"weight_g": {"at_least": 15, "below": 25}}),
                ("C", {}),
            ),
            "overlaps class 'A' at weight_g at least 15 and below 20; move a limit",
        ),
        (  # a curvature has a sign, unlike a length
            table(("A", {"hollow_curvature_high_per_mm": {"at_least": 0}})),
            "there is a gap: no class takes hollow_curvature_high_per_mm below 0",
        ),
        (table(("A", {"weight_g": {"at_least": 9, "below": 9}})), "nothing is at least 9 and below 9"),
        (table(("A", {"weight_g": {}})), "neither at_least nor below"),
        (table(("A", {"weigth_g": {"at_least": 9}}), ("B", {})), "measures this; did you mean `weight_g`"),
        (table(("A", {}), std={"weight_g": 1.0}), "no class has a limit on it"),
        ({"classes": []}, "at least 1 item"),
    ],
)
def test_a_faulty_table_is_named(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        GradeTableOptions.model_validate(options)


def test_a_slip_in_a_name_is_the_only_fault_told() -> None:
    """Beside a limit on the right name it would overlap the next class as well."""
    slip = table(("A", {"weigth_g": {"at_least": 9}}), ("B", {"weight_g": {"at_least": 5}}), ("C", {}))
    with pytest.raises(ValidationError) as refused:
        GradeTableOptions.model_validate(slip)
    assert "did you mean `weight_g`" in str(refused.value)
    assert "overlaps" not in str(refused.value)
    with pytest.raises(ValidationError) as refused:
        GradeTableOptions.model_validate(table(("A", {"weigth_g": {"at_least": 9}}), std={"weight_g": 1.0}))
    assert "no class has a limit" not in str(refused.value)


def test_what_is_no_fault_is_let_be() -> None:
    GradeTableOptions.model_validate(table(("A", {"weight_g": {"at_least": 0}})))
    nested = table(
        ("A", {"weight_g": {"at_least": 10, "below": 20}}), ("B", {"weight_g": {"below": 30}}), ("C", {})
    )
    GradeTableOptions.model_validate(nested)
    crossed = table(("A", {"weight_g": {"below": 20}}), ("B", {"weight_g": {"at_least": 10}}))
    GradeTableOptions.model_validate({**crossed, "overlaps": "first-wins"})
    with pytest.raises(ValidationError, match="overlaps class 'A'"):
        GradeTableOptions.model_validate(crossed)


RANGES = st.tuples(st.integers(0, 5), st.integers(0, 5)).filter(lambda ends: ends[0] < ends[1])
CLASSES = st.lists(
    st.tuples(st.dictionaries(st.sampled_from("ab"), RANGES), st.booleans()), min_size=1, max_size=4
)


@settings(max_examples=80, deadline=None)
@given(CLASSES)
def test_gaps_and_lost_classes_are_those_that_trying_finds(classes: list[Any]) -> None:
    """On a grid between all limits: is there a point that no class takes, a class that no point reaches?"""
    written = [
        {
            "label": str(number),
            "shape": ["good"] if good_only else [],
            "limits": {name: {"at_least": low, "below": high} for name, (low, high) in limits.items()},
        }
        for number, (limits, good_only) in enumerate(classes)
    ]
    taken: set[int] = set()
    gap = False
    places = np.arange(-0.5, 6.0)
    for a, b, shape in itertools.product(places, places, ("good", "bad")):
        point = {"a": a, "b": b}
        fits = [
            number
            for number, (limits, good_only) in enumerate(classes)
            if (not good_only or shape == "good")
            and all(low <= point[name] < high for name, (low, high) in limits.items())
        ]
        gap |= not fits
        taken.update(fits[:1])
    said = ""
    try:
        GradeTableOptions.model_validate({"classes": written, "overlaps": "first-wins"})
    except ValidationError as error:
        said = str(error)
    assert ("there is a gap" in said) == gap
    assert said.count("no product comes this far") == len(classes) - len(taken)


RECIPE = """\
roemetry: 1
product: skeins
source: {{path: "{home}/images/skein_02.png"}}
calibration: {home}/calibration.yaml
stages:
  extractor: {{use: dominant-peak, options: {{threshold: 15, start: lowest}}}}
  coder: window-tracking
  triangulator: block-linear
  volume: zero-order-hold
{weigher}  classifier: shape-limits
  grader:
    use: grade-table
    options:
      classes:
        - {{label: heavy, lane: belt 1, limits: {{weight_g: {{at_least: {limit}}}}}}}
        - {{label: light, lane: belt 2}}
sinks: [csv]
"""


OPTIONS = "stages.grader.options"


def recipe(folder: Path, weigher: str = "  weigher: density\n", limit: str = "1.0") -> Path:
    path = folder / "recipe.yaml"
    path.write_text(RECIPE.format(home=HOME, weigher=weigher, limit=limit), encoding="utf-8")
    return path


def test_a_run_records_what_was_decided(tmp_path: Path) -> None:
    run_recipe(Recipe.load(recipe(tmp_path), sets=[f"{OPTIONS}.std={{weight_g: 0.5}}"]), tmp_path / "out")
    (row,) = read_record(tmp_path / "out")
    assert (row.decision.label, row.decision.lane) == ("heavy", "belt 1")
    again = Measurement.from_json(row.to_json())
    assert again.decision == row.decision
    header, line = (tmp_path / "out" / "results.csv").read_text("utf-8").splitlines()
    cells = dict(zip(header.split(","), line.split(","), strict=False))
    assert (cells["decision"], cells["lane"]) == ("heavy", "belt 1")


@pytest.mark.parametrize("draws", [0, 3])
def test_a_part_of_an_uncertainty_proves_nothing(tmp_path: Path, draws: int) -> None:
    """Draws know the calibration's part, but neither the peaks' noise nor the density's."""
    (found,) = Recipe.load(recipe(tmp_path), sets=[f"draws={draws}"]).run()
    assert found.decision.label == "undecided"
    known = "or more" if draws else "weight_g is 13.83"
    assert f"{known}: its uncertainty is not stated in full" in found.decision.reasons[0].text
    (found,) = Recipe.load(recipe(tmp_path), sets=[f"{OPTIONS}.guard_factor=0"]).run()
    assert found.decision is not None and found.decision.label == "heavy", "no guard band was asked for"


def test_faults_have_their_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"recipe.yaml:11:3: stages.grader: it works on the result"):
        Recipe.load(recipe(tmp_path, weigher=""))
    path = recipe(tmp_path)
    path.write_text(path.read_text("utf-8").replace("        - {label: light, lane: belt 2}\n", ""), "utf-8")
    with pytest.raises(ConfigurationError, match=r"recipe.yaml:15:7: .*there is a gap: no class takes"):
        Recipe.load(path)


@given(part=st.floats(0.0, 50.0), off=st.floats(-20.0, 20.0), std=st.none() | st.floats(0.1, 50.0))
def test_a_part_of_the_uncertainty_proves_nothing_and_is_a_lower_bound(
    part: float, off: float, std: float | None
) -> None:
    """Without an interval the table's own word counts, for no less than the part that is known."""
    estimate = Estimate(20.0 + off, part or math.nan, {"model": part} if part else {})
    grader = grading({**TABLE, "std": {} if std is None else {"weight_g": std}})
    label = grader.decide(PRODUCT, None, Weight(estimate), Grade("good")).label
    guard = 1.65 * max(part, std or 0.0)
    if std is None:
        assert label == "undecided"
    elif label == "A":
        assert off >= guard - 1e-9


def test_a_weight_that_counts_the_air_below_proves_nothing() -> None:
    reason = Reason("visible-taken-for-true", "the visible volume is weighed")
    weight = Weight(whole(30.0, 0.1), (reason,))
    assert grading(TABLE).decide(PRODUCT, None, weight, Grade("good")).label == "undecided"
