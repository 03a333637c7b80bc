"""What need not stand in the way of a shift when it is asked how sure a label is."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_GAP_LINES = 3
"""A stripe that is not seen on so few lines goes on."""
_OVERLAP_LINES = 4
_OVERLAP = 8.0
"""Two runs out of order on so few lines need not give way: what it costs to leave their ends out, a line."""
_NEIGHBOURS_MIN = 0.8
"""Neighbours are there if both are seen on this share of the lines."""


@kernel
def strays_of(start: Integers, of: Integers, stripe: Integers, stripes: int, lines_min: int) -> Flags:
    """Mark (run,) runs of a stripe that is seen on a few lines only, amid lines on which both neighbours are.

    What hides a stripe along its whole length but for a few lines is rare; light that was thrown back a
    second time looks like that.

    Parameters
    ----------
    start
        (line + 1,) where each line's entries begin.
    of, stripe
        (entry,) run, −1 for none; (run,) its stripe.
    stripes
        Number of stripes.
    lines_min
        On so many lines before and after it is not seen, but its neighbours are.
    """
    lines = start.shape[0] - 1
    seen = np.zeros((lines, stripes), np.bool_)
    for e in range(lines):
        for i in range(start[e], start[e + 1]):
            if of[i] >= 0:
                seen[e, stripe[of[i]]] = True
    island = np.zeros((lines, stripes), np.bool_)
    for s in range(1, stripes - 1):
        e = 0
        while e < lines:
            if not seen[e, s]:
                e += 1
                continue
            last, k = e, e
            while k < lines and k - last <= _GAP_LINES:
                if seen[k, s]:
                    last = k
                k += 1
            before = _only_neighbours(seen, s, e - lines_min, e)
            if before and _only_neighbours(seen, s, last + 1, last + 1 + lines_min):
                island[e : last + 1, s] = True
            e = last + 1
    found = np.zeros(stripe.shape[0], np.bool_)
    for e in range(lines):
        for i in range(start[e], start[e + 1]):
            if of[i] >= 0 and island[e, stripe[of[i]]]:
                found[of[i]] = True
    return found


@kernel
def _only_neighbours(seen: Flags, s: int, first: int, end: int) -> bool:
    """Say whether the neighbours of stripe s are seen on nearly all of some lines, and s on none."""
    if first < 0 or end > seen.shape[0]:
        return False
    both = 0
    for e in range(first, end):
        if seen[e, s]:
            return False
        both += seen[e, s - 1] and seen[e, s + 1]
    return both >= _NEIGHBOURS_MIN * (end - first)


@kernel
def eased(both: Floats, disorder: Integers, cost: float) -> tuple[Floats, Integers]:
    """Give (edge, way, way) costs and disorder, without the disorder of runs that hardly touch.

    Parameters
    ----------
    both, disorder
        See `roemetry_kernels.coding.label_graph.Runs`.
    cost
        What disorder costs in `both`, a line.
    """
    eased_both, eased_disorder = both.copy(), disorder.copy()
    for t in range(both.shape[0]):
        for a in range(both.shape[1]):
            for b in range(both.shape[2]):
                if 0 < disorder[t, a, b] <= _OVERLAP_LINES:
                    eased_both[t, a, b] -= disorder[t, a, b] * (cost - _OVERLAP)
                    eased_disorder[t, a, b] = 0
    return eased_both, eased_disorder
