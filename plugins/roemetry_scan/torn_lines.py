"""Lines of a scan of which a part lies beside the lines before and after it.

Model. Lines follow each other far more closely than a product's shape changes: along the belt heights rise,
fall, and step, but they do not jump for a line or two and come back. So each point is compared with those of
the lines before and after it, and each two with those before and after both. What lies above both, or below
both, by more than noise, and by more than half of what these differ by, belongs to another moment: a part of
the frame was another one's, or rows of it were lost. Single points may be glare or noise, so that it takes a
run of neighbours. Such a line is not used; the lines beside it bridge the gap.

It fails for three wrong lines in a row, which are a step there and a step back, and for ridges across the
belt that are only a line or two wide.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Flags, Floats

_LEAST_MM = 0.5
"""Less does not matter: where a tenth of the lines is off by it, so is 0.5 % of a product 10 mm high."""
_SIGMAS = 8.0
"""Times the usual scatter from line to line, beyond which it is not noise."""
_OF_STEP = 0.5
"""Of the difference of the lines before and after: beside an edge, the last whole line may lie higher."""
_RUN = 5
"""Neighbours that lie beside: noise and glare give one or two."""
_AT_ONCE = 128
"""Lines that are looked at together: copies of all of a long scan's heights are megabytes."""
_SAMPLED = 64
"""Rows that tell the usual scatter."""


def torn_lines(height_mm: Floats) -> Flags:
    """Say which lines (line,) of heights (line, row) are torn; NaN is not seen."""
    lines, rows = height_mm.shape
    found = np.zeros(lines, np.bool_)
    some = height_mm[:, :: max(1, rows // _SAMPLED)]
    bends = np.abs(some[:-2] - 2.0 * some[1:-1] + some[2:])
    known = bends[np.isfinite(bends)]
    if not known.size:
        return found
    # of independent errors σ a bend has √6·σ, a step between two lines √2·σ
    limit_mm = max(_LEAST_MM, _SIGMAS * 1.4826 * float(np.median(known)) / np.sqrt(3.0))
    for first in range(1, lines - 1, _AT_ONCE):
        last = min(first + _AT_ONCE, lines - 1)
        here, before, after = (height_mm[first + k : last + k] for k in (0, -1, 1))
        steps = (np.abs(here - before) > limit_mm).sum(axis=1)
        if (steps < _RUN).all():
            continue
        found[first:last] |= _in_runs(_beside(here, before, after, limit_mm))
        last = min(last, lines - 2)
        here, before, after, beyond = (height_mm[first + k : last + k] for k in (0, -1, 1, 2))
        both = _in_runs(_beside(here, before, beyond, limit_mm) & _beside(after, before, beyond, limit_mm))
        found[first:last] |= both
        found[first + 1 : last + 1] |= both
    return found


def _beside(here: Floats, before: Floats, after: Floats, limit_mm: float) -> Flags:
    """Say which points lie above or below both others, by more than the limit and part of their step."""
    low, high = np.minimum(before, after), np.maximum(before, after)
    over = np.maximum(low - here, here - high)
    return np.asarray((over > limit_mm) & (over > _OF_STEP * (high - low)))


def _in_runs(beside: Flags) -> Flags:
    """Say which lines have a run of points beside."""
    together = beside[:, : beside.shape[1] - _RUN + 1].copy()
    for k in range(1, _RUN):
        together &= beside[:, k : beside.shape[1] - _RUN + 1 + k]
    return np.asarray(together.any(axis=1))
