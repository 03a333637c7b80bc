"""Work that processes share out: the results are the same, and in the same order, for any number of them."""

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
from typing import TYPE_CHECKING, Any

from roemetry.errors import InterruptedRunError
from roemetry.run.executors import Lost, Result, Task, Tasks, results_of

if TYPE_CHECKING:
    from concurrent.futures import Future

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
        """See `Executor.in_order`; InterruptedRunError where a process died."""
        jobs = self.jobs
        if jobs == 1 or len(tasks) < 2:
            yield from results_of(make(*given), tasks)
            return
        from concurrent.futures import ProcessPoolExecutor
        from concurrent.futures.process import BrokenProcessPool
        from multiprocessing import get_context

        # Spawned, not forked: a forked copy of numba's or OpenCV's threads can hang.
        with ProcessPoolExecutor(min(jobs, len(tasks)), get_context("spawn"), _start, (make, given)) as pool:
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
                raise InterruptedRunError(
                    "a worker process died (killed by the system, perhaps for want of memory)",
                    hint="what was done is whole; go on with fewer --jobs, with --resume if the verb has it",
                ) from error
            finally:
                pool.shutdown(cancel_futures=True)


_worker: Callable[[Any], Any] | None = None
"""What this process does its tasks with; the parent has none."""


def _start(make: Callable[..., Callable[[Any], Any]], given: tuple[Any, ...]) -> None:
    global _worker
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
