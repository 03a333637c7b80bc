"""Rules of a control chart: which of a series of values are signals that something moved.

Centre and scatter are of the first values, the scatter from step to step, which a slow drift does not widen.
Rules: one value beyond three standard deviations (Shewhart 1931); two of three beyond two on one side, four
of five beyond one on one side, eight in a row on one side (Western Electric 1956); and the exponentially
weighted mean beyond its limits (Roberts 1959), which shows a small shift soonest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats

BASELINE = 8
"""Values that centre and scatter are taken from: the scatter is then known to 25 %."""
SHEWHART = 3.0
"""Standard deviations of the outer limits: by chance once in 370 values."""
EWMA_WEIGHT, EWMA_LIMIT = 0.2, 2.86
"""Weight of the newest value, and the limit in standard deviations of the weighted mean, which goes with it:
by chance once in 370 values as well (Lucas and Saccucci 1990, table 3)."""
_MOVING_RANGE_TO_STD = 1.128
"""Mean range of two normal values in standard deviations (d₂)."""


class Signal(NamedTuple):
    """A value that breaks a rule."""

    at: int
    """Index of the value."""
    rule: str
    """Short name: ``3 sigma``, ``2 of 3``, ``4 of 5``, ``8 in a row``, ``EWMA``."""
    words: str


class Limits(NamedTuple):
    """Centre and scatter of a chart."""

    centre: float
    std: float


def limits_of(values: Sequence[float] | Floats) -> Limits | None:
    """Give centre and scatter by the first values; None where there are fewer than `BASELINE`."""
    known = np.asarray(values, np.float64)
    if known.size < BASELINE:
        return None
    scatter = float(np.abs(np.diff(known)).mean()) / _MOVING_RANGE_TO_STD
    return Limits(float(known[:BASELINE].mean()), max(scatter, 1e-12))


def signals(values: Sequence[float] | Floats, limits: Limits) -> tuple[Signal, ...]:
    """Give every value after the baseline that breaks a rule, once each, by the first rule that it breaks."""
    z = (np.asarray(values, np.float64) - limits.centre) / limits.std
    found = []
    mean = 0.0
    for index, value in enumerate(z.tolist()):
        mean = EWMA_WEIGHT * value + (1.0 - EWMA_WEIGHT) * mean
        if index < BASELINE:
            continue
        width = EWMA_LIMIT * math.sqrt(
            EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * (1.0 - (1.0 - EWMA_WEIGHT) ** (2 * (index + 1)))
        )
        side = "above" if value > 0 else "below"
        sign = math.copysign(1.0, value)
        if abs(value) > SHEWHART:
            found.append(
                Signal(index, "3 sigma", f"lies {abs(value):.1f} standard deviations {side} the centre")
            )
        elif (sign * z[index - 2 : index + 1] > 2.0).sum() >= 2:
            found.append(
                Signal(index, "2 of 3", f"two of three lie more than 2 standard deviations {side} the centre")
            )
        elif (sign * z[index - 4 : index + 1] > 1.0).sum() >= 4:
            found.append(
                Signal(index, "4 of 5", f"four of five lie more than 1 standard deviation {side} the centre")
            )
        elif index >= 2 * BASELINE - 1 and (sign * z[index - 7 : index + 1] > 0.0).all():
            found.append(Signal(index, "8 in a row", f"the last eight all lie {side} the centre"))
        elif abs(mean) > width:
            found.append(
                Signal(index, "EWMA", f"the weighted mean has moved {side} the centre by more than its limit")
            )
    return tuple(found)
