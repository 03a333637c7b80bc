"""Where the work of many products is done: the interface that the process pool and a cluster share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

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
