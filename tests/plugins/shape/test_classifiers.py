"""Limits, fuzzy rules, learning, the shipped model: right on what is known, silent on what is not."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import binom

from benchmarks.traced import traced
from roemetry import Pipeline, Recipe
from roemetry.calibrating.known_products import read_samples
from roemetry.errors import DataError, RoemetryError, StageError
from roemetry.records import Fitted, Samples
from roemetry.testing.solids import BOX, HALF_ELLIPSOID, product_of
from roemetry_paper.arc_curvature import ArcCurvature
from roemetry_shape.fuzzy_rules import FuzzyRules, FuzzyRulesOptions
from roemetry_shape.learned import Learned, LearnedOptions, _folds, fit_classifier, load_model
from roemetry_shape.novelty import GOOD_SPREAD, excess_norm, lower_bound, seen_classes
from roemetry_shape.shape_limits import ShapeLimits, ShapeLimitsOptions
from tests.command import typed

DOME, SLAB = product_of(HALF_ELLIPSOID), product_of(BOX)


def test_the_first_broken_limit_names_the_class() -> None:
    limits = [
        {"feature": "thickness_mm", "at_most": 1000.0, "label": "giant"},
        {"feature": "fullness_median", "at_most": 0.9, "label": "box"},
        {"feature": "width_mm", "at_least": 1.0, "label": "thread"},
    ]
    classifier = ShapeLimits(ShapeLimitsOptions.model_validate({"limits": limits, "good": "round"}))
    assert classifier.classify(SLAB).label == "box"
    assert "at most 0.9 is allowed" in classifier.classify(SLAB).reasons[0].text
    assert classifier.classify(DOME).label == "round"
    assert ShapeLimits().classify(DOME).label == "unknown"
    wrong = ShapeLimitsOptions.model_validate({"limits": [{"feature": "with", "at_most": 1, "label": "x"}]})
    assert ShapeLimits(wrong).classify(DOME).reasons[0].code == "no-such-feature"
    with pytest.raises(ValidationError, match="neither at_most nor at_least"):
        ShapeLimitsOptions.model_validate({"limits": [{"feature": "width_mm", "label": "x"}]})


RULES = {
    "terms": {"full": {"feature": "fullness_median", "points": [[0.8, 0.0], [0.9, 1.0]]}},
    "rules": [{"when": ["full"], "label": "box"}, {"when": ["not full"], "label": "round"}],
}


def test_the_truest_rule_names_the_class() -> None:
    classifier = FuzzyRules(FuzzyRulesOptions.model_validate(RULES))
    assert classifier.classify(SLAB).label == "box"
    grade = classifier.classify(DOME)
    assert grade.label == "round"
    assert grade.features["truth_round"] == pytest.approx(1.0 - grade.features["truth_box"])


def test_rules_that_say_nothing_or_two_things_are_unknown() -> None:
    half = {"terms": {"full": {"feature": "fullness_median", "points": [[-1.0, 0.5], [2.0, 0.5]]}}}
    never = {"rules": [{"when": ["full", "not full"], "label": "odd"}], "truth_min": 0.6}
    for changed, code in ((half, "rules-tie"), (never, "no-rule-holds")):
        options = FuzzyRulesOptions.model_validate({**RULES, **changed})
        assert FuzzyRules(options).classify(DOME).reasons[0].code == code
    with pytest.raises(ValidationError, match="uses the term 'fat'; there are full"):
        FuzzyRulesOptions.model_validate({**RULES, "rules": [{"when": ["not fat"], "label": "x"}]})
    flat = {"a": {"feature": "width_mm", "points": [[1.0, 0.0], [1.0, 1.0]]}}
    with pytest.raises(ValidationError, match="do not rise"):
        FuzzyRulesOptions.model_validate({"terms": flat})


LIMITS = {"limits": [{"feature": "fullness_median", "at_most": 0.85, "label": "box"}], "good": "round"}


@pytest.mark.parametrize(
    "classifier",
    [
        FuzzyRules(FuzzyRulesOptions.model_validate(RULES)),
        ShapeLimits(ShapeLimitsOptions.model_validate(LIMITS)),
    ],
)
@pytest.mark.parametrize(("value", "label"), [(0.82, "round"), (0.88, "box")])
def test_a_class_is_only_as_sure_as_the_feature_it_hangs_on(
    classifier: FuzzyRules | ShapeLimits, value: float, label: str
) -> None:
    sure = {"fullness_median": value, "fullness_median_std": 0.01}
    assert classifier.judge(sure).label == label
    grade = classifier.judge({**sure, "fullness_median_std": 0.02})
    assert (grade.label, grade.reasons[0].code) == ("unknown", "feature-unsure")


def samples(rng: np.random.Generator, count: int = 240) -> Samples:
    """Three classes in a plane, the third overlapping the second."""
    labels = np.array(["good", "dent", "bend"])[rng.integers(0, 3, count)]
    centre = {"good": (0.0, 0.0), "dent": (4.0, 0.0), "bend": (4.0, 1.5)}
    values = np.array([centre[name] for name in labels]) + rng.normal(0.0, 0.7, (count, 2))
    ids = tuple(f"p{n}" for n in range(count))
    return Samples(ids, ids, ("a_mm", "b_mm"), values, tuple(labels))


@pytest.fixture(scope="module")
def learned_of_three() -> Fitted:
    return fit_classifier(samples(np.random.default_rng(20260711)), good="good", smoothing_mm=3.0)


def test_what_is_learned_is_right_and_says_how_sure_it_is(learned_of_three: Fitted, tmp_path: Path) -> None:
    fitted = learned_of_three
    assert fitted.figures["good_kept_share"] > 0.97
    assert fitted.figures["others_caught_share"] > 0.97
    path = tmp_path / "model.json"
    path.write_text(fitted.content, encoding="utf-8")
    model = load_model(path)
    fresh = samples(np.random.default_rng(99), 600)
    probabilities = np.stack([model.probabilities(row) for row in fresh.values])
    right = np.array(model.classes)[probabilities.argmax(axis=1)] == np.array(fresh.labels)
    stated = probabilities.max(axis=1)
    assert right.mean() == pytest.approx(stated.mean(), abs=0.05)
    doubtful = stated < 0.8
    assert doubtful.sum() > 30
    assert right[doubtful].mean() == pytest.approx(stated[doubtful].mean(), abs=0.12)
    np.testing.assert_allclose(probabilities.sum(axis=1), 1.0, atol=1e-12)
    novel = np.array([30.0, -30.0])
    assert model.novelty(novel).value > 1.0
    assert np.mean([model.novelty(row).value > 1.0 for row in fresh.values]) < 0.02
    # along the axis on which good and dents lie, farther and farther out: both measures grow, each within 1
    out = np.array([[1.0, 0.0]]) * np.linspace(4.0, 40.0, 400)[:, None]
    distance = model.seen.distances(out) / model.distance_max
    outside = excess_norm(model.seen.excess(out)) / model.excess_max
    near_both = out[(distance < 1.0) & (outside < 1.0) & (np.hypot(distance, outside) > 1.0)]
    assert near_both.size
    assert all(model.novelty(row).value > 1.0 for row in near_both)
    # a straight line in the features would promise what nobody has looked at
    far, farther = (model.probabilities(np.array([value, 0.0])) for value in (1e3, 1e6))
    np.testing.assert_array_equal(far, farther)


def test_a_defect_in_doubt_is_not_good_and_only_where_good_is_unlikely(
    learned_of_three: Fitted, tmp_path: Path
) -> None:
    """Dents and bends overlap: between them no name is sure, but good is as good as excluded."""
    path = tmp_path / "model.json"
    path.write_text(learned_of_three.content, encoding="utf-8")
    learned = Learned(LearnedOptions(model=path, probability_min=0.9))
    between = learned.judge({"a_mm": 4.0, "b_mm": 0.75})
    assert between.label == "not-good"
    assert between.probability == pytest.approx(1.0 - between.features["probability_good"], abs=1e-12)
    assert between.probability > 0.99
    assert between.reasons[0].code == "defect-not-named"
    halfway = [learned.judge({"a_mm": float(a), "b_mm": 0.0}) for a in np.linspace(1.6, 2.4, 41)]
    doubtful = [one for one in halfway if 0.1 < one.features["probability_good"] < 0.9]
    assert doubtful
    assert {one.label for one in doubtful} == {"unknown"}


def test_a_group_is_never_on_both_sides_of_a_fold(rng: np.random.Generator) -> None:
    groups = rng.integers(0, 40, 300)
    groups = np.unique(groups, return_inverse=True)[1]
    labels = np.array(["good", "dent"])[rng.integers(0, 2, groups.max() + 1)][groups]
    asked = np.concatenate([test for _, test in _folds(labels, groups)])
    assert sorted(asked) == list(range(300))
    for known, test in _folds(labels, groups):
        assert not set(groups[known]) & set(groups[test])
        assert set(labels[test]) == {"good", "dent"}


def test_what_cannot_be_learned_from_is_named(rng: np.random.Generator) -> None:
    given = samples(rng)
    few = Samples(("p",) * 4, ("p",) * 4, given.features, given.values[:4], ("good",) * 4)
    for bad, good, said in (
        (few, "good", r"too few products of `good` \(4\)"),
        (replace(given, labels=("lone", *given.labels[1:])), "good", r"too few products of `lone` \(1\)"),
        (given, "fine", "no product is labelled `fine`"),
        (replace(given, values=np.ones((240, 2))), "good", "no feature varies"),
    ):
        with pytest.raises(DataError, match=said):
            fit_classifier(bad, good=good, smoothing_mm=0.0)
    with pytest.raises(StageError, match="does not learn"):
        ArcCurvature.fit(given)


def test_the_word_for_all_defects_is_no_class_beside_others(rng: np.random.Generator) -> None:
    three = samples(rng)
    labels = tuple("not-good" if label == "bend" else label for label in three.labels)
    with pytest.raises(DataError, match="`not-good` is a class beside others"):
        fit_classifier(replace(three, labels=labels), good="good", smoothing_mm=3.0)
    two = tuple(label if label == "good" else "not-good" for label in three.labels)
    fit_classifier(replace(three, labels=two), good="good", smoothing_mm=3.0)


def test_a_damaged_model_is_named(learned_of_three: Fitted, tmp_path: Path) -> None:
    path, content = tmp_path / "m.json", json.loads(learned_of_three.content)
    path.write_text(json.dumps(content), encoding="utf-8")
    assert load_model(path).classes == ("bend", "dent", "good"), "the sound one is read"
    for damage in (
        {"weights": [[1.0]]},
        {"weights": [[math.nan] * 2] * 3},
        {"intercepts": [0.0]},
        {"fill": ["x", "y"]},
        {"seen": {**content["seen"], "precision": [[1000]] * 3}},
    ):
        path.write_text(json.dumps({**content, **damage}), encoding="utf-8")
        with pytest.raises(StageError, match=r"m.json is no fitted classifier"):
            load_model(path)
    for text in ("", "[]", "{}", json.dumps({"roemetry_classifier": 6, "features": []})):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(StageError, match=r"m.json is no fitted classifier"):
            Learned(LearnedOptions(model=path)).classify(DOME)


def table(path: Path, header: list[str], *rows: list[object]) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    return path


NUMBERED: list[list[object]] = [[f"p{n}", "good", n] for n in range(5)]


@pytest.mark.parametrize(
    ("header", "rows", "says"),
    [
        (["id", "label", "a"], [], "the table is empty"),
        (["name", "label", "a"], [["p", "good", 1]], "no column `id`"),
        (["id", "a"], [["p", 1]], "no column `label`"),
        (["id", "label"], [["p", "good"]], "no column of features"),
        (["id", "label", "a"], [["p", "good", 1], ["p", "dent", 2]], "p stands there 2 times"),
        (["id", "label", "a"], [["p", "good", 1], ["q", "Good ", 2]], "differ in spelling only"),
        (["id", "label", "a"], [["p", "", 1]], "no product has a label"),
        (["id", "label", "a"], [["p", "good", 1, 7]], "another number of cells"),
        (
            ["id", "label", "a"],
            [*NUMBERED, ["q", "good", "3,5"]],
            "t.csv:7: a: found '3,5', expected",
        ),
    ],
)
def test_a_bad_table_is_named(tmp_path: Path, header: list[str], rows: list[list[object]], says: str) -> None:
    with pytest.raises(RoemetryError, match=says):
        read_samples(table(tmp_path / "t.csv", header, *rows))


def test_the_verb_learns_from_a_table(rng: np.random.Generator, tmp_path: Path) -> None:
    given = samples(rng, 90)
    rows = [[name, *map(float, row)] for name, row in zip(given.ids, given.values, strict=True)]
    data = table(tmp_path / "features.csv", ["id", "a_mm", "b_mm"], *rows)
    answers = [[name, label] for name, label in zip(given.ids, given.labels, strict=True)]
    labels = table(tmp_path / "labels.csv", ["id", "label"], *answers)
    out = tmp_path / "m.json"
    words = ["fit-classifier", str(data), "--labels", str(labels), "--good", "good", "--out", str(out)]
    done = typed(*words)
    assert "balanced_accuracy" in done.stdout
    assert load_model(out).classes == ("bend", "dent", "good")


def skeins(rng: np.random.Generator, count: int, **deformed: float) -> np.ndarray:
    """Shape features of products alike; deformed ones deviate by so many of `GOOD_SPREAD`."""
    z = rng.normal(0.0, 1.0, (count, len(GOOD_SPREAD)))
    for name, off in deformed.items():
        z[:, list(GOOD_SPREAD).index(name)] += off
    return 2.0 + z * np.array(list(GOOD_SPREAD.values()))


def fitted_on(tmp_path: Path, values: np.ndarray, labels: tuple[str, ...]) -> tuple[Learned, Fitted]:
    ids = tuple(str(k) for k in range(len(values)))
    fitted = Learned.fit(Samples(ids, ids, tuple(GOOD_SPREAD), values, labels), good="good")
    (tmp_path / "m.json").write_text(fitted.content, encoding="utf-8")
    return Learned(LearnedOptions(model=tmp_path / "m.json")), fitted


def labels_of(learned: Learned, values: np.ndarray) -> list[str]:
    return [learned.judge(dict(zip(GOOD_SPREAD, row.tolist(), strict=True))).label for row in values]


def test_eight_good_ones_alone_tell_good_from_not(rng: np.random.Generator, tmp_path: Path) -> None:
    learned, fitted = fitted_on(tmp_path, skeins(rng, 8), ("good",) * 8)
    assert np.mean([label == "good" for label in labels_of(learned, skeins(rng, 400))]) > 0.95
    assert set(labels_of(learned, skeins(rng, 100, cup_depth_mm=10.0))) == {"not-good"}
    assert fitted.figures["good_kept_at_least"] == pytest.approx(0.05 ** (1 / 8))
    assert "at least 69 % of good products are kept" in fitted.words[1]


def test_one_named_defect_gives_its_name_to_those_like_it(rng: np.random.Generator, tmp_path: Path) -> None:
    values = np.concatenate([skeins(rng, 8), skeins(rng, 1, cup_depth_mm=15.0), skeins(rng, 1, bow_mm=15.0)])
    learned, _ = fitted_on(tmp_path, values, ("good",) * 8 + ("dent", "bend"))
    for name, feature in (("dent", "cup_depth_mm"), ("bend", "bow_mm")):
        said = labels_of(learned, skeins(rng, 100, **{feature: 12.0}))
        assert said.count(name) > 90
        assert "good" not in said
    assert labels_of(learned, skeins(rng, 50, twist_deg=12.0)).count("not-good") > 45


@pytest.mark.parametrize(("kept", "count", "least"), [(8, 8, 0.6877), (59, 59, 0.9505), (57, 60, 0.8765)])
def test_what_is_promised_is_the_exact_binomial_bound(kept: int, count: int, least: float) -> None:
    """Least share of which `kept` or more of `count` happen in one case of twenty."""
    assert lower_bound(kept, count) == pytest.approx(least, abs=1e-3)
    assert binom.sf(kept - 1, count, lower_bound(kept, count)) == pytest.approx(0.05, abs=1e-9)


def test_a_model_learned_elsewhere_is_adapted_to_a_few_good_ones(
    learned_of_three: Fitted, rng: np.random.Generator, tmp_path: Path
) -> None:
    """Good ones of a line whose `a_mm` lies higher: novel or doubtful before, good after; names stay."""
    elsewhere = tmp_path / "elsewhere.json"
    elsewhere.write_text(learned_of_three.content, encoding="utf-8")
    values = np.array([1.6, 0.0]) + rng.normal(0.0, 0.2, (40, 2))
    ids = tuple(str(k) for k in range(10))
    few = Samples(ids, ids, ("a_mm", "b_mm"), values[:10], ("good",) * 10)
    fitted = Learned.fit(few, good="good", begin=elsewhere)
    (tmp_path / "m.json").write_text(fitted.content, encoding="utf-8")
    before, after = (Learned(LearnedOptions(model=path)) for path in (elsewhere, tmp_path / "m.json"))

    def said(learned: Learned, rows: np.ndarray) -> list[str]:
        return [learned.judge({"a_mm": a, "b_mm": b}).label for a, b in rows.tolist()]

    assert said(before, values[10:]).count("good") < said(after, values[10:]).count("good")
    assert said(after, values[10:]).count("good") > 25
    assert set(said(after, np.array([[4.0, -0.5], [4.2, -0.4]]))) == {"dent"}
    assert fitted.figures["good_kept_at_least"] <= lower_bound(10, 10)
    with pytest.raises(DataError, match="no column b_mm"):
        Learned.fit(replace(few, features=("a_mm", "c_mm")), begin=elsewhere)
    with pytest.raises(DataError, match="too few products"):
        Learned.fit(replace(few, labels=("dent",) * 10), begin=elsewhere)


def two_lines(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Two classes, in each of which the two features hang together, but not in the same way."""
    labels = np.array(["a", "b"])[rng.integers(0, 2, count)]
    first, second = 0.2 * rng.standard_normal((2, count))
    way = np.where(labels == "a", 1.0, -1.0)
    return np.column_stack([first, 0.95 * way * first + 0.05 * second]), labels


