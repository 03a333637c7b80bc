"""Run every variant over the same acquisitions, each shared step once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from itertools import islice
from multiprocessing import get_context

from roemetry.config.dataset import Dataset
from roemetry.config.recipe import Recipe
from roemetry.errors import RoemetryError
from roemetry.records import Acquisition, Reason, Truth
from roemetry.run.pipeline import Pipeline
from roemetry.run.stage_cache import CachedStages, StageCache
from roemetry_tools.compare.aggregate import Aggregate
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.data import Data, Unit, as_taken, changed_file, labelled
from roemetry_tools.compare.ranking import Compared, rank_against
from roemetry_tools.compare.score import Scored, score, unreadable
from roemetry_tools.compare.variants import Variant


def compare(
    variants: Sequence[Variant],
    data: Data,
    *,
    terms: Terms | None = None,
    jobs: int = 1,
    on_scored: Callable[[Variant, Scored], None] = lambda variant, scored: None,
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[Compared, ...]:
    """Compare variants of a recipe; the first is the recipe as it is.

    `jobs` worker processes give the same figures whatever their number, times aside. `on_scored` is called
    with each variant and what it made of an acquisition, acquisitions in order and for each the variants in
    order; `on_progress` with (acquisitions done, of how many).
    """
    recipes = [(variant.number, variant.recipe) for variant in variants if variant.recipe is not None]
    aggregates = {number: Aggregate(recipe, data.without_truth) for number, recipe in recipes}
    by_number = {variant.number: variant for variant in variants}
    on_progress(0, data.count)
    for done, (cold, found) in enumerate(_judged(recipes, data, jobs), start=1):
        for scored in found:
            aggregates[scored.variant].add(scored, cold=cold)
            on_scored(by_number[scored.variant], scored)
        on_progress(done, data.count)
    terms = Terms() if terms is None else terms
    figures = {number: aggregate.figures() for number, aggregate in aggregates.items()}
    base = figures.get(variants[0].number)
    return tuple(
        Compared(variant, own, rank_against(own, None if variant is variants[0] else base, terms))
        for variant in variants
        for own in (figures.get(variant.number),)
    )


Found = tuple[bool, list[Scored]]


def _judged(recipes: Sequence[tuple[int, Recipe]], data: Data, jobs: int) -> Iterator[Found]:
    """Give what each acquisition came to, in order."""
    if jobs == 1 or data.count < 2:
        worker = _Worker(recipes, data.dataset, data.labels)
        for unit in data.units():
            yield worker(unit)
        return
    # Spawned, not forked: a forked copy of numba's or OpenCV's threads can hang.
    with ProcessPoolExecutor(
        min(jobs, data.count), get_context("spawn"), _start_worker, (recipes, data.dataset, data.labels)
    ) as pool:
        waiting: deque[Future[Found]] = deque()
        coming = data.units()
        try:
            while True:
                for unit in islice(coming, 4 * jobs - len(waiting)):
                    waiting.append(pool.submit(_work, unit))
                if not waiting:
                    return
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


class _Worker:
    """Takes one acquisition at a time through all variants."""

    def __init__(
        self, recipes: Sequence[tuple[int, Recipe]], dataset: Dataset | None, labels: Mapping[str, str]
    ) -> None:
        self._labels = labels
        self._source = recipes[0][1].source.make()
        self._dataset = dataset
        self._memory = StageCache()
        self._ways = []
        for number, recipe in recipes:
            stages = CachedStages(recipe, self._memory)
            self._ways.append((number, recipe, stages, Pipeline(recipe, stages=stages.stages)))
        self._cold = True

    def __call__(self, unit: Unit) -> Found:
        cold, self._cold = self._cold, False
        truth: Truth | None = None
        try:
            if unit.item is not None and self._dataset is not None:
                truth = Truth(unit.item.products)
                changed = changed_file(unit.item, unit.reference.files, self._dataset.folder)
                if changed is not None:
                    why = Reason("changed", f"{changed}: has changed since its truth was written")
                    return cold, self._refuse(unit, why, truth)
                truth = self._dataset.truth(unit.item)
            truth = labelled(truth, unit.reference.id, self._labels)
            sensor = None if self._dataset is None else self._dataset.sensor
            acquisition = as_taken(self._source.read(unit.reference), unit.item, sensor)
        except (RoemetryError, OSError) as error:
            return cold, self._refuse(unit, Reason("unreadable", str(error)), truth)
        return cold, self._judge(acquisition, truth)

    def _refuse(self, unit: Unit, why: Reason, truth: Truth | None) -> list[Scored]:
        return [unreadable(number, unit.reference.id, why, truth) for number, *_ in self._ways]

    def _judge(self, acquisition: Acquisition, truth: Truth | None) -> list[Scored]:
        self._memory.clear()
        found = []
        for number, recipe, stages, pipeline in self._ways:
            stages.start()
            trace = pipeline.trace(acquisition)
            seconds = {"source": trace.seconds.get("source", 0.0), **stages.seconds}
            turn_deg = 0 if self._dataset is None else self._dataset.description.turn_deg
            memory = (stages.keys, self._memory)
            found.append(
                score(number, trace, recipe, truth, memory=memory, seconds=seconds, turn_deg=turn_deg)
            )
        return found


_worker: _Worker | None = None


def _start_worker(
    recipes: Sequence[tuple[int, Recipe]], dataset: Dataset | None, labels: Mapping[str, str]
) -> None:
    global _worker
    _worker = _Worker(recipes, dataset, labels)


def _work(unit: Unit) -> Found:
    if _worker is None:
        raise AssertionError("a worker process was not started by _start_worker")
    return _worker(unit)
