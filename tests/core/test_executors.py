"""The time that is left of many tasks, work on a cluster, and kernels compiled before the first run."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import pytest
from distributed import LocalCluster

from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, InterruptedRunError, PluginError
from roemetry.run import cluster
from roemetry.run.batch import run_recipe
from roemetry.run.cluster import Cluster
from roemetry.run.executors import Lost
from roemetry.run.pace import Pace
from roemetry.run.record import RECORD, read_record
from roemetry_paper.zero_order_hold import ZeroOrderHold

THREADS = {"processes": False, "protocol": "tcp", "threads_per_worker": 1, "dashboard_address": ":0"}


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A scheduler and two workers, in threads of this process: they start at once."""
    with LocalCluster(n_workers=2, **THREADS) as made:
        yield made.scheduler_address


class Times:
    """Multiplies; ends its process at some numbers."""

    def __init__(self, factor: int, deadly: frozenset[int] = frozenset()) -> None:
        self.factor, self.deadly = factor, deadly

    def __call__(self, number: int) -> int:
        if number in self.deadly:
            os._exit(9)
        return self.factor * number


def test_a_record_is_the_same_byte_for_byte_and_may_be_gone_on_with(
    line: Any, address: str, tmp_path: Path
) -> None:
    recipe = Recipe.load(line(6))
    run_recipe(recipe, tmp_path / "one")
    whole = (tmp_path / "one" / RECORD).read_bytes()
    seen: list[int] = []
    executor = Cluster(address)
    run_recipe(recipe, tmp_path / "many", executor=executor, on_progress=lambda done, _: seen.append(done))
    assert (tmp_path / "many" / RECORD).read_bytes() == whole
    assert seen == [0, 1, 2, 3, 4, 5, 6]
    first = whole.splitlines(keepends=True)[0]
    (tmp_path / "many" / RECORD).write_bytes(first + b'{"id": "p0')
    run_recipe(recipe, tmp_path / "many", executor=executor, resume=True)
    assert (tmp_path / "many" / RECORD).read_bytes() == whole


def test_chunks_come_in_order_and_their_window_is_bounded(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "_CHUNK_MAX", 7)
    asked: list[int] = []

    class Asked(list[int]):
        def __iter__(self) -> Iterator[int]:
            for number in range(1000):
                asked.append(number)
                yield number

    found = Cluster(address).in_order(Times, (3,), Asked())
    ahead = []
    for number, result in enumerate(found):
        assert result == 3 * number
        ahead.append(len(asked) - number)
    assert len(ahead) == 1000
    assert max(ahead) <= 2 * 4 * 7 + 7


def test_a_task_that_kills_its_workers_is_lost_and_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_CHUNK_S", 1.0)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(n_workers=1, **THREADS | {"processes": True}) as made,
    ):
        found = list(Cluster(made.scheduler_address).in_order(Times, (3, frozenset({5})), range(40)))
    (lost,) = (one for one in found if isinstance(one, Lost))
    assert lost.task == 5
    assert [one for one in found if one is not lost] == [3 * number for number in range(40) if number != 5]