def test_each_class_has_its_own_correlation(rng: np.random.Generator) -> None:
    """Off to the side of both lines is novel, though each feature alone is not."""
    values, labels = two_lines(rng, 4000)
    seen = seen_classes(values, labels)
    on_a_line, beside = seen.distances(np.array([[0.3, 0.285], [0.3, 0.0]]))
    assert beside > 1.3 * on_a_line
    # a sample lies less than 1 from its own: of two classes the nearer counts, and shrinking weakens
    assert 0.5 < (seen.distances(values) ** 2).mean() < 1.0


def test_one_feature_beyond_all_that_was_seen_is_found_among_many(rng: np.random.Generator) -> None:
    """Half its range beyond it, in one of forty that all hang together."""
    common = rng.standard_normal((300, 1))
    values = common + 0.2 * rng.standard_normal((300, 40))
    labels = np.array(["a", "b"])[rng.integers(0, 2, 300)]
    seen = seen_classes(values, labels)
    np.testing.assert_array_equal(seen.excess(values), 0.0)
    low, high = np.sinh(seen.low[7]), np.sinh(seen.high[7])
    one = values[:1].copy()
    one[0, 7] = np.sinh(seen.high[7] + 0.5 * (seen.high[7] - seen.low[7]))
    found = seen.excess(one)
    assert low < values[0, 7] < high < one[0, 7]
    assert found[0].argmax() == 7
    assert found[0, 7] == pytest.approx(0.5, abs=1e-9)
    assert excess_norm(found)[0] == pytest.approx(0.5, abs=1e-9)


