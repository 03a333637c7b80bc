"""Run every variant over the same acquisitions, each shared step once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import NamedTuple, TypedDict, Unpack

from roemetry.config.dataset import Dataset
from roemetry.config.recipe import Recipe
from roemetry.errors import RoemetryError
from roemetry.records import Acquisition, Reason, Truth
from roemetry.run.executors import Executor, Lost, Processes
from roemetry.run.pipeline import Pipeline
from roemetry.run.stage_cache import CachedStages, StageCache
from roemetry_tools.compare.agreement import Terms
from roemetry_tools.compare.data import Data, Unit, as_taken, changed_file, labelled
from roemetry_tools.compare.early_stopping import Stopped, beaten, looks
from roemetry_tools.compare.ranking import Compared, rank_against
from roemetry_tools.compare.score import Aggregate, Figures, Scored, score, unreadable
from roemetry_tools.compare.variants import Variant
from roemetry_tools.compare.write import Found, StoredScores


class Measuring(TypedDict, total=False):
    """How variants are measured, and who is told of it."""

    executor: Executor
    """What does the work; by default this process. Figures are the same with any, times aside."""
    kept: StoredScores
    """What was kept of a stopped comparison is not measured again; what is measured now is kept there."""
    on_scored: Callable[[Variant, Scored], None]
    """Called with each variant and what it made of an acquisition, acquisitions in order and for each the
    variants in order."""
    on_progress: Callable[[int, int], None]
    """Called with (acquisitions done, of how many)."""


def compare(
    variants: Sequence[Variant], data: Data, *, terms: Terms | None = None, **how: Unpack[Measuring]
) -> tuple[Compared, ...]:
    """Compare variants of a recipe; the first is the recipe as it is, which is never stopped early."""
    terms = Terms() if terms is None else terms
    figures, stopped = measure(variants, data, stop_early=terms.stop_early, **how)
    base = figures.get(variants[0].number)
    found = []
    for variant in variants:
        own = figures.get(variant.number)
        standing = rank_against(own, None if variant is variants[0] else base, terms)
        found.append(Compared(variant, own, standing, stopped.get(variant.number)))
    return tuple(found)


def measure(
    variants: Sequence[Variant], data: Data, *, stop_early: bool = False, **how: Unpack[Measuring]
) -> tuple[dict[int, Figures], dict[int, Stopped]]:
    """Give what each variant that has a recipe came to, and which of them were stopped; as `compare`."""
    kept = how.get("kept")
    on_scored, on_progress = how.get("on_scored"), how.get("on_progress", _silent)
    recipes = [(variant.number, variant.recipe) for variant in variants if variant.recipe is not None]
    aggregates = {number: Aggregate(recipe, data.without_truth) for number, recipe in recipes}
    by_number = {variant.number: variant for variant in variants}
    tasks = _Tasks(data, set(aggregates))
    stopped: dict[int, Stopped] = {}
    looking = looks()
    next_look = next(looking)
    on_progress(0, data.count)
    before = iter(()) if kept is None else kept.found()
    executor = how.get("executor") or Processes(1)
    results = executor.in_order(_Worker, (recipes, data.dataset, data.labels), tasks)
    # what comes now is made when it is wanted: after what was kept, the tasks are those that are left
    for done, found in enumerate(chain(tasks.counted(before), results), start=1):
        cold, every = _lost(found, tasks.measured, data) if isinstance(found, Lost) else found
        if kept is not None and done > tasks.kept:
            kept.add((cold, every))
        for scored in every:
            if scored.variant in tasks.measured:  # else it was handed out before the variant was stopped
                aggregates[scored.variant].add(scored, cold=cold)
                if on_scored is not None:
                    on_scored(by_number[scored.variant], scored)
        if stop_early and done == next_look:
            next_look = next(looking)
            values = {number: aggregates[number].values for number in tasks.measured}
            beaten_now = beaten(values, len(recipes) - 1, done)
            beaten_now.pop(variants[0].number, None)
            stopped |= beaten_now
            tasks.measured -= beaten_now.keys()
        on_progress(done, data.count)
    return {number: aggregate.figures() for number, aggregate in aggregates.items()}, stopped


def _silent(done: int, of: int) -> None:
    """Tell nobody."""


class _Task(NamedTuple):
    """An acquisition, and the numbers of the variants that are to measure it."""

    unit: Unit
    measured: frozenset[int]


class _Tasks:
    """The acquisitions that are left, each for the variants that are `measured` when it is handed out."""

    def __init__(self, data: Data, measured: set[int]) -> None:
        self._data, self.measured = data, measured
        self.kept = 0
        """Acquisitions that were scored before."""

    def counted(self, found: Iterable[Found]) -> Iterator[Found]:
        """Give what was scored before, and count it."""
        for one in found:
            self.kept += 1
            yield one

    def __len__(self) -> int:
        return self._data.count - self.kept

    def __iter__(self) -> Iterator[_Task]:
        return (_Task(unit, frozenset(self.measured)) for unit in islice(self._data.units(), self.kept, None))


def _lost(lost: Lost[_Task], numbers: set[int], data: Data) -> Found:
    """Refuse, for every variant, an acquisition of which workers died."""
    unit, why = lost.task.unit, Reason("process-died", lost.why)
    truth = labelled(None if unit.item is None else Truth(unit.item.products), unit.reference.id, data.labels)
    return False, [unreadable(number, unit.reference.id, why, truth) for number in sorted(numbers)]


class _Worker:
    """Takes one acquisition at a time through all variants."""

    def __init__(
        self, recipes: Sequence[tuple[int, Recipe]], dataset: Dataset | None, labels: Mapping[str, str]
    ) -> None:
        self._labels, self._dataset, self._memory = labels, dataset, StageCache()
        self._source = recipes[0][1].source.make()
        self._ways = []
        for number, recipe in recipes:
            stages = CachedStages(recipe, self._memory)
            self._ways.append((number, recipe, stages, Pipeline(recipe, stages=stages.stages)))
        self._cold = True

    def __call__(self, task: _Task) -> Found:
        unit = task.unit
        cold, self._cold = self._cold, False
        truth: Truth | None = None
        try:
            if unit.item is not None and self._dataset is not None:
                truth = Truth(unit.item.products)
                changed = changed_file(unit.item, unit.reference.files, self._dataset.folder)
                if changed is not None:
                    why = Reason("changed", f"{changed}: has changed since its truth was written")
                    return cold, self._refuse(task, why, truth)
                truth = self._dataset.truth(unit.item)
            truth = labelled(truth, unit.reference.id, self._labels)
            sensor = None if self._dataset is None else self._dataset.sensor
            acquisition = as_taken(self._source.read(unit.reference), unit.item, sensor)
        except (RoemetryError, OSError) as error:
            return cold, self._refuse(task, Reason("unreadable", str(error)), truth)
        return cold, self._judge(acquisition, truth, task.measured)

    def _refuse(self, task: _Task, why: Reason, truth: Truth | None) -> list[Scored]:
        name = task.unit.reference.id
        return [unreadable(number, name, why, truth) for number, *_ in self._ways if number in task.measured]

    def _judge(self, acquisition: Acquisition, truth: Truth | None, measured: frozenset[int]) -> list[Scored]:
        self._memory.clear()
        turn_deg = 0 if self._dataset is None else self._dataset.description.turn_deg
        found = []
        for number, recipe, stages, pipeline in self._ways:
            if number not in measured:
                continue
            stages.start()
            trace = pipeline.trace(acquisition)
            seconds = {"source": trace.seconds.get("source", 0.0), **(stages.seconds or trace.seconds)}
            memory = (stages.keys, self._memory)
            found.append(score(number, trace, recipe, truth, memory, seconds, turn_deg))
        return found
