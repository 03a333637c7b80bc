"""What every planner keeps."""

from __future__ import annotations

import math
from typing import Any

from roemetry.stages import Planner
from roemetry.testing.judging import require


def check_every_figure_has_unit_and_basis(planner: Planner[Any]) -> None:
    """Every figure, table, map and curve says its unit, and the formula or source it comes from."""
    plan = planner.plan(simulate=False)
    require(bool(plan.figures), "the plan has no figures")
    columns = [column for table in plan.tables for column in table.columns]
    columns += [line for curves in plan.curves for line in (curves.over, *curves.lines)]
    for one in (*plan.figures, *plan.maps, *columns):
        require(bool(one.unit), f"`{one.name}` has no unit")
    for told in (*plan.figures, *plan.maps, *plan.tables, *plan.curves):
        require(bool(told.basis), f"`{told.name}` does not say where it comes from")


def check_what_is_missing_has_a_reason(planner: Planner[Any]) -> None:
    """A plan with a figure that cannot be said (NaN) has reasons in words."""
    plan = planner.plan(simulate=False)
    missing = [one.name for one in plan.figures if math.isnan(one.value)]
    require(not missing or bool(plan.reasons), f"{', '.join(missing)}: no reason is given")


CHECKS = (check_every_figure_has_unit_and_basis, check_what_is_missing_has_a_reason)
