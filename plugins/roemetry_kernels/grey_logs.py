"""Logarithms of grey levels above a background, from a table, compiled."""

from __future__ import annotations

from functools import cache

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import inlined

FAR_OFF = 0.07  # share of the background's rest in the level, up to which four terms of the series will do
_DARKEST = 0.001


@cache
def log_table(white: int) -> Floats:
    """(2, white + 1) logarithms and reciprocals of whole grey levels; those of 0 are those of 1."""
    numbers = np.maximum(np.arange(white + 1, dtype=np.float64), 1.0)
    table = np.stack([np.log(numbers), 1.0 / numbers])
    table.flags.writeable = False
    return table


@inlined
def log_above(level: int, whole: int, rest: float, logs: Floats) -> float:
    """Logarithm of a grey level above a background, to 3e-7; of what is darker, that of a thousandth.

    Parameters
    ----------
    level
        Grey level.
    whole, rest
        Background as a whole grey level, and what it exceeds that by.
    logs
        As `log_table` gives it.
    """
    above = max(int(level) - whole, 1)
    off = rest * logs[1, above]
    if abs(off) > FAR_OFF:
        return np.log(max(int(level) - whole - rest, _DARKEST))
    return logs[0, above] - off * (1.0 + off * (0.5 + off * (1.0 / 3.0 + 0.25 * off)))
