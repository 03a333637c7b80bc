"""Weights from weighed samples: the model that made them is found again, intervals hold, faults are named."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roemetry.calibrating.known_products import read_weighed, read_weights
from roemetry.config.dataset import Dataset
from roemetry.errors import ConfigurationError, DataError, StageError
from roemetry.records import Samples
from roemetry.testing.runs import volume_of
from roemetry.testing.solids import DENSE, HALF_ELLIPSOID, product_of
from roemetry_paper.density import Density
from roemetry_volume.fitted_weight import (
    FittedWeight,
    FittedWeightOptions,
    WeightModel,
    check_masses,
    fit_weights,
    weight_features,
)
from tests.command import typed

HOME = Path(__file__).resolve().parents[3] / "recipes" / "herring_roe"
NAMES = ("visible_cm3", "end_share", "rim_share", "rim_bow_share")


def samples(
    rng: np.random.Generator, count: int, scatter: float = 0.02, slope: float = -0.4, offset_g: float = 0.0
) -> Samples:
    """Mass = V (1.2 + slope · rim_share) + offset, with a scatter relative to it; end_share is noise."""
    visible, rim = rng.uniform(8.0, 40.0, count), rng.uniform(0.2, 0.7, count)
    mass = (visible * (1.2 + slope * rim) + offset_g) * (1.0 + scatter * rng.standard_normal(count))
    values = np.column_stack([visible, rng.uniform(0.2, 0.7, count), rim, rng.uniform(-0.2, 0.0, count)])
    ids = tuple(f"p{k}" for k in range(count))
    return Samples(ids, ids, NAMES, values, mass_g=mass, mass_std_g=np.full(count, np.nan))


def loaded(content: str, folder: Path) -> WeightModel:
    path = folder / "weight.json"
    path.write_text(content, encoding="utf-8")
    return WeightModel.load(path)


def test_the_law_that_made_the_masses_is_found(rng: np.random.Generator, tmp_path: Path) -> None:
    exact = fit_weights(samples(rng, 400, scatter=0.0), form="rim")
    model = loaded(exact.content, tmp_path)
    for rim in (0.25, 0.45, 0.65):
        ratio, _, _ = model.ratio({"end_share": 0.4, "rim_share": rim, "rim_bow_share": -0.1})
        # The ridge weighs one sample in 400.
        assert ratio == pytest.approx(1.2 - 0.4 * rim, abs=5e-4)
    plain = loaded(fit_weights(samples(rng, 50, scatter=0.0, slope=0.0), form="scale").content, tmp_path)
    assert plain.ratio({})[0] == pytest.approx(1.2, abs=1e-12)
    apart = loaded(
        fit_weights(samples(rng, 400, scatter=0.0, slope=0.0, offset_g=5.0), form="offset").content, tmp_path
    )
    assert 20.0 * apart.ratio({"per_cm3": 1 / 20.0})[0] == pytest.approx(29.0, abs=0.02)


def test_auto_takes_the_plainest_form_that_does(rng: np.random.Generator) -> None:
    assert json.loads(fit_weights(samples(rng, 60), form="auto").content)["form"] == "rim"
    flat = [
        json.loads(fit_weights(samples(rng, 30, slope=0.0), form="auto").content)["form"] for _ in range(20)
    ]
    assert flat.count("scale") >= 14
    assert (
        json.loads(fit_weights(samples(rng, 60, scatter=0.01, slope=0.0, offset_g=8.0)).content)["form"]
        == "offset"
    )


@pytest.mark.thorough
def test_intervals_of_20_samples_hold_what_they_say(rng: np.random.Generator, tmp_path: Path) -> None:
    """Over 120 draws of 20 samples, each judged on 50 others: standard error of the mean about 0.6 %."""
    from scipy.stats import t

    held = []
    for _ in range(120):
        model = loaded(fit_weights(samples(rng, 20), form="rim").content, tmp_path)
        fresh = samples(rng, 50)
        factor = t.ppf(0.975, model.degrees_of_freedom) / model.student_std
        for values, mass in zip(fresh.values, fresh.mass_g, strict=True):
            ratio, of_fit, scatter = model.ratio(dict(zip(NAMES, values, strict=True)))
            held.append(abs(ratio - mass / values[0]) <= factor * math.hypot(of_fit, scatter))
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)


def test_the_weigher_states_what_the_model_says(rng: np.random.Generator, tmp_path: Path) -> None:
    product, volume = product_of(HALF_ELLIPSOID), volume_of(12_000.0)
    bare = FittedWeight().weigh(product, volume)
    assert math.isnan(bare.mass_g.value)
    assert bare.reasons[0].code == "no-weight-model"
    assert bare.features == weight_features(product, volume)
    path = tmp_path / "weight.json"
    given = samples(rng, 25, slope=0.0)
    path.write_text(fit_weights(given, form="scale").content, encoding="utf-8")
    weigher = FittedWeight(FittedWeightOptions(model=path))
    weight = weigher.weigh(product, volume)
    low, high = weight.mass_g.interval
    assert weight.mass_g.value == pytest.approx(12.0 * (given.mass_g / given.values[:, 0]).mean(), abs=1e-9)
    assert low < weight.mass_g.value < high
    assert sum(part**2 for part in weight.mass_g.budget.values()) == pytest.approx(weight.mass_g.std**2)
    draws = [weigher.weigh(product, volume, rng=rng).mass_g.value for _ in range(800)]
    assert np.std(draws) == pytest.approx(weight.mass_g.std, rel=0.12)
    assert np.quantile(draws, 0.975) == pytest.approx(high, abs=0.12 * (high - low))


def test_beyond_the_samples_it_says_so(rng: np.random.Generator, tmp_path: Path) -> None:
    path = tmp_path / "weight.json"
    path.write_text(fit_weights(samples(rng, 25), form="scale").content, encoding="utf-8")
    weigher = FittedWeight(FittedWeightOptions(model=path))
    (reason,) = weigher.weigh(product_of(HALF_ELLIPSOID), volume_of(90_000.0)).reasons
    assert reason.code == "outside-weighed"
    assert "visible_cm3 is 90, the weighed samples have" in reason.text
    path.write_text(fit_weights(samples(rng, 25), form="rim").content, encoding="utf-8")
    missing = FittedWeight(FittedWeightOptions(model=path)).weigh(product_of(HALF_ELLIPSOID), volume_of(9e3))
    assert math.isnan(missing.mass_g.value)
    assert missing.reasons[0].code == "weight-feature-missing"
    (tmp_path / "bad.json").write_text("{}", encoding="utf-8")
    with pytest.raises(StageError, match=r"bad.json is no fitted weigher"):
        FittedWeight(FittedWeightOptions(model=tmp_path / "bad.json")).weigh(
            product_of(HALF_ELLIPSOID), volume_of(9e3)
        )


def test_features_do_not_depend_on_size_or_side() -> None:
    one = weight_features(product_of(HALF_ELLIPSOID), volume_of(9000.0))
    other = weight_features(product_of(HALF_ELLIPSOID.mirrored(), DENSE.mirrored()), volume_of(9000.0))
    large = weight_features(product_of(HALF_ELLIPSOID.scaled(1.2)), volume_of(9000.0))
    assert other["end_share"] == pytest.approx(one["end_share"], abs=0.01)
    assert large["end_share"] == pytest.approx(one["end_share"], abs=0.03)


def test_what_is_bridged_down_to_the_belt_is_no_rim() -> None:
    """Three rows at each end of each slice that fall to the belt, not seen."""
    product = product_of(HALF_ELLIPSOID)
    profiles = product.profiles
    xyz, seen, whose = profiles.xyz_mm.copy(), profiles.seen.copy(), profiles.product.copy()
    x_px, row_px = profiles.x_px.copy(), profiles.row_px.copy()
    step = float(np.nanmedian(np.diff(xyz[30, :, 1])))
    for one in range(profiles.slice_count):
        mine = np.flatnonzero(whose[one] == 1)
        for end, way in ((mine[0], -1), (mine[-1], 1)) if mine.size > 8 else ():
            for k in (1, 2, 3):
                at = end + k * way
                xyz[one, at] = xyz[one, end] + np.array([0.0, k * way * step, 0.0])
                xyz[one, at, 2] *= 1.0 - k / 4.0
                x_px[one, at], row_px[one, at] = x_px[one, end], float(at)
                whose[one, at], seen[one, at] = 1, False
    bridged = replace(profiles, xyz_mm=xyz, seen=seen, product=whose, x_px=x_px, row_px=row_px)
    one = weight_features(product, volume_of(9000.0))
    assert weight_features(replace(product, profiles=bridged), volume_of(9000.0)) == one


@pytest.mark.parametrize(
    ("factor", "named"),
    [(1e-3, "kilograms"), (1 / 28.3495, "ounces"), (1 / 453.592, "pounds"), (1e3, "milligrams")],
)
def test_masses_in_another_unit_are_named(factor: float, named: str, rng: np.random.Generator) -> None:
    given = samples(rng, 30)
    with pytest.raises(DataError, match="these are not grams") as caught:
        fit_weights(replace(given, mass_g=factor * given.mass_g), form="auto")
    assert named in str(caught.value)
    some = given.mass_g.copy()
    some[[3, 7]] *= factor
    with pytest.raises(DataError, match=rf"2 of 30 masses are off by the factor of {named} \(p3, p7\)"):
        fit_weights(replace(given, mass_g=some), form="auto")


def test_rows_that_were_mixed_up_are_refused_and_right_ones_are_not(rng: np.random.Generator) -> None:
    """Ten products: of shuffled masses one table in twenty agrees by chance; scatter of 5 % is no mix-up."""
    refused = {"shuffled": 0, "right": 0}
    names = [f"p{number}" for number in range(10)]
    for _ in range(60):
        visible = rng.uniform(12.0, 35.0, 10)
        masses = visible * rng.normal(0.95, 0.05, 10)
        for what, given in (("right", masses), ("shuffled", rng.permutation(masses))):
            try:
                check_masses(names, given, visible)
            except DataError:
                refused[what] += 1
    assert refused["shuffled"] >= 50
    assert refused["right"] <= 2


def test_what_cannot_be_learned_from_is_named(rng: np.random.Generator) -> None:
    given = samples(rng, 40)
    with pytest.raises(DataError, match="masses do not follow the volumes"):
        fit_weights(replace(given, mass_g=rng.permutation(given.mass_g)), form="auto")
    mass = given.mass_g[:4]
    few = Samples(given.ids[:4], given.ids[:4], NAMES, given.values[:4], mass_g=mass, mass_std_g=mass)
    unmeasured = replace(given, values=np.full_like(given.values, np.nan))
    for samples_, form, says in (
        (few, "auto", "only 4 weighed products"),
        (replace(given, features=("a", *NAMES[1:])), "auto", "no column `visible_cm3`"),
        (
            replace(given, features=("visible_cm3", "x", *NAMES[2:])),
            "ends",
            "the form `ends` needs end_share",
        ),
        (given, "cubic", "there is no form `cubic`"),
        (unmeasured, "auto", "no weighed product has a measured volume"),
    ):
        with pytest.raises((DataError, StageError), match=says):
            fit_weights(samples_, form=form)
    with pytest.raises(StageError, match="does not learn"):
        Density.fit(given)
    swapped = given.mass_g.copy()
    swapped[5] *= 1.4
    assert "look at p5:" in " ".join(fit_weights(replace(given, mass_g=swapped), form="rim").words)


def test_twins_do_not_judge_each_other(rng: np.random.Generator) -> None:
    """Ten products of odd density, each weighed five times: by group the error is the density's."""
    visible = np.repeat(rng.uniform(8.0, 40.0, 10), 5)
    shape = np.repeat(rng.normal(size=(10, 3)), 5, axis=0)
    density = np.repeat(1.0 + 0.05 * rng.standard_normal(10), 5)
    ids, groups = tuple(map(str, range(50))), tuple(str(k // 5) for k in range(50))
    values = np.column_stack([visible, shape])
    given = Samples(ids, groups, NAMES, values, mass_g=visible * density, mass_std_g=np.full(50, np.nan))
    by_group = fit_weights(given, form="rim").figures["error_mean_share"]
    by_line = fit_weights(replace(given, groups=ids), form="rim").figures["error_mean_share"]
    assert by_group > 1.15 * by_line


def table(path: Path, header: list[str], *rows: list[Any]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])
    return path


@pytest.mark.parametrize(
    ("header", "rows", "said"),
    [
        (["id", "mass_g"], [], "the table is empty"),
        (["id", "mass_kg"], [["p1", 0.02]], "no column `mass_g`"),
        (["name", "mass_g"], [["p1", 20]], "no column `id`"),
        (["id", "mass_g"], [["p1", "20,1"]], r"w.csv:2: mass_g: found '20,1', expected a number"),
        (["id", "mass_g"], [["p1", -3]], r"w.csv:2: mass_g: found -3, expected a mass above 0"),
        (["id", "mass_g"], [["p1", 20], ["p1", 21]], r"w.csv:3: p1 stands there a second time"),
        (["id", "mass_g"], [["p1", ""]], "no product has a mass"),
    ],
)
def test_a_faulty_table_of_weights_is_named(
    header: list[str], rows: list[list[Any]], said: str, tmp_path: Path
) -> None:
    with pytest.raises((DataError, ConfigurationError), match=said):
        read_weights(table(tmp_path / "w.csv", header, *rows))


def test_ids_that_do_not_meet_are_named(tmp_path: Path) -> None:
    measured = table(tmp_path / "m.csv", ["id", "acquisition", "visible_cm3"], ["a#1", "a", 20.0])
    weights = table(tmp_path / "w.csv", ["id", "mass_g"], ["b", 20.0])
    with pytest.raises(DataError, match="the ids of the two tables do not meet"):
        read_weighed(measured, weights)
    met = read_weighed(measured, table(tmp_path / "v.csv", ["id", "mass_g", "mass_std_g"], ["a", 20.0, 0.1]))
    assert (met.ids, met.groups, met.features) == (("a#1",), ("a",), ("visible_cm3",))
    assert (met.mass_g[0], met.mass_std_g[0]) == (20.0, 0.1)


def test_from_a_run_to_weights_and_back(tmp_path: Path) -> None:
    """Ten shipped skeins, their true masses from the truth: run, fit, run, check."""

    def run(out: str, *sets: str) -> Path:
        told = [word for one in ("stages.classifier=", "uncertainty=none", *sets) for word in ("--set", one)]
        typed("run", HOME, *told, "--out", tmp_path / out)
        return tmp_path / out

    def weights(name: str, factor: float) -> Path:
        rows = [[item.id, factor * data.truth(item).products[0].mass_g] for item in data.items()]
        return table(tmp_path / name, ["id", "mass_g"], *rows)

    data, model = Dataset(HOME), tmp_path / "weight.json"
    first = run("a", "stages.weigher=fitted", "sinks=[{use: csv, options: {features: true}}]")
    right = weights("weights.csv", 1.0)
    said = typed("fit-weight", first / "results.csv", "--weights", right, "--out", model).output
    assert "10 weighed products" in said
    second = run("b", f"stages.weigher={{use: fitted, options: {{model: {model}}}}}")
    found = json.loads(typed("check-weight", second, right, "--json").output)
    assert (found["verdict"], found["pairs"]) == ("holds", 10)
    assert "fit again" in typed("check-weight", second, weights("heavy.csv", 1.2), code=1).output
