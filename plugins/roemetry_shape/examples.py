"""A model and a table for the conformance checks."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from roemetry_shape.grade_table import GradeClass, GradeTableOptions, Limits
from roemetry_shape.learned import LearnedModel, LearnedOptions
from roemetry_shape.novelty import SeenClasses


def learned_options() -> LearnedOptions:
    """Write a model that calls a product dented if a section is hollow by a millimetre; give its options."""
    model = LearnedModel(
        features=("hollow_depth_mm",),
        fill=np.zeros(1),
        classes=("dented", "good"),
        good="good",
        good_from=0.5,
        stated_from=0.0,
        weights=np.array([[4.0], [0.0]]),
        intercepts=np.array([-4.0 * np.arcsinh(1.0), 0.0]),
        seen=SeenClasses(np.zeros((2, 1)), np.ones(1), np.ones((2, 1, 1)), np.zeros(1), np.full(1, 6.0)),
        distance_max=20.0,
        excess_max=1.0,
        smoothing_mm=3.0,
    )
    path = Path(tempfile.mkdtemp()) / "one_decision.json"
    path.write_text(model.to_json({"samples": {}}), encoding="utf-8")
    return LearnedOptions(model=path)


def table_options() -> GradeTableOptions:
    """Give a table over weight: heavy, light, and the rest."""
    return GradeTableOptions(
        classes=(
            GradeClass(label="heavy", lane="1", limits={"weight_g": Limits(at_least=15.0)}),
            GradeClass(label="light", lane="2", limits={"weight_g": Limits(at_least=5.0)}),
            GradeClass(label="rest", lane="3"),
        )
    )
