"""Steps are done once: each result of an acquisition is cached by all that decides it."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, NamedTuple

from roemetry.config.recipe import Recipe
from roemetry.errors import FAULTS
from roemetry.records import Product
from roemetry.stages import INTERFACES

_BEFORE: Mapping[str, tuple[str, ...]] = {
    "extractor": (),
    "aligner": ("extractor",),
    "coder": ("extractor", "aligner"),
    "smoother": ("coder",),
    "outliner": ("smoother", "coder"),
    "triangulator": ("smoother", "coder"),
    "assembler": ("triangulator", "coder"),
    "volume": ("triangulator", "assembler", "outliner"),
    "weigher": ("volume",),
    "classifier": ("triangulator", "assembler", "outliner"),
    "grader": ("triangulator", "assembler", "outliner", "volume", "weigher", "classifier"),
}


class _Fault(NamedTuple):
    error: Exception | SystemExit
    raised_at: TracebackType | None


class StageCache:
    """Results of the steps of one acquisition, with the time each took; cleared between acquisitions.

    Of more than `most` results the least recently used one is dropped; None keeps all.
    """

    def __init__(self, most: int | None = None) -> None:
        self._kept: dict[object, tuple[Any, _Fault | None, float]] = {}
        self._most = most

    def clear(self) -> None:
        """Forget everything."""
        self._kept.clear()

    def recall(self, key: object, step: Callable[[], Any]) -> tuple[Any, float]:
        """Give a step's result and the seconds it took when it was done; what it raised is raised again."""
        if key not in self._kept:
            result, fault = None, None
            begin = time.perf_counter()
            try:
                result = step()
            # Kept, not swallowed: it is raised below, here and for every variant that shares the step.
            except FAULTS as error:
                fault = _Fault(error, error.__traceback__)
            self._kept[key] = (result, fault, time.perf_counter() - begin)
            if self._most is not None and len(self._kept) > self._most:
                del self._kept[next(iter(self._kept))]
        elif self._most is not None:
            self._kept[key] = self._kept.pop(key)  # used last, dropped last
        result, fault, seconds = self._kept[key]
        if fault is not None:
            # where it was raised is told to the plugin's author; each time anew, so that it does not grow
            raise fault.error.with_traceback(fault.raised_at)
        return result, seconds


class CachedStages:
    """A recipe's stages, for a pipeline, sharing a cache with the stages of all recipes compared.

    The stages of a scan are called line by line, so that nothing of them is cached.

    Attributes
    ----------
    stages
        By kind, an object with the kind's method.
    keys
        By kind, the hash of all that decides the stage's result on an acquisition.
    seconds
        By kind, the time its steps took where they were done, s; add up until `start`. None of a scan.
    """

    def __init__(self, recipe: Recipe, memory: StageCache, draws: int | None = None) -> None:
        self.keys = step_keys(recipe, (recipe.uncertainty, recipe.draws) if draws is None else ("", draws))
        self.seconds: dict[str, float] = {}
        self.stages: dict[str, Any] = {
            kind: chosen.make()
            if "assembler" in recipe.stages
            else _CachedStage(kind, chosen.make(), self.keys[kind], memory, self.seconds)
            for kind, chosen in recipe.stages.items()
        }

    def start(self) -> None:
        """Begin to count the time of another acquisition."""
        self.seconds.clear()


def step_keys(recipe: Recipe, uncertainty: tuple[str, int]) -> dict[str, str]:
    """Hash, by kind of stage, all that decides its result: its options, and every step before it.

    A grader looks at uncertainties, so how they are found decides its result as well.
    """
    source = recipe.source_choice
    keys: dict[str, str] = {}

    def key_of(kind: str) -> str:
        if kind not in keys:
            chosen = recipe.stages[kind]
            calibrated = recipe.calibration is not None and kind != "extractor"
            decided_by = [
                chosen.described(),
                [key_of(before) for before in _BEFORE[kind] if before in recipe.stages],
                None if recipe.penetration is None else recipe.penetration.sha256,
                recipe.calibration.sha256 if calibrated and recipe.calibration is not None else None,
                source.model_dump(mode="json", exclude={"path"}),
                uncertainty if kind == "grader" else None,
            ]
            keys[kind] = hashlib.sha256(json.dumps(decided_by, sort_keys=True).encode()).hexdigest()
        return keys[kind]

    for kind in recipe.stages:
        key_of(kind)
    return keys


class _CachedStage:
    """One stage with its kind's verb, which does the work only if nobody has done it."""

    def __init__(
        self, kind: str, stage: Any, key: str, memory: StageCache, seconds: dict[str, float]
    ) -> None:
        (verb,) = INTERFACES[kind].__abstractmethods__
        work = getattr(stage, verb)

        def cached(*inputs: Any) -> Any:
            """Give what the stage gives, from the cache if it has done this before; its time is added up."""
            number = next((given.number for given in inputs if isinstance(given, Product)), 0)
            result, took = memory.recall((kind, key, number), lambda: work(*inputs))
            seconds[kind] = seconds.get(kind, 0.0) + took
            return result

        setattr(self, verb, cached)
        if kind == "triangulator":
            self.view = stage.view
            self.moved = stage.moved
