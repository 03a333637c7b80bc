"""A progress bar on the error stream."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

COMPILING = "compiling kernels, first run only"
"""What the bar of `warm_up` says."""


@contextmanager
def progress(what: str, *, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """Show a bar while the block runs; gives the function that moves it to (done, of how many).

    What is done at the first call was done before, and does not count for the time that is left. There is no
    bar when `quiet` or when the error stream is no terminal, as in a file of a log.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    began, before = time.monotonic(), math.nan

    class TimeLeft(ProgressColumn):
        """Of all that was done so far: a single slow step does not bring it to nothing."""

        def render(self, task: Task) -> Text:
            left = time_left_s(time.monotonic() - began, task.completed - before, task.remaining or 0.0)
            return Text("" if math.isnan(left) else f"{timedelta(seconds=round(left))} left")

    class Counted(MofNCompleteColumn):
        """Nothing where a step does not say how far it is."""

        def render(self, task: Task) -> Text:
            return Text("") if task.total is None else super().render(task)

    def move(done: int, of: int) -> None:
        nonlocal before
        before = float(done) if math.isnan(before) else before
        bar.update(task, completed=done, total=of)

    columns = (TextColumn("{task.description}"), BarColumn(), Counted(), TimeLeft())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield move


def time_left_s(elapsed_s: float, done: float, left: float) -> float:
    """Give the time left, s, if what is left takes as long as what was done; NaN before anything was."""
    return elapsed_s * left / done if done > 0.0 else math.nan
