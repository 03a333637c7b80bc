"""Shape: features of cross-sections and surface, and classes by limits, fuzzy rules, or learning."""

from __future__ import annotations

from collections.abc import Iterator

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterator[StageEntry]:
    """Register the stages of this package."""
    yield StageEntry(
        kind="classifier",
        name="shape-limits",
        target="roemetry_shape.shape_limits:ShapeLimits",
        summary="Limits on shape features; the first broken one names the class",
        reference="our own",
    )
    yield StageEntry(
        kind="classifier",
        name="fuzzy-rules",
        target="roemetry_shape.fuzzy_rules:FuzzyRules",
        summary="A fuzzy rule base over shape features",
        reference="Zadeh 1965; Mamdani and Assilian 1975",
    )
    yield StageEntry(
        kind="classifier",
        name="learned",
        target="roemetry_shape.learned:Learned",
        summary="Classes learned from labelled products, with calibrated probabilities",
        reference="Hastie, Tibshirani and Friedman 2009",
    )
    yield StageEntry(
        kind="grader",
        name="grade-table",
        target="roemetry_shape.grade_table:GradeTable",
        summary="A buyer's classes over shape, size, weight and colour, with guard bands",
        reference="ISO 14253-1 (decision rules); the table is ours",
    )
