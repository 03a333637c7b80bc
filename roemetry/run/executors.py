"""Where the work of many products is done: the interface that the process pool and a cluster share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Lost(Generic[Task]):
    """What stands for a task's result where every worker that tried it died."""

    task: Task
    why: str


class Executor(Protocol):
    """Shares out work; the results, and their order, do not depend on how."""

    def in_order(
        self, make: Callable[..., Callable[[Task], Result]], given: tuple[Any, ...], tasks: Sequence[Task]
    ) -> Iterator[Result | Lost[Task]]:
        """Give ``make(*given)(task)`` for each task, in order; every process makes its own worker once.

        A worker with a method `ahead` is told the tasks that it will be given next.

        InterruptedRunError where the workers are gone; what was given before counts.
        """
        ...


def results_of(worker: Callable[[Task], Result], chunk: Sequence[Task]) -> Iterator[Result]:
    """Give the results of tasks done one after another; a worker that fetches `ahead` is told them first."""
    ahead = getattr(worker, "ahead", None)
    if ahead is not None:
        ahead(chunk)
    yield from map(worker, chunk)
