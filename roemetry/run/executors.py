"""Where the work of many products is done: an interface, and processes of this machine that keep it.

Results are the same, and in the same order, for any number of processes.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from roemetry.errors import ConfigurationError, InterruptedRunError

Task = TypeVar("Task")
Result = TypeVar("Result")
Given = TypeVar("Given", covariant=True)


class Tasks(Protocol[Given]):
    """Tasks that are made as they are wanted; there are as many as their length says."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Given]: ...


@dataclass(frozen=True, slots=True)
class Lost(Generic[Task]):
    """What stands for a task's result where every worker that tried it died."""

    task: Task
    why: str


class Executor(Protocol):
    """Shares out work; the results, and their order, do not depend on how."""

    def in_order(
        self, make: Callable[..., Callable[[Task], Result]], given: tuple[Any, ...], tasks: Tasks[Task]
    ) -> Iterator[Result | Lost[Task]]:
        """Give ``make(*given)(task)`` for each task, in order; each worker is given one task at a time.

        A worker with a method `ahead` is told the tasks that it will be given next.

        InterruptedRunError where the workers are gone; what was given before counts.
        """
        ...


def results_of(worker: Callable[[Task], Result], chunk: Tasks[Task]) -> Iterator[Result]:
    """Give the results of tasks done one after another; a worker that fetches `ahead` is told them first."""
    ahead = getattr(worker, "ahead", None)
    if ahead is not None:
        ahead(chunk)
    yield from map(worker, chunk)


if TYPE_CHECKING:
    from concurrent.futures import Future
    from multiprocessing.synchronize import Event

_CHUNK_S = 0.03
"""Work that is handed to a process at once, s: long beside the handing over, too short to notice."""
_CHUNK_MAX = 16
"""Tasks at once, at most: what a broken process loses, and what waits for the slowest."""
_WAITING_PER_JOB = 4
"""Chunks that wait for each process: none stands idle while the results are written down."""


@dataclass(frozen=True, slots=True)
class Processes:
    """An `Executor` of processes on this machine; with one job, the work is done in this very process."""

    jobs: int

    def in_order(
        self, make: Callable[..., Callable[[Task], Result]], given: tuple[Any, ...], tasks: Tasks[Task]
    ) -> Iterator[Result | Lost[Task]]:
        """As `Executor.in_order`; InterruptedRunError: one died, ConfigurationError: none started."""
        jobs = self.jobs
        if jobs == 1 or len(tasks) < 2:
            yield from results_of(make(*given), tasks)
            return
        from concurrent.futures import ProcessPoolExecutor
        from concurrent.futures.process import BrokenProcessPool
        from multiprocessing import current_process, get_context

        if getattr(current_process(), "_inheriting", False):
            # A worker reads the caller's script before anything else, and this one runs again there: the
            # parent says so, once; Python itself would print its own explanation from every worker.
            raise SystemExit(1)
        # Spawned, not forked: a forked copy of numba's or OpenCV's threads can hang.
        spawn = get_context("spawn")
        has_begun = spawn.Event()
        begun_with = (has_begun, make, given)
        with ProcessPoolExecutor(min(jobs, len(tasks)), spawn, _start, begun_with) as pool:
            waiting: deque[Future[tuple[list[Any], float]]] = deque()
            coming = iter(tasks)
            together = 1
            try:
                while True:
                    while len(waiting) < _WAITING_PER_JOB * jobs and (
                        chunk := list(islice(coming, together))
                    ):
                        waiting.append(pool.submit(_work, chunk))
                    if not waiting:
                        return
                    results, slowest_s = waiting.popleft().result()
                    together = min(_CHUNK_MAX, 1 + int(_CHUNK_S / max(slowest_s, 1e-6)))
                    yield from results
            except BrokenProcessPool as error:
                if not has_begun.is_set():
                    raise ConfigurationError(
                        "no worker process could begin: each first reads the script that started it, and "
                        "that failed or began the same work again",
                        hint="put what the script does, not its imports and functions, under "
                        '`if __name__ == "__main__":`, or use jobs=1',
                    ) from None
                raise InterruptedRunError(
                    "a worker process died (killed by the system, perhaps for lack of memory)",
                    hint="what was done is whole; go on with fewer --jobs, with --resume where offered",
                ) from error
            finally:
                pool.shutdown(cancel_futures=True)


_worker: Callable[[Any], Any] | None = None
"""What this process does its tasks with; the parent has none."""


def _start(has_begun: Event, make: Callable[..., Callable[[Any], Any]], given: tuple[Any, ...]) -> None:
    global _worker
    has_begun.set()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ^C is the parent's to handle
    sys.stdout = sys.stderr  # what a stage prints is no part of what the parent prints, such as --json
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _worker = make(*given)


def _end_with_parent() -> None:
    """End this process when its parent is gone, however that was ended: nothing is left to do."""
    from multiprocessing import parent_process

    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _work(tasks: list[Any]) -> tuple[list[Any], float]:
    """Give the tasks' results, and the processor time of the slowest, s; waiting for a network is none."""
    if _worker is None:
        raise AssertionError("a worker process was not started by _start")
    results, slowest_s, begin = [], 0.0, time.thread_time()
    for result in results_of(_worker, tasks):
        results.append(result)
        slowest_s, begin = max(slowest_s, time.thread_time() - begin), time.thread_time()
    return results, slowest_s
