"""Classifiers on bodies, populations and rigs not seen; the model beside the recipe.

``python -m benchmarks grade [--bodies 440] [--test 110] [--rendered FOLDER] [--model FILE] [--cache DIR]``

Learns on skeins of our simulator, of the simulator `mitsuba`, and of a second family of the benchmarks' own,
each on two rigs drawn at random, no two alike. Tests on fresh bodies of both simulators; on the meshes of a
rendered set (where a folder is given), whose family nothing was learned from; and on traced skeins of our
simulator with a coder's errors. Then fits on ten skeins of one rig, and tests on the others of that rig.
The tables are those of docs/measurements/grading.md; the last says how far each feature spreads over rigs for
the same body, against how far bodies lie apart.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.command import parser_of
from benchmarks.grading.bodies import CLASSES, Body
from benchmarks.grading.judges import (
    GOOD,
    NOT_GOOD,
    SHOWN_MM,
    UNKNOWN,
    Judged,
    fitted_limits,
    fitted_model,
    judged_by,
    judges_of,
    samples_of,
)
from benchmarks.grading.unseen_products import unseen_products
from benchmarks.grading.virtual_rig import draw_rig
from benchmarks.grading.virtual_rows import (
    KINDS,
    make_body,
    rendered_bodies,
    rendered_rows,
    rows_of_body,
    virtual_rows,
)
from benchmarks.tables import table
from benchmarks.traced import Row, rows_of
from roemetry_shape.learned import Learned, LearnedOptions
from roemetry_shape.novelty import GOOD_SPREAD

MODEL = Path("recipes/herring_roe/classifier.json")
LEARN_FROM = {"ours": 200000, "second": 110000, "lofted": 700000}
TEST_FROM = {"ours": 930000, "lofted": 310000}
TRACED_FROM = {"recipe-like": 80700, "dense": 72100}
UNSEEN_FROM = 66100
RENDERED_RIGS = 20
NAMES = {
    "ours": "our skeins, random rigs",
    "lofted": "skeins of `mitsuba`, random rigs",
    "rendered": "skeins of the rendered set, random rigs",
    "recipe-like": "our skeins, traced and labelled",
    "dense": "the same, 21 stripes, three times the noise",
}


def main() -> None:
    """Learn, test, and write the model; print the tables."""
    parser = parser_of(__doc__)
    parser.add_argument("--bodies", type=int, default=440, help="to learn from, of each family")
    parser.add_argument("--test", type=int, default=110, help="bodies of each test")
    parser.add_argument("--unseen", type=int, default=4, help="of each family that is no skein")
    parser.add_argument("--rendered", type=Path, help="folder of a rendered set, with `objects/`")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-traced")
    parser.add_argument("--model", type=Path, default=MODEL)
    given = parser.parse_args()
    learning = [
        row
        for family, first in LEARN_FROM.items()
        for row in virtual_rows(family, range(first, first + given.bodies), 2, given.cache)
    ]
    fitted, limits = fitted_model(learning), fitted_limits(learning)
    given.model.write_text(_with_origin(fitted.content, learning), encoding="utf-8")
    judges = judges_of(given.model, limits)
    tests = _tests(given.test, given.rendered, given.cache)
    judged = {
        test: {name: judged_by(judge, rows) for name, judge in judges.items()} for test, rows in tests.items()
    }
    print(_results(judged))
    print(_reliability({test: by_judge["`learned`"] for test, by_judge in judged.items()}))
    print(few_table(given.rendered, given.model))
    print(spread_table(given.rendered))
    print(unseen_products(given.model, range(UNSEEN_FROM, UNSEEN_FROM + given.unseen), given.cache))


def _tests(count: int, rendered: Path | None, cache: Path) -> dict[str, Sequence[Row]]:
    tests: dict[str, Sequence[Row]] = {}
    for family, first in TEST_FROM.items():
        try:
            tests[family] = virtual_rows(family, range(first, first + count), 1, cache)
        except ImportError:
            print(f"{NAMES[family]}: left out, the plugin is not installed")
    if rendered is not None:
        tests["rendered"] = rendered_rows(rendered, RENDERED_RIGS)
    for rig, first in TRACED_FROM.items():
        tests[rig] = rows_of(range(first, first + count), rig, cache)
    return tests


def _results(found: Mapping[str, Mapping[str, Sequence[Judged]]]) -> str:
    """Write shares of all products whose defect, if they have one, a stripe shows by a millimetre."""
    rows = []
    for test, by_judge in found.items():
        for name, judged in by_judge.items():
            asked = [one for one in judged if one.row.name == GOOD or one.row.shown_mm >= SHOWN_MM]
            good = [one.label == GOOD for one in asked if one.row.name == GOOD]
            caught = [one.caught for one in asked if one.row.name != GOOD]
            named = [one.label == one.row.name for one in asked]
            unnamed = [one.right and one.label == NOT_GOOD for one in asked]
            unknown = [one.label == UNKNOWN for one in asked]
            wrong = 1.0 - np.mean(named) - np.mean(unnamed) - np.mean(unknown)
            if "paper" in name:  # it says good or not, and names no defect
                wrong = np.mean([(one.label == GOOD) != (one.row.name == GOOD) for one in asked])
            shares = [np.mean(one) for one in (good, caught, named, unnamed, wrong, unknown)]
            cells = [f"{100.0 * one:.1f} %" for one in shares]
            cells[2] = "names none" if "paper" in name else cells[2]
            rows.append([NAMES[test], str(len(asked)), name, *cells])
    head = ("products", "n", "classifier", "good kept", "caught", "right", "not named", "wrong", "unknown")
    return table(head, rows)


def _reliability(found: Mapping[str, Sequence[Judged]]) -> str:
    """Write stated probabilities against shares right, of what was stated by `learned`."""
    rows = []
    for test, judged in found.items():
        stated = [one for one in judged if one.label != UNKNOWN]
        if stated:
            p = np.mean([one.probability for one in stated])
            right = np.mean([one.right for one in stated])
            rows.append([NAMES[test], str(len(stated)), f"{p:.3f}", f"{right:.3f}"])
    return table(("products", "stated", "mean probability", "share right"), rows)


def _with_origin(content: str, learning: Sequence[Row]) -> str:
    """Say in the model itself what it was fitted on."""
    model = json.loads(content)
    bodies = len({(row.rig, row.seed) for row in learning})
    model["about"]["fitted_on"] = (
        f"{bodies} simulated herring roe skeins of three families, {len(learning)} measured without images, "
        "each on a rig of its own (11 to 27 stripes, either side, 20 to 50 degrees of light); no real skein"
    )
    return json.dumps(model, allow_nan=False, separators=(",", ":")) + "\n"


FEW_MIX = (*(GOOD,) * 7, "dent", "dent", "bend", "twist", "fold", "broken", "dent")
FEW_FIRST, BODIES, FEW_RIGS, TRIALS = 520000, 56, 5, 4


def few_table(rendered: Path | None, begin: Path) -> str:
    """Write good kept and others caught, over rigs and draws of the ten, by family and what was labelled."""
    kinds = [(FEW_FIRST + k, FEW_MIX[k % len(FEW_MIX)]) for k in range(BODIES)]
    families = {"our skeins": [make_body("ours", *kind) for kind in kinds]}
    try:
        families["skeins of `mitsuba`"] = [make_body("lofted", *kind) for kind in kinds]
    except ImportError:
        print("skeins of `mitsuba`: left out, the plugin is not installed")
    if rendered is not None:
        families["skeins of the rendered set"] = rendered_bodies(rendered) * 6
    lines = []
    for family, bodies in families.items():
        by_rig = [_measured(bodies, rig) for rig in range(FEW_RIGS)]
        for good, others, start in ((8, 0, None), (10, 0, None), (8, 4, None), (10, 0, begin)):
            told = f"{good} good, {others} named" + (", begun with the shipped model" if start else "")
            lines.append([family, told, *_judged(by_rig, good, others, start)])
    return table(("products", "fitted on", "good kept", "caught", "named right", "named wrong"), lines)


def _measured(bodies: Sequence[Body], rig_seed: int) -> list[Row]:
    rng = np.random.default_rng([FEW_FIRST, rig_seed])
    rig = draw_rig(rng)
    rows = []
    for number, body in enumerate(bodies):
        lies = rig._replace(phase=float(rng.uniform(-0.5, 0.5)))
        found = rows_of_body(body, "rig", number, rng, 1, lies)
        rows += [row for row in found if body.label == GOOD or row.shown_mm >= SHOWN_MM]
    return [row for row in rows if row.features]


def _judged(by_rig: Sequence[Sequence[Row]], good: int, others: int, begin: Path | None) -> list[str]:
    rng = np.random.default_rng(FEW_FIRST)
    kept, called = list[bool](), list[tuple[str, str]]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "few.json"
        for rows in (rows for rows in by_rig for _ in range(TRIALS)):
            order = [rows[k] for k in rng.permutation(len(rows))]
            sound = [row for row in order if row.name == GOOD]
            deformed = [row for row in order if row.name != GOOD]
            fitted = Learned.fit(samples_of(sound[:good] + deformed[:others]), good=GOOD, begin=begin)
            path.write_text(fitted.content, encoding="utf-8")
            learned = Learned(LearnedOptions(model=path))
            kept += [learned.judge(row.features).label == GOOD for row in sound[good:]]
            called += [(row.name, learned.judge(row.features).label) for row in deformed[others:]]
    caught = np.mean([label != GOOD for _, label in called])
    right = np.mean([label == name for name, label in called])
    wrong = np.mean([label in KINDS and label not in (GOOD, name) for name, label in called])
    counts = f"{100.0 * np.mean(kept):.1f} % of {len(kept)}", f"{100.0 * caught:.1f} % of {len(called)}"
    return [*counts, f"{100.0 * right:.1f} %", f"{100.0 * wrong:.1f} %"]


SPREAD_FROM, SPREAD_RIGS = 91000, 12


def spread_table(rendered: Path | None) -> str:
    """Write, for each feature that tells a defect, its spread over rigs and between bodies of all classes."""
    kinds = [
        (family, SPREAD_FROM + k, name) for family in ("ours", "second") for k, name in enumerate(CLASSES)
    ]
    bodies = [make_body(*kind) for kind in kinds]
    bodies += [] if rendered is None else rendered_bodies(rendered)
    rng, values = np.random.default_rng(SPREAD_FROM), []
    for k, body in enumerate(bodies):
        rows = rows_of_body(body, "spread", k, rng, SPREAD_RIGS)
        values.append([[row.features[name] for name in GOOD_SPREAD] for row in rows])
    within = np.median([np.std(one, axis=0) for one in values], axis=0)
    between = np.std([np.median(one, axis=0) for one in values], axis=0)
    lines = [
        [f"`{name}`", f"{inner:.2g}", f"{outer:.2g}", f"{outer / inner:.1f}"]
        for name, inner, outer in zip(GOOD_SPREAD, within, between, strict=True)
    ]
    return table(("feature", "over rigs", "between bodies", "ratio"), lines)
