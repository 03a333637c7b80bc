"""What a rig will give, worked out beforehand: figures, maps over the volume, tables, curves, a side view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Floats
from roemetry.records.reasons import Reason


@dataclass(frozen=True, slots=True)
class PlanFigure:
    """One number.

    Attributes
    ----------
    name
        Kebab-case, for programs.
    title
        For people.
    value
        NaN where it cannot be said; then a reason of the plan says why.
    unit
        ``mm``, ``px``, ``degrees``, ``1`` for a count, …
    basis
        The formula or the source, and where it holds.
    key
        Whether it belongs among the first to be read.
    """

    name: str
    title: str
    value: float
    unit: str
    basis: str
    key: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class PlanColumn:
    """Named numbers with a unit: a table's column, a curve, or what curves are drawn over.

    Attributes
    ----------
    name, title, unit
        As of a figure.
    values
        (n,) NaN where there is none.
    digits
        Decimal places to print.
    """

    name: str
    title: str
    unit: str
    values: Floats
    digits: int = 1

    def __post_init__(self) -> None:
        check = Checker(self)
        check.array("values", np.float64, (None,))
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class PlanTable:
    """Columns of one length; the first says what a row is about.

    Attributes
    ----------
    name, title, basis
        As of a figure.
    columns
        All of one length.
    """

    name: str
    title: str
    columns: tuple[PlanColumn, ...]
    basis: str

    def __post_init__(self) -> None:
        check = Checker(self)
        check.require(len({len(c.values) for c in self.columns}) == 1, "columns differ in length")
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class PlanCurves:
    """Curves over one quantity.

    Attributes
    ----------
    name, title, basis
        As of a figure.
    over
        What they are drawn over.
    lines
        Each as long as `over`, of one unit.
    marked
        A value of `over` to point out: where the rig stands. NaN: none.
    logarithmic
        Whether their scale is logarithmic.
    """

    name: str
    title: str
    over: PlanColumn
    lines: tuple[PlanColumn, ...]
    basis: str
    marked: float = float("nan")
    logarithmic: bool = False

    def __post_init__(self) -> None:
        check = Checker(self)
        lengths = {len(line.values) for line in self.lines}
        check.require(lengths == {len(self.over.values)}, "the curves differ in length")
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class PlanMap:
    """A quantity over belt X and Z, at one Y.

    Attributes
    ----------
    name, title, unit, basis
        As of a figure.
    x_mm, z_mm
        (n,), (m,) evenly spaced, increasing, belt frame, mm.
    values
        (m, n) NaN where the camera does not see.
    """

    name: str
    title: str
    unit: str
    x_mm: Floats
    z_mm: Floats
    values: Floats
    basis: str
    digits: int = 2

    def __post_init__(self) -> None:
        check = Checker(self)
        x = check.array("x_mm", np.float64, (None,))
        z = check.array("z_mm", np.float64, (None,))
        check.array("values", np.float64, (len(z), len(x)))
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class PlanShape:
    """A part of the side view, to scale.

    Attributes
    ----------
    kind
        ``camera``, ``projector`` (a point), ``view`` (a closed shape), ``axis``, ``plane``, ``belt``,
        ``level`` (lines).
    points_mm
        (n, 2) X and Z in the belt frame, mm.
    label
        Words beside it; may be empty.
    """

    kind: str
    points_mm: Floats
    label: str = ""

    def __post_init__(self) -> None:
        check = Checker(self)
        check.array("points_mm", np.float64, (None, 2))
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """All that can be said of a rig before it is built.

    Attributes
    ----------
    figures, maps, tables, curves
        What is predicted, and with a simulation what was found beside it.
    sketch
        The rig from the side.
    reasons
        What is missing or doubtful, and why.
    """

    figures: tuple[PlanFigure, ...]
    maps: tuple[PlanMap, ...] = ()
    tables: tuple[PlanTable, ...] = ()
    curves: tuple[PlanCurves, ...] = ()
    sketch: tuple[PlanShape, ...] = ()
    reasons: tuple[Reason, ...] = field(default=())

    def value(self, name: str) -> float:
        """Give the value of a figure; raise KeyError where there is none of that name."""
        for figure in self.figures:
            if figure.name == name:
                return figure.value
        raise KeyError(name)

    def column(self, table: str, name: str) -> Floats:
        """Give a column of a table; raise KeyError where there is none."""
        for one in self.tables:
            if one.name == table:
                for column in one.columns:
                    if column.name == name:
                        return column.values
        raise KeyError(f"{table}/{name}")
