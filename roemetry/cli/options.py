"""Options that many verbs have, each with a help of its own, and where results go without one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from roemetry.run.executors import Executor


def set_option(told: str) -> Any:
    """Give ``--set KEY=VALUE``, which may be given several times."""
    return typer.Option("--set", metavar="KEY=VALUE", help=f"{told}; may be given several times.")


def out_option(told: str, *, parser: Callable[[str], Path] | None = None) -> Any:
    """Give ``--out``."""
    return typer.Option("--out", "-o", help=told, parser=parser, metavar=None if parser is None else "PATH")


def place(text: str) -> Path:
    """Read a path, or a URL, which typer's own reader would take the double stroke from."""
    from roemetry.io.remote import path_of

    return path_of(text, Path())


def next_folder(recipe: Path, ending: str = "") -> Path:
    """Give the first results folder of a recipe's name that is not there yet."""
    path = recipe.resolve()
    name = (path.parent.name if path.stem == "recipe" else path.stem) + ending
    number = 1
    while (folder := Path("results") / f"{name}-{number}").exists():
        number += 1
    return folder


def cluster_option() -> Any:
    """Give ``--cluster``."""
    return typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Do the work on a dask cluster instead: its scheduler's address, such as tcp://10.0.0.5:8786, "
        "or local for one of --jobs processes on this machine; same results.",
    )


def executor_of(cluster: str | None, jobs: int) -> Executor:
    """Give what does the work: `jobs` processes, or the workers of a cluster."""
    from roemetry.run.executors import Processes

    if cluster is None:
        return Processes(jobs)
    from roemetry.run.cluster import Cluster

    return Cluster(cluster, jobs)
