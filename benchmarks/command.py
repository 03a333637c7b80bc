"""What benchmarks share of a command line: its parser, work shared out, lines that are kept."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from roemetry.cli.options import executor_of
from roemetry.run.executors import Lost


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """Make the parser of a benchmark, whose module says what it does."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def add_sharing(parser: argparse.ArgumentParser) -> None:
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


def kept(path: Path | None) -> list[dict[str, Any]]:
    """Read what a file of JSON lines holds, so that a run goes on; nothing where there is none yet."""
    lines = path.read_text("utf-8").splitlines() if path is not None and path.exists() else []
    return [json.loads(line) for line in lines]


def keep(path: Path | None, row: Mapping[str, Any]) -> None:
    """Add a line to a file of JSON lines, if one is wanted."""
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