def test_a_stage_that_hangs_ends_on_a_worker_too(
    line: Any, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hangs(*_: Any, **__: Any) -> None:
        while True:
            pass

    monkeypatch.setattr(ZeroOrderHold, "estimate", hangs)
    recipe = Recipe.load(line(2), sets=["stage_timeout_s=0.3"])
    assert run_recipe(recipe, tmp_path / "out", executor=Cluster(address)).counts["failed"] == 2
    for row in read_record(tmp_path / "out"):
        assert "had not finished after 0.3 s" in row.absent["volume"].text
        assert row.grade is not None


def test_a_lost_image_is_one_failed_row(line: Any, tmp_path: Path) -> None:
    class LosesTheSecond:
        def in_order(self, make: Any, given: Any, tasks: Any) -> Iterator[Any]:
            worker = make(*given)
            for number, task in enumerate(tasks):
                yield Lost(task, "every worker died") if number == 1 else worker(task)

    outcome = run_recipe(Recipe.load(line(3)), tmp_path / "out", executor=LosesTheSecond())
    assert outcome.counts == {"measured": 2, "empty": 0, "failed": 1}
    rows = list(read_record(tmp_path / "out"))
    assert [row.acquisition for row in rows] == ["p01", "p02", "p03"]
    assert [reason.code for reason in rows[1].reasons] == ["process-died"]


def test_workers_with_other_software_are_refused_before_the_first_task(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = cluster.software()

    def theirs() -> dict[str, str]:
        here = threading.current_thread() is threading.main_thread()
        return mine if here else mine | {"roemetry": "another"}

    monkeypatch.setattr(cluster, "software", theirs)
    with pytest.raises(PluginError, match=r"tcp://.*: roemetry is another, here it is") as error:
        next(Cluster(address).in_order(os._exit, (), [1]))
    assert "install the same" in str(error.value)


def test_software_is_told_by_the_code_of_plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = cluster.software()
    assert {"roemetry", "roemetry_files", "roemetry_paper", "numpy", "python"} <= told.keys()
    package = tmp_path / "somebody"
    package.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    hashes = set()
    for text in ("x = 1\n", "x = 2\n"):
        (package / "__init__.py").write_text(text, "utf-8")
        hashes.add(cluster._code_of("somebody"))
    assert len(hashes) == 2


@pytest.mark.parametrize("wrong", ["tcp://127.0.0.1:9", "somewhere"])
def test_where_no_scheduler_is_one_message_says_so(wrong: str) -> None:
    with pytest.raises(ConfigurationError, match=f"{wrong}: there is no dask scheduler") as error:
        next(Cluster(wrong).in_order(Times, (3,), [1]))
    assert "--cluster local" in str(error.value)


def test_a_scheduler_that_goes_away_leaves_a_run_to_go_on_with() -> None:
    with LocalCluster(n_workers=1, **THREADS) as made:
        found = Cluster(made.scheduler_address).in_order(Times, (3,), range(100_000))
        assert [next(found) for _ in range(3)] == [0, 3, 6]
        made.close()
        with pytest.raises(InterruptedRunError, match="scheduler is gone") as error:
            list(found)
    assert "--resume" in str(error.value)


class Clock:
    """A clock that is put forward by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_few_dear_steps_after_many_cheap_ones_are_told_by_their_own_cost() -> None:
    clock = Clock()
    pace = Pace({"cheap": 10, "dear": 3}, clock=clock)
    assert math.isnan(pace.left_s())
    for _ in range(10):
        clock.now += 0.1
        pace.done("cheap")
    assert pace.left_s() == pytest.approx(0.3)  # nothing is known of the dear ones yet
    clock.now += 20.0
    pace.done("dear")
    assert pace.left_s() == pytest.approx(40.0)
    for _ in range(2):
        clock.now += 20.0
        pace.done("dear")
    assert pace.left_s() == 0.0


def test_a_kind_that_has_not_come_yet_costs_what_is_said_of_it() -> None:
    clock = Clock()
    pace = Pace({"image": 4, "fit": 1}, cost={"fit": 10.0}, clock=clock)
    clock.now += 2.0
    pace.done("image")
    assert pace.left_s() == pytest.approx(3 * 2.0 + 20.0)


COUNT = """
import json
import sys

import roemetry
from roemetry.cli.warm_up import warm_up

if __name__ == "__main__":
    told = []
    quick = ["stages.extractor=log-parabola", "stages.coder=ordered", "stages.aligner=null"]
    recipe = roemetry.Recipe.load(sys.argv[1], sets=quick)
    kinds = warm_up(recipe.stages, lambda done, of: told.append((done, of)))
    print(json.dumps([kinds, told]))
"""


def test_kernels_are_compiled_once(root: Path, tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "NUMBA_OPT": "1"}
    environment.pop("NUMBA_DISABLE_JIT", None)
    script = tmp_path / "count.py"
    script.write_text(COUNT, encoding="utf-8")
    command = [sys.executable, str(script), str(root / "recipes/herring_roe")]
    (kinds, told), again = (
        json.loads(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)
        for _ in range(2)
    )
    assert {"extractor", "coder"} <= set(kinds)
    done, of = zip(*told, strict=True)
    assert len(told) == len(kinds) + 1
    assert done == tuple(sorted(set(done)))
    assert (done[0], {done[-1]}) == (0, set(of))
    assert again == [[], []], "what lies on disk is not compiled again"
    assert list((tmp_path / "cache").rglob("*.nbi"))
