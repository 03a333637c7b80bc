"""Compile the kernels of stages before their first run, several stages at once.

A stage compiles its kernels when it is first called, and waits for the stage before it; one after the other
they take over a minute of one processor. The ordinary calls of the conformance kit need no other stage, so
each stage is called in a process of its own; what is compiled lies on disk for the run.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from multiprocessing import get_context
from types import ModuleType
from typing import Any

from roemetry.config.resolve import ResolvedStage
from roemetry.errors import FAULTS
from roemetry.stages import Classifier, Stage, VolumeEstimator


def warm_up(
    stages: Mapping[str, ResolvedStage], on_progress: Callable[[int, int], None] = lambda done, of: None
) -> list[str]:
    """Compile the kernels of every stage that has none on disk yet.

    Parameters
    ----------
    stages
        The stages of a recipe, or a scene's simulator, by kind.
    on_progress
        Called with (kernels done, of how many), stage by stage; never where nothing is to be done. Kernels
        take about as long as one another, stages do not.

    Returns
    -------
    list of str
        The kinds of the stages that were called. A stage that cannot be called by the conformance kit's
        example is left to the run.
    """
    kernels = {kind: list(_kernels_of(chosen.make())) for kind, chosen in stages.items()}
    cold = [
        kind for kind, found in kernels.items() if found and not any(kernel.is_on_disk() for kernel in found)
    ]
    if not cold:
        return []
    cold.sort(key=lambda kind: -len(kernels[kind]))  # the longest first: nothing waits for it at the end
    cost = {kind: len(kernels[kind]) for kind in cold}
    done, total = 0, sum(cost.values())
    if len(cold) > 1:  # of a single stage nothing is known until it is done
        on_progress(done, total)
    processes = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1, len(cold))
    if processes == 1:
        for kind in cold:
            _call(stages[kind].make())
            done += cost[kind]
            on_progress(done, total)
        return cold
    # Spawned, not forked: a forked copy of numba's or OpenCV's threads can hang.
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        calls = {pool.submit(_call, stages[kind].make()): cost[kind] for kind in cold}
        for call in as_completed(calls):
            done += calls[call]
            on_progress(done, total)
    return cold


def _call(stage: Stage[Any]) -> None:
    """Call a stage with the kit's example; that it fails here says nothing about the run."""
    # the kit is loaded only where something is to be compiled
    from roemetry.testing.cases import cases_for
    from roemetry.testing.solids import HALF_ELLIPSOID, outlined

    with suppress(*FAULTS):
        cases_for(stage).ordinary.call(stage)
        if isinstance(stage, VolumeEstimator):  # many take another way where there is an outline
            product = outlined(HALF_ELLIPSOID)
            stage.redraw(product, stage.estimate(product))
            stage.surface(product)
        if isinstance(stage, Classifier):
            stage.relief(outlined(HALF_ELLIPSOID))


def _kernels_of(stage: Stage[Any]) -> Iterator[Any]:
    """Give the kernels in a stage's module and in the modules of its package that this uses."""
    package = type(stage).__module__.partition(".")[0]
    waiting, seen = [type(stage).__module__], set[str]()
    while waiting:
        name = waiting.pop()
        if name in seen or name.partition(".")[0] != package:
            continue
        seen.add(name)
        for value in vars(sys.modules[name]).values():
            home = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
            if hasattr(value, "is_on_disk") and home == name:
                yield value
            elif isinstance(home, str) and home in sys.modules:
                waiting.append(home)
