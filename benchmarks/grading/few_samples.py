"""What ten skeins of a rig teach: good kept and defects caught of the other skeins on that rig."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.grading.bodies import Body
from benchmarks.grading.judges import GOOD, SHOWN_MM, samples_of
from benchmarks.grading.virtual_rig import draw_rig
from benchmarks.grading.virtual_rows import KINDS, lofted_skein, make_body, rendered_bodies, rows_of_body
from benchmarks.tables import table
from benchmarks.traced.tables import Row
from roemetry_shape.learned import Learned, LearnedOptions

MIX = (*(GOOD,) * 7, "dent", "dent", "bend", "twist", "fold", "broken", "dent")
FIRST, BODIES, RIGS, TRIALS = 520000, 56, 5, 4


def few_table(rendered: Path | None, begin: Path) -> str:
    """Write good kept and others caught, over rigs and draws of the ten, by family and what was labelled."""
    families = {"our skeins": [make_body("ours", FIRST + k, MIX[k % len(MIX)]) for k in range(BODIES)]}
    try:
        families["skeins of `mitsuba`"] = [lofted_skein(FIRST + k, MIX[k % len(MIX)]) for k in range(BODIES)]
    except ImportError:
        print("skeins of `mitsuba`: left out, the plugin is not installed")
    if rendered is not None:
        families["skeins of the rendered set"] = rendered_bodies(rendered) * 6
    lines = []
    for family, bodies in families.items():
        by_rig = [_measured(bodies, rig) for rig in range(RIGS)]
        for good, others, start in ((8, 0, None), (10, 0, None), (8, 4, None), (10, 0, begin)):
            told = f"{good} good, {others} named" + (", begun with the shipped model" if start else "")
            lines.append([family, told, *_judged(by_rig, good, others, start)])
    return table(("products", "fitted on", "good kept", "caught", "named right", "named wrong"), lines)


def _measured(bodies: Sequence[Body], rig_seed: int) -> list[Row]:
    rng = np.random.default_rng([FIRST, rig_seed])
    rig = draw_rig(rng)
    rows = []
    for number, body in enumerate(bodies):
        lies = rig._replace(phase=float(rng.uniform(-0.5, 0.5)))
        found = rows_of_body(body, "rig", number, rng, 1, lies)
        rows += [row for row in found if body.label == GOOD or row.defect["shown_mm"] >= SHOWN_MM]
    return [row for row in rows if row.features]


def _judged(by_rig: Sequence[Sequence[Row]], good: int, others: int, begin: Path | None) -> list[str]:
    rng = np.random.default_rng(FIRST)
    kept: list[bool] = []
    caught: list[bool] = []
    right: list[bool] = []
    wrong: list[bool] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "few.json"
        for rows in by_rig:
            for _ in range(TRIALS):
                order = [rows[k] for k in rng.permutation(len(rows))]
                sound = [row for row in order if row.name == GOOD]
                deformed = [row for row in order if row.name != GOOD]
                given = samples_of(sound[:good] + deformed[:others])
                fitted = Learned.fit(given, good=GOOD, begin=begin)
                path.write_text(fitted.content, encoding="utf-8")
                learned = Learned(LearnedOptions(model=path))
                kept += [learned.judge(row.features).label == GOOD for row in sound[good:]]
                for row in deformed[others:]:
                    label = learned.judge(row.features).label
                    caught.append(label != GOOD)
                    right.append(label == row.name)
                    wrong.append(label in KINDS and label not in (GOOD, row.name))
    shares = [f"{100.0 * np.mean(one):.1f} %" for one in (kept, caught, right, wrong)]
    return [f"{shares[0]} of {len(kept)}", f"{shares[1]} of {len(caught)}", *shares[2:]]
