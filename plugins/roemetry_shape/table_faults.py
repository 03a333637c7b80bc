"""What is wrong with a grade table: a gap, a class nobody reaches, two classes that overlap."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Range = tuple[float, float]
Fault = tuple[tuple[str | int, ...], str]

CELLS_MAX = 2_000_000
"""A table that cuts its quantities into more cells than this is not looked through."""

_NEVER_NEGATIVE = ("_g", "_cm3", "_mm3", "_mm2", "_mm", "_px2", "_px")


def faults_of(
    labels: Sequence[str],
    ranges: Sequence[Mapping[str, Range]],
    shapes: Sequence[Sequence[str]],
    *,
    overlaps_are_faults: bool,
) -> list[Fault]:
    """Look a table through, cell by cell, between all limits that stand in it.

    Parameters
    ----------
    labels
        Of the classes, in order.
    ranges
        By class, the half-open range of each quantity it asks about.
    shapes
        By class, the shapes it takes; none: any.
    overlaps_are_faults
        Whether two classes may share cells though neither holds the other.

    Returns
    -------
    list
        Keys that lead to what is wrong, and what is wrong and what to do.
    """
    cells = _Cells(ranges, shapes)
    if cells.count > CELLS_MAX:
        said = f"the limits cut the quantities into {cells.count:,} cells: too many to look for gaps"
        return [(("classes",), f"{said}; use fewer quantities")]
    taken = [cells.of(one, shape) for one, shape in zip(ranges, shapes, strict=True)]
    faults: list[Fault] = []
    before = np.zeros_like(cells.real)
    for number, mine in enumerate(taken):
        if not (mine & ~before).any():
            said = "no product comes this far: the classes before take all of it"
            faults.append((("classes", number, "label"), f"{said}; put it before them, or leave it out"))
        elif overlaps_are_faults:
            faults += _overlaps(number, labels, taken, cells)
        before |= mine
    left = cells.real & ~before
    if left.any():
        where = cells.named(left)
        said = f"there is a gap: no class takes {where}; widen a class, or add a last one without limits"
        faults.append((("classes", len(labels)), said))
    return faults


def _overlaps(number: int, labels: Sequence[str], taken: Sequence[Any], cells: _Cells) -> list[Fault]:
    mine = taken[number]
    for earlier in range(number):
        other = taken[earlier]
        both = mine & other
        # A class within a later, wider one is what "the first wins" is for.
        if both.any() and (other & ~mine).any():
            said = (
                f"overlaps class {labels[earlier]!r} at {cells.named(both)}; move a limit, or say "
                "`overlaps: first-wins`"
            )
            return [(("classes", number, "label"), said)]
    return []


class _Cells:
    """Every combination of shape and of the ranges between limits."""

    def __init__(self, ranges: Sequence[Mapping[str, Range]], shapes: Sequence[Sequence[str]]) -> None:
        self._names = list(dict.fromkeys(name for one in ranges for name in one))
        self._edges = {name: _edges(ranges, name) for name in self._names}
        self._shapes = [*dict.fromkeys(shape for one in shapes for shape in one), ""]
        self._size = (len(self._shapes), *(len(self._edges[name]) - 1 for name in self._names))
        self.count = math.prod(self._size)
        self.real = np.ones(self._size if self.count <= CELLS_MAX else (0,), np.bool_)
        if self.count > CELLS_MAX:
            return
        for axis, name in enumerate(self._names, start=1):
            if name.endswith(_NEVER_NEGATIVE) and "_per_" not in name:
                self.real &= self._along(axis, [high > 0.0 for _, high in self._ranges(name)])

    def of(self, ranges: Mapping[str, Range], shape: Sequence[str]) -> Any:
        """Cells that a class takes."""
        mine = self.real & self._along(0, [not shape or one in shape for one in self._shapes])
        for axis, name in enumerate(self._names, start=1):
            low, high = ranges.get(name, (-math.inf, math.inf))
            mine &= self._along(axis, [low <= a and b <= high for a, b in self._ranges(name)])
        return mine

    def named(self, which: Any) -> str:
        """Say in words where the first of these cells is; what does not matter is left out."""
        first = tuple(int(at[0]) for at in np.nonzero(which))
        said = []
        for axis, name in enumerate(self._names, start=1):
            low, high = self._ranges(name)[first[axis]]
            if math.isfinite(low) or math.isfinite(high):
                parts = [f"at least {low:g}"] if math.isfinite(low) else []
                said.append(f"{name} " + " and ".join(parts + [f"below {high:g}"] * math.isfinite(high)))
        if len(self._shapes) > 1:
            shape = self._shapes[first[0]]
            said.append(f"shape {shape}" if shape else "any other shape")
        return ", ".join(said) or "anything"

    def _ranges(self, name: str) -> list[Range]:
        return list(itertools.pairwise(self._edges[name]))

    def _along(self, axis: int, values: list[bool]) -> Any:
        shape = [1] * len(self._size)
        shape[axis] = len(values)
        return np.array(values, np.bool_).reshape(shape)


def _edges(ranges: Sequence[Mapping[str, Range]], name: str) -> list[float]:
    return sorted({-math.inf, math.inf, *(edge for one in ranges if name in one for edge in one[name])})
