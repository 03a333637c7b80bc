"""What a rig will give, worked out beforehand: figures, maps over the volume, tables, curves, a side view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Floats
from roemetry.records.reasons import Reason


@dataclass(frozen=True, slots=True)
class PlanFigure:
    """One number."""

    name: str
    title: str
    value: float
    """NaN where it cannot be said; then a reason of the plan says why."""
    unit: str
    """``mm``, ``px``, ``degrees``, ``1`` for a count, …"""
    basis: str
    """The formula or the source, and where it holds."""
    key: bool = False
    """Whether it belongs among the first to be read."""


@dataclass(frozen=True, eq=False, slots=True)
class PlanColumn:
    """Named numbers with a unit: a table's column, a curve, or what curves are drawn over."""

    name: str
    title: str
    unit: str
    values: Floats
    """(n,) NaN where there is none."""
    digits: int = 1

    def __post_init__(self) -> None:
        check = Checker(self)
        check.array("values", np.float64, (None,))
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class PlanTable:
    """Columns of one length; the first says what a row is about."""

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
    """Curves over one quantity."""

    name: str
    title: str
    over: PlanColumn
    lines: tuple[PlanColumn, ...]
    """Each as long as `over`, of one unit."""
    basis: str
    marked: float = float("nan")
    """A value of `over` to point out: where the rig stands. NaN: none."""
    logarithmic: bool = False
    """Whether their scale is logarithmic."""

    def __post_init__(self) -> None:
        check = Checker(self)
        lengths = {len(line.values) for line in self.lines}
        check.require(lengths == {len(self.over.values)}, "the curves differ in length")
        check.finish()


@dataclass(frozen=True, eq=False, slots=True)
class PlanMap:
    """A quantity over belt X and Z, at one Y."""

    name: str
    title: str
    unit: str
    x_mm: Floats
    z_mm: Floats
    """x_mm, z_mm: (n,), (m,) evenly spaced, increasing, belt frame, mm."""
    values: Floats
    """(m, n) NaN where the camera does not see."""
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
    """A part of the side view, to scale."""

    kind: str
    """``camera``, ``projector`` (a point), ``view`` (a closed shape), ``axis``, ``plane``, ``belt``,
    ``level`` (lines)."""
    points_mm: Floats
    """(n, 2) X and Z in the belt frame, mm."""
    label: str = ""
    """Words beside it; may be empty."""

    def __post_init__(self) -> None:
        check = Checker(self)
        check.array("points_mm", np.float64, (None, 2))
        check.finish()


@dataclass(frozen=True, slots=True)
class PlanAnswer:
    """Whether the rig measures the scene's product, and how well."""

    fits: bool
    volume_pct: float
    weight_pct: float
    """volume_pct, weight_pct: expected standard uncertainties, %; the weight's before it is fitted."""
    limiting: str
    """What the volume is limited by; of a product that does not fit, why not."""
    changes: tuple[str, ...]
    """What to change, the most useful first, each with what it gives."""

    @property
    def text(self) -> str:
        """The answer in a line."""
        if self.fits:
            said = (
                f"yes; expected volume ± {self.volume_pct:.1f} %, weight ± {self.weight_pct:.1f} % before "
                f"it is fitted; limited by {self.limiting}"
            )
        else:
            said = f"no: {self.limiting}"
        return f"your product: {said}" + "".join(f"; change: {change}" for change in self.changes[:1])


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """All that can be said of a rig before it is built."""

    figures: tuple[PlanFigure, ...]
    maps: tuple[PlanMap, ...] = ()
    tables: tuple[PlanTable, ...] = ()
    curves: tuple[PlanCurves, ...] = ()
    """figures, maps, tables, curves: what is predicted, and with a simulation what was found beside it."""
    sketch: tuple[PlanShape, ...] = ()
    reasons: tuple[Reason, ...] = field(default=())
    answer: PlanAnswer | None = None
    """Of the scene's product; None where there is none."""

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
