"""What every planner keeps."""

from __future__ import annotations

import math
from typing import Any

from roemetry.stages import Planner
from roemetry.testing.verdict import require


def check_every_figure_has_unit_and_basis(planner: Planner[Any]) -> None:
    """Every figure, table, map and curve says its unit, and the formula or source it comes from."""
    plan = planner.plan(simulate=False)
    require(bool(plan.figures), "the plan has no figures")
    columns = [column for table in plan.tables for column in table.columns]
    columns += [line for curves in plan.curves for line in (curves.over, *curves.lines)]
    with_unit = [(figure.name, figure.unit) for figure in plan.figures]
    with_unit += [(one.name, one.unit) for one in plan.maps]
    with_unit += [(column.name, column.unit) for column in columns]
    for name, unit in with_unit:
        require(bool(unit), f"`{name}` has no unit")
    told = [(figure.name, figure.basis) for figure in plan.figures]
    told += [(one.name, one.basis) for one in plan.maps]
    told += [(table.name, table.basis) for table in plan.tables]
    told += [(curves.name, curves.basis) for curves in plan.curves]
    for name, basis in told:
        require(bool(basis), f"`{name}` does not say where it comes from")


def check_what_is_missing_has_a_reason(planner: Planner[Any]) -> None:
    """A plan with a figure that cannot be said (NaN) has reasons in words."""
    plan = planner.plan(simulate=False)
    missing = [one.name for one in plan.figures if math.isnan(one.value)]
    require(not missing or bool(plan.reasons), f"{', '.join(missing)}: no reason is given")


CHECKS = (check_every_figure_has_unit_and_basis, check_what_is_missing_has_a_reason)
