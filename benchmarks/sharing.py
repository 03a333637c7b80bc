"""Benchmarks whose work processes or a cluster share out: the same figures, in the same order."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from roemetry.cli.options import executor_of
from roemetry.run.executors import Lost


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--jobs`` and ``--cluster``."""
    parser.add_argument("--jobs", type=int, default=1, help="processes that share the work out")
    parser.add_argument("--cluster", help="a dask scheduler that does instead; its workers need this folder")


def shared(
    given: argparse.Namespace,
    make: Callable[..., Callable[[Any], Any]],
    fixed: tuple[Any, ...],
    tasks: Sequence[Any],
) -> Iterator[Any]:
    """Give ``make(*fixed)(task)`` for each task, in order; `make` can be pickled."""
    for found in executor_of(given.cluster, given.jobs).in_order(make, fixed, tasks):
        if isinstance(found, Lost):
            raise SystemExit(f"{found.task}: {found.why}")
        yield found
