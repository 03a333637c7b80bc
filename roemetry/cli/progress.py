"""A progress bar on the error stream."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Protocol

COMPILING = "compiling kernels, first run only"
"""What the bar of `warm_up` says."""


class Move(Protocol):
    """Moves a bar to (done, of how many); `left_s` is the time left, s, where it is known."""

    def __call__(self, done: int, of: int, left_s: float = ..., /) -> None:
        """Move it."""
        ...


@contextmanager
def progress(what: str, *, quiet: bool) -> Iterator[Move]:
    """Show a bar while the block runs; gives the function that moves it.

    What is done at the first call was done before, and does not count for the time that is left. There is no
    bar when `quiet` or when the error stream is no terminal, as in a file of a log.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda done, of, left_s=math.nan, /: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    began, before = time.monotonic(), math.nan
    told_s, told_at = math.nan, began

    class TimeLeft(ProgressColumn):
        """As told, or else of all that was done: a single slow step does not bring it to nothing."""

        def render(self, task: Task) -> Text:
            """Give the time left in words; nothing before it can be told."""
            now = time.monotonic()
            left = max(told_s - (now - told_at), 0.0)
            if math.isnan(told_s):
                left = time_left_s(now - began, task.completed - before, task.remaining or 0.0)
            return Text("" if math.isnan(left) else f"{timedelta(seconds=round(left))} left")

    class Counted(MofNCompleteColumn):
        """Nothing where a step does not say how far it is."""

        def render(self, task: Task) -> Text:
            """Give how many of how many are done."""
            return Text("") if task.total is None else super().render(task)

    def move(done: int, of: int, left_s: float = math.nan, /) -> None:
        """Move the bar; `left_s` as told by what knows it."""
        nonlocal before, told_s, told_at
        told_s, told_at = left_s, time.monotonic()
        before = float(done) if math.isnan(before) else before
        bar.update(task, completed=done, total=of)

    columns = (TextColumn("{task.description}"), BarColumn(), Counted(), TimeLeft())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield move


def time_left_s(elapsed_s: float, done: float, left: float) -> float:
    """Give the time left, s, if what is left takes as long as what was done; NaN before anything was."""
    return elapsed_s * left / done if done > 0.0 else math.nan
