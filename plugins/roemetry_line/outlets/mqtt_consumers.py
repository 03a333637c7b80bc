"""Consumers behind a broker, watched by what they confirm: a broker does not tell who publishes of them.

A consumer that is named publishes the key of each product that it has taken; a key stands for all products
before it, which come in order. Who has not confirmed a product for 2 s is told to the operator.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from roemetry.errors import OutputError
from roemetry.records.live import LineControl

_LOOK_S = 0.25
_BEHIND_S = 2.0
_KEPT = 10_000
"""Products that are remembered while they are not confirmed: a consumer is behind long before."""


class Consumers:
    """What each of some consumers has still to confirm."""

    def __init__(self, names: Sequence[str]) -> None:
        self._waiting: dict[str, dict[str, float]] = {name: {} for name in names}
        self._lock = threading.Lock()

    def sent(self, key: str) -> None:
        """Note that a product goes out."""
        with self._lock:
            for waiting in self._waiting.values():
                waiting.setdefault(key, time.monotonic())
                if len(waiting) > _KEPT:
                    del waiting[next(iter(waiting))]

    def taken(self, name: str, key: str) -> None:
        """Note that a consumer has this product, and so all before it."""
        with self._lock:
            waiting = self._waiting.get(name, {})
            if key in waiting:
                before = list(waiting)
                for one in before[: before.index(key) + 1]:
                    del waiting[one]

    def behind(self) -> str | None:
        """Name those who are behind; None where there are none."""
        with self._lock:
            now = time.monotonic()
            found = [
                name for name, waiting in self._waiting.items()
                if waiting and now - next(iter(waiting.values())) > _BEHIND_S
            ]  # fmt: skip
        return f"consumers that confirm no products: {', '.join(found)}" if found else None

    @contextmanager
    def watched(self, line: LineControl | None) -> Iterator[None]:
        """Tell the operator who is behind, while the block runs."""
        if line is None or not self._waiting:
            yield
            return
        over = threading.Event()
        watching = threading.Thread(target=self._watch, args=(line, over), daemon=True)
        watching.start()
        try:
            yield
        finally:
            over.set()
            watching.join()

    def _watch(self, line: LineControl, over: threading.Event) -> None:
        told: str | None = ""
        while not over.wait(_LOOK_S):
            said = self.behind()
            if said != told:
                with suppress(OutputError):  # the disk is full: it is tried again
                    line.warn(said)
                    told = said
