"""Benchmarks whose work processes or a cluster share out: the same figures, in the same order."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from roemetry.cli.options import executor_of
from roemetry.run.executors import Lost


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--jobs`` and ``--cluster``."""
    parser.add_argument("--jobs", type=int, default=1, help="processes that share the work out")
    parser.add_argument("--cluster", help="a dask scheduler that does instead; its workers need this folder")


def shared(
    given: argparse.Namespace, work: Callable[..., Any], tasks: Sequence[Any], *fixed: Any
) -> Iterator[Any]:
    """Give ``work(*fixed, task)`` for each task, in order; `work` stands at the top of its module."""
    executor = executor_of(given.cluster, given.jobs)
    for found in executor.in_order(partial, (work, *fixed), tasks):
        if isinstance(found, Lost):
            raise SystemExit(f"{found.task}: {found.why}")
        yield found
