"""Early stops: the best is hardly ever stopped, a worse one soon, and the same ones by any executor."""

from __future__ import annotations

import math
from itertools import takewhile

import numpy as np
import pytest
from distributed import LocalCluster

from roemetry.errors import InterruptedRunError, OutputError
from roemetry.run.cluster import Cluster
from roemetry.run.executors import Lost, Processes
from roemetry.stages.registry import discover
from roemetry_tools.compare import early_stopping
from roemetry_tools.compare.agreement import PairedValue, Terms
from roemetry_tools.compare.comparison import compare
from roemetry_tools.compare.data import Data
from roemetry_tools.compare.early_stopping import DOUBT, ERROR_MAX_PCT, beaten, capital, looks
from roemetry_tools.compare.tables import flat
from roemetry_tools.compare.variants import make_variants
from roemetry_tools.compare.write import KEPT, ItemsFile, StoredScores

AT = list(takewhile(lambda at: at <= 1000, looks()))


def stopped_at(differences: np.ndarray) -> float:
    """After how many of (specimen,) differences a variant is stopped; inf for never."""
    return next((at for at in AT if capital(differences[:at]) > math.log(1.0 / DOUBT)), math.inf)


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng, n: np.abs(rng.normal(0, 5, n)) - np.abs(rng.normal(0, 5, n)),
        # as good on the whole: always 1 % worse, but the other one fails at 2 % of the products
        lambda rng, n: 1.0 - np.where(rng.random(n) < 0.02, 50.0, 0.0),
        lambda rng, n: rng.choice([-ERROR_MAX_PCT, ERROR_MAX_PCT], n),
    ],
    ids=["normal", "rare failures", "wild"],
)
def test_one_that_is_as_good_is_stopped_as_rarely_as_promised(draw, rng) -> None:
    """Of 300 races of the promised rate at most, nine stops or more come once in 400 such tests."""
    assert sum(math.isfinite(stopped_at(draw(rng, 1000))) for _ in range(300)) <= 8


def test_one_that_is_worse_is_stopped_soon(rng) -> None:
    at = [stopped_at(rng.normal(3.0, 2.0, 1000)) for _ in range(50)]
    assert np.median(at) <= 200
    assert max(at) <= 500


def test_a_specimen_that_comes_again_is_one_witness() -> None:
    def values(error: float, readings: int) -> dict[str, dict[str, PairedValue]]:
        names = [(f"p{s}-{r}", f"s{s}") for s in range(25) for r in range(readings)]
        of = {name: PairedValue(100.0 + error, 100.0, name, specimen) for name, specimen in names}
        return {"visible_mm3": of, "true_mm3": {}, "mass_g": {}}

    for readings in (1, 40):
        assert beaten({0: values(1.0, readings), 1: values(4.0, readings)}, 1, 25 * readings) == {}
    found = beaten({0: values(1.0, 2), 3: values(40.0, 2)}, 1, 50)
    assert found.keys() == {3}
    assert found[3] == (0, "visible_mm3", pytest.approx(39.0), 25, 50)


def test_what_is_stopped_is_the_same_by_any_executor(dataset, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(early_stopping, "SPECIMENS_MIN", 4)
    monkeypatch.setattr(early_stopping, "DOUBT", 0.99)
    variants = make_variants(
        dataset(12), ["stages.weigher.options.density_g_per_cm3=1.54,9"], registry=discover()
    )
    data, told = Data(variants[0].recipe), []
    with LocalCluster(
        n_workers=2, processes=False, protocol="tcp", threads_per_worker=1, dashboard_address=":0"
    ) as made:
        for name, executor in (("one", Processes(1)), ("many", Cluster(made.scheduler_address))):
            with ItemsFile(tmp_path / name) as file:
                terms = Terms(stop_early=True)
                found = compare(variants, data, terms=terms, executor=executor, on_scored=file.add)
            figures = [{k: v for k, v in flat(one).items() if not k.startswith("time_")} for one in found]
            told.append((figures, (tmp_path / name / "items.jsonl").read_text("utf-8")))
            assert [one.status for one in found] == ["compared", "stopped", "stopped"]
            assert [one.figures.acquisitions for one in found] == [
                12,
                *(one.stopped[-1] for one in found[1:]),
            ]
            assert max(one.figures.acquisitions for one in found[1:]) < 12
    assert told[0] == told[1]


def test_an_acquisition_of_which_workers_die_is_refused_for_every_variant(dataset) -> None:
    class LosesTheFirst:
        def in_order(self, make, given, tasks):
            worker = make(*given)
            for number, task in enumerate(tasks):
                yield Lost(task, "every worker died") if number == 0 else worker(task)

    variants = make_variants(dataset(), ["extractor=log-parabola"], registry=discover())
    found = compare(variants, Data(variants[0].recipe), executor=LosesTheFirst())
    for one in found:
        assert [(cause.code, cause.count) for cause in one.figures.causes] == [("process-died", 1)]
        assert one.figures.classes.n == 3


def test_the_verb_says_what_was_stopped(dataset, tmp_path, monkeypatch, roemetry, capsys) -> None:
    monkeypatch.setattr(early_stopping, "SPECIMENS_MIN", 4)
    monkeypatch.setattr(early_stopping, "DOUBT", 0.99)
    vary = "stages.weigher.options.density_g_per_cm3=1.54"
    assert roemetry(dataset(8), "--vary", vary, "--stop-early", "--out", tmp_path / "out") == 0
    printed = capsys.readouterr().out
    assert printed.startswith("winner: `recipe`: the others are certainly worse")
    assert "percentage points more than that of `recipe`" in printed
    assert ",stopped," in (tmp_path / "out" / "comparison.csv").read_text("utf-8")


def test_a_comparison_that_was_stopped_goes_on_where_it_was(dataset, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(early_stopping, "SPECIMENS_MIN", 2)
    monkeypatch.setattr(early_stopping, "DOUBT", 0.99)
    density = "stages.weigher.options.density_g_per_cm3"
    path = dataset(9)
    variants = make_variants(path, [f"{density}=1.54,9"], registry=discover())
    data, terms = Data(variants[0].recipe), Terms(stop_early=True)

    class Stops:
        def __init__(self, after: int) -> None:
            self.after, self.asked = after, 0

        def in_order(self, make, given, tasks):
            worker, left = make(*given), len(tasks)
            for task in tasks:
                if self.asked == self.after:
                    raise InterruptedRunError("the scheduler is gone")
                self.asked += 1
                yield worker(task)
            assert self.asked == left

    def compared(name: str, executor: Stops, resume: bool = False):
        with (
            ItemsFile(tmp_path / name, resume=resume) as file,
            StoredScores(tmp_path / name, variants, data, terms, resume=resume) as kept,
        ):
            found = compare(variants, data, terms=terms, executor=executor, kept=kept, on_scored=file.add)
        return [(one.stopped, one.figures.errors) for one in found]

    whole = compared("whole", Stops(99))
    with pytest.raises(InterruptedRunError):
        compared("stopped", Stops(4))
    with (tmp_path / "stopped" / KEPT).open("a", encoding="ascii") as file:
        file.write("half a li")
    with pytest.raises(OutputError, match="there is a comparison in this folder already"):
        compared("stopped", Stops(99))
    rest = Stops(99)
    assert compared("stopped", rest, resume=True) == whole
    assert rest.asked == 5
    items = [(tmp_path / name / "items.jsonl").read_text("utf-8") for name in ("whole", "stopped")]
    assert items[0] == items[1]
    with pytest.raises(OutputError, match="of other variants, data or terms"):
        StoredScores(tmp_path / "whole", variants[:2], data, terms, resume=True)
