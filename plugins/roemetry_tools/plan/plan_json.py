"""A plan as plain data, for JSON: units beside every number, null where there is none."""

from __future__ import annotations

import math
from typing import Any

from roemetry.records import Plan, PlanColumn
from roemetry.records.arrays import Floats


def as_plain(plan: Plan) -> dict[str, Any]:
    """Give a plan as dictionaries, lists and numbers; NaN becomes None."""
    return {
        "figures": {
            one.name: {"title": one.title, "value": _number(one.value), "unit": one.unit, "basis": one.basis}
            for one in plan.figures
        },
        "tables": {
            one.name: {"title": one.title, "basis": one.basis, "columns": [_column(c) for c in one.columns]}
            for one in plan.tables
        },
        "curves": {
            one.name: {
                "title": one.title,
                "basis": one.basis,
                "over": _column(one.over),
                "lines": [_column(line) for line in one.lines],
                "marked": _number(one.marked),
            }
            for one in plan.curves
        },
        "maps": {
            one.name: {
                "title": one.title,
                "unit": one.unit,
                "basis": one.basis,
                "x_mm": _numbers(one.x_mm),
                "z_mm": _numbers(one.z_mm),
                "values": [_numbers(row) for row in one.values],
            }
            for one in plan.maps
        },
        "reasons": [{"code": reason.code, "text": reason.text} for reason in plan.reasons],
    }


def _column(column: PlanColumn) -> dict[str, Any]:
    return {
        "name": column.name,
        "title": column.title,
        "unit": column.unit,
        "values": _numbers(column.values),
    }


def _numbers(values: Floats) -> list[float | None]:
    return [_number(float(value)) for value in values]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
