"""How far each feature spreads over rigs for the same body, against how far bodies lie apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.grading.virtual_rows import make_body, rendered_bodies, rows_of_body
from benchmarks.tables import table
from roemetry_shape.novelty import GOOD_SPREAD

SEED, RIGS = 91000, 12
CLASSES = ("good", "dent", "bend", "twist", "fold", "broken")


def spread_table(rendered: Path | None) -> str:
    """Write, for each feature that tells a defect, its spread over rigs and between bodies of all classes."""
    bodies = [
        make_body(family, SEED + k, name) for family in ("ours", "second") for k, name in enumerate(CLASSES)
    ]
    bodies += [] if rendered is None else rendered_bodies(rendered)
    rng = np.random.default_rng(SEED)
    values = [
        [[row.features[name] for name in GOOD_SPREAD] for row in rows_of_body(body, "spread", k, rng, RIGS)]
        for k, body in enumerate(bodies)
    ]
    within = np.median([np.std(one, axis=0) for one in values], axis=0)
    between = np.std([np.median(one, axis=0) for one in values], axis=0)
    rows = [
        [f"`{name}`", f"{inner:.2g}", f"{outer:.2g}", f"{outer / inner:.1f}"]
        for name, inner, outer in zip(GOOD_SPREAD, within, between, strict=True)
    ]
    return table(("feature", "over rigs", "between bodies", "ratio"), rows)
