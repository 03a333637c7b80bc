"""Logarithms of grey levels above a background, from a table, compiled."""

from __future__ import annotations

from functools import cache

import numpy as np

from roemetry.arrays import Floats
from roemetry_kernels.compiling import inlined


@cache
def log_table(white: int) -> Floats:
    """(2, white + 1) logarithms and reciprocals of whole grey levels; those of 0 are those of 1."""
    numbers = np.maximum(np.arange(white + 1, dtype=np.float64), 1.0)
    table = np.stack([np.log(numbers), 1.0 / numbers])
    table.flags.writeable = False
    return table


@inlined
def log_above(level: int, whole: int, rest: float, logs: Floats) -> float:
    """Logarithm of a grey level above a background, of one at least.

    Parameters
    ----------
    level
        Grey level.
    whole, rest
        Background as a whole grey level, and what it exceeds that by: small against `level` − `whole`. To
        the fourth power of their ratio, which leaves 1e-7 for a tenth.
    logs
        As `log_table` gives it.
    """
    above = max(np.int64(level) - whole, 1)
    off = rest * logs[1, above]
    return logs[0, above] - off * (1.0 + off * (0.5 + off * (1.0 / 3.0 + 0.25 * off)))
