"""A grade table of three classes, for the checks of the grader."""

from __future__ import annotations

from roemetry_shape.grade_table import GradeClass, GradeTableOptions, Limits


def table_options() -> GradeTableOptions:
    """Give a table over weight: heavy, light, and the rest."""
    return GradeTableOptions(
        classes=(
            GradeClass(label="heavy", lane="1", limits={"weight_g": Limits(at_least=15.0)}),
            GradeClass(label="light", lane="2", limits={"weight_g": Limits(at_least=5.0)}),
            GradeClass(label="rest", lane="3"),
        )
    )