FOLDER = Path(__file__).parents[3] / "recipes" / "herring_roe"
SETS = (
    "stages.extractor.use=centre-of-gravity",
    "stages.extractor.options={}",
    "stages.classifier.use=learned",
    "stages.classifier.options={model: classifier.json}",
)


def test_the_model_is_small_and_says_what_it_was_fitted_on() -> None:
    path = FOLDER / "classifier.json"
    assert path.stat().st_size < 2**16
    assert "no real skein" in json.loads(path.read_text("utf-8"))["about"]["fitted_on"]


@pytest.mark.parametrize(
    ("skein", "label"),
    [
        ("skein_01", "good"),
        ("skein_03", "dent"),
        ("skein_06", "twist"),
        ("skein_08", "good"),
        ("skein_09", "bend"),
    ],
)
def test_the_model_names_what_stripes_show(skein: str, label: str) -> None:
    """Images that nothing was fitted to, calibrated by the recipe's block."""
    recipe = Recipe.load(FOLDER, sets=SETS)
    source = recipe.source.make()
    (reference,) = (one for one in source.references(recipe.source_path) if one.id == skein)
    grade = Pipeline(recipe).trace(source.read(reference)).products[0].grade
    assert grade.label == label
    assert grade.probability > 0.5


THOROUGH = [pytest.param(family, marks=pytest.mark.thorough) for family in ("fillet", "wedge")]


@pytest.mark.parametrize("family", ["staircase", "truncated-pyramid", *THOROUGH])
def test_what_is_no_skein_is_unknown(family: str) -> None:
    """Measured without an image, on a rig about the recipe's; and the feature that tells is named."""
    learned = Learned(LearnedOptions(model=FOLDER / "classifier.json"))
    product = traced(7, family=family).exact
    assert product is not None
    grade = learned.classify(product)
    assert grade.label == "unknown"
    assert [reason.code for reason in grade.reasons] == ["unlike-anything-learned"]
    assert grade.features["novelty"] > 1.0
    assert grade.reasons[0].text.split(" is ")[0] in grade.features
