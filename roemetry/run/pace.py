"""How long the rest of some work takes whose steps differ in cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

OnProgress = Callable[[int, int, float], None]
"""Called with steps done, of how many, and the time that the others will take, s: NaN before any was done."""


def silent(_done: int, _of: int, _left_s: float) -> None:
    """Tell nobody."""


class Pace:
    """Tells the time that is left by what each kind of step has taken so far.

    A kind that has not come yet is taken to cost what `cost` says in comparison with those that have.

    Parameters
    ----------
    steps
        How many steps of each kind there are to do.
    cost
        What a step of a kind costs compared with others; 1 where nothing is said.
    clock
        Gives the time, s.
    """

    def __init__(
        self,
        steps: Mapping[str, int],
        *,
        cost: Mapping[str, float] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._left = dict(steps)
        self._cost = cost or {}
        self._took: dict[str, list[float]] = {}
        self._clock = clock
        self._at = clock()

    def done(self, kind: str) -> None:
        """Count a step that was just done; it took the time since the one before."""
        now = self._clock()
        self._took.setdefault(kind, []).append(now - self._at)
        self._left[kind] -= 1
        self._at = now

    def left_s(self) -> float:
        """Give the time that is left, s; NaN before any step was done."""
        if not self._took:
            return math.nan
        count = sum(len(took) for took in self._took.values())
        cost = sum(len(took) * self._cost.get(kind, 1.0) for kind, took in self._took.items())
        unit_s = sum(map(sum, self._took.values())) / (cost or count)
        return sum(
            left
            * (
                sum(took) / len(took)
                if (took := self._took.get(kind))
                else unit_s * self._cost.get(kind, 1.0)
            )
            for kind, left in self._left.items()
        )
