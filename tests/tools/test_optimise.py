"""The search finds what the truth was made with; what it chose is judged by what it never saw."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from functools import partial

import pytest

from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, DataError
from roemetry.records import Estimate, Measurement, ProductTruth, Shares, Volume
from roemetry.stages.registry import discover
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.score import Pair, Scored
from roemetry_tools.compare.variants import Space, Variant
from roemetry_tools.optimise import Search, Trial, Trueness, field_of, finalists, front_of
from tests.command import exit_code
from tests.tools.compare.conftest import dataset

__all__ = ["dataset"]

DENSITY = "stages.weigher.options.density_g_per_cm3"


@pytest.fixture
def optimise(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    return partial(exit_code, monkeypatch, "optimise")


def test_the_density_that_the_truth_was_made_with_is_found(dataset, tmp_path, optimise, capsys) -> None:
    """Masses are 0.8 times what a density of 1.1 gives."""
    path, out = dataset(4), tmp_path / "out"
    words = [path, "--vary", f"{DENSITY}=0.7..1.1", "--by", "weight", "--trials", "9", "--out", out]
    assert optimise(*words) == 0
    printed = capsys.readouterr().out
    with (out / "trials.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["name"] == "recipe"
    assert float(rows[0]["error_pct"]) == pytest.approx(25.0)
    for row in rows[1:]:
        off = 100.0 * abs(float(row[f"set {DENSITY}"]) / 0.88 - 1.0)
        assert float(row["error_pct"]) == pytest.approx(min(off, 100.0), abs=1e-3)
    best = min(rows, key=lambda row: float(row["error_pct"]))
    assert float(best["error_pct"]) < 5.0
    assert best["front"] == "true"
    assert f"`{best['name']}` was nearest to the truth in the search; held out" in printed
    assert f"to use it: --set {DENSITY}=" in printed
    told = json.loads((out / "comparison.json").read_text("utf-8"))
    assert (told["data"]["part"], told["data"]["acquisitions"]) == ("held out", 1)
    assert optimise(*words) == 1
    assert "there is a comparison in this folder already" in capsys.readouterr().err


def test_a_search_that_was_stopped_goes_on_where_it_was(
    dataset, tmp_path, optimise, monkeypatch, capsys
) -> None:
    """Stopped in the first and the second batch and in the last word; nothing is measured twice."""
    asked: list[int] = []

    class Stops:
        after = 10**9

        def in_order(self, make, given, tasks):
            worker = make(*given)
            for task in tasks:
                if len(asked) == Stops.after:
                    raise KeyboardInterrupt
                asked.append(len(task.measured))
                yield worker(task)

    monkeypatch.setattr("roemetry_tools.optimise.executor_of", lambda cluster, jobs: Stops())
    words = [dataset(4), "--vary", f"{DENSITY}=0.7..1.1", "--by", "weight", "--trials", "9", "--out"]
    assert optimise(*words, tmp_path / "whole") == 0
    work = list(asked)
    assert len(work) == 3 + 3 + 1  # three acquisitions to choose by, twice; one held out
    asked.clear()
    for Stops.after in (2, 5, 6):
        assert optimise(*words, tmp_path / "out", *(["--resume"] if asked else [])) == 130
    assert optimise(*words, tmp_path / "out") == 1
    assert "there is a search in this folder that was stopped" in capsys.readouterr().err
    Stops.after = 10**9
    assert optimise(*words, tmp_path / "out", "--seed", "2", "--resume") == 1
    assert "of another recipe, space, seed or data" in capsys.readouterr().err
    kept = tmp_path / "out" / ".tried"
    whole = kept.read_text("utf-8")
    kept.write_text(whole + "[1]\n", "utf-8")
    assert optimise(*words, tmp_path / "out", "--resume") == 1
    assert "damaged, or of another roemetry" in capsys.readouterr().err
    kept.write_text(whole, "utf-8")
    assert optimise(*words, tmp_path / "out", "--resume") == 0
    assert asked[:6] == work[:6]  # which of them reach the last word depends on times
    assert len(asked) == len(work)

    def tried(name: str) -> list[dict[str, str]]:
        with (tmp_path / name / "trials.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        return [{key: value for key, value in row.items() if key not in ("time_ms", "front")} for row in rows]

    assert tried("out") == tried("whole")
    assert not list((tmp_path / "out").glob(".*"))


def test_no_specimen_is_in_both_parts(dataset) -> None:
    path = dataset(6)
    items = path.parent / "items.jsonl"
    lines = [json.loads(line) for line in items.read_text("utf-8").splitlines()]
    for number, line in enumerate(lines):
        line["products"][0]["figures"] = {"specimen": float(number // 2)}
    items.write_text("".join(json.dumps(line) + "\n" for line in lines), "utf-8")
    data = Data(Recipe.load(path))
    assert (field_of(data, None), field_of(data, "mass_g")) == ("visible_mm3", "mass_g")
    with pytest.raises(DataError, match="knows no true volume of any product"):
        field_of(data, "true_mm3")
    for seed in range(5):
        first, second = data.parted(0.3, seed)
        names = [
            {unit.item.products[0].figures["specimen"] for unit in part.units()} for part in (first, second)
        ]
        assert not names[0] & names[1]
        assert (first.count, second.count) == (4, 2)
        assert sum(1 for _ in first.units()) == 4
    assert len({tuple(u.reference.id for u in data.parted(0.3, seed)[1].units()) for seed in range(5)}) > 1


def test_what_is_not_measured_is_no_advantage() -> None:
    true = ProductTruth(visible_mm3=100.0)
    found = Measurement(
        "a#1",
        "a",
        status="measured",
        volume=Volume(Estimate(103.0, 1.0), None, Shares(1.0, 0.0, 0.0)),
        product=1,
    )
    trueness, variant = Trueness("visible_mm3"), Variant(3, "three", {}, None)
    trueness.add(variant, Scored(3, "a", (Pair(1, found, true),), None))
    assert trueness.of(3) == (pytest.approx(3.0), 0)
    trueness.add(variant, Scored(3, "b", (Pair(1, None, true), Pair(2, found, None)), None))
    assert trueness.of(3) == (pytest.approx(51.5), 1)
    assert math.isnan(trueness.of(4)[0])


def trial(number: int, error_pct: float, time_ms: float) -> Trial:
    return Trial(Variant(number, str(number), {}, None), error_pct, 0, time_ms)


def test_the_front_is_what_no_other_beats() -> None:
    tried = [
        trial(0, 5, 5),
        trial(1, 1, 9),
        trial(2, 2, 9),
        trial(3, 3, 4),
        trial(4, math.nan, 1),
        trial(5, 9, 1),
    ]
    assert [one.variant.number for one in front_of(tried)] == [1, 3, 5]
    many = [trial(k, float(k), 100.0 - k) for k in range(50)]
    ends = finalists(many)
    assert len(ends) == 6
    assert (ends[0], ends[-1]) == (many[0], many[-1])
    assert finalists([]) == []


@pytest.mark.parametrize("wrong", ["60..5", "0..5:log", "1..2:cube", "a..b"])
def test_a_wrong_range_is_refused(line, wrong: str) -> None:
    space = Space(line(1), [f"{DENSITY}={wrong}"], sets=(), registry=discover())
    with pytest.raises(ConfigurationError, match=r"expected LOW\.\.HIGH"):
        Search(space, 1)
