"""Classifiers on bodies, populations and rigs not seen; the model beside the recipe.

``python -m benchmarks grade [--bodies 440] [--test 110] [--rendered FOLDER] [--model FILE] [--cache DIR]``

Learns on skeins of our simulator, of the simulator `mitsuba`, and of a second family of the benchmarks' own,
each on two rigs drawn at random, no two alike. Tests on fresh bodies of both simulators; on the meshes of a
rendered set (where a folder is given), whose family nothing was learned from; and on traced skeins of our
simulator with a coder's errors. Then fits on ten skeins of one rig, and tests on the others of that rig.
The tables are those of docs/measurements/grading.md.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.grading.few_samples import few_table
from benchmarks.grading.judges import GOOD, SHOWN_MM, fitted_limits, fitted_model, judges_of
from benchmarks.grading.scores import UNKNOWN, Judged, judged_by
from benchmarks.grading.spread import spread_table
from benchmarks.grading.strangers import strangers
from benchmarks.grading.virtual_rows import rendered_rows, virtual_rows
from benchmarks.tables import table
from benchmarks.traced import rows_of
from benchmarks.traced.tables import LEARNING_MIX, Row

MODEL = Path("recipes/herring_roe/classifier.json")
LEARN_FROM = {"ours": 200000, "second": 110000, "lofted": 700000}
TEST_FROM = {"ours": 930000, "lofted": 310000}
TRACED_FROM = {"recipe-like": 80700, "dense": 72100}
STRANGERS_FROM = 66100
RENDERED_RIGS = 20
NAMES = {
    "ours": "our skeins, random rigs",
    "lofted": "skeins of `mitsuba`, random rigs",
    "rendered": "skeins of the rendered set, random rigs",
    "recipe-like": "our skeins, traced and coded",
    "dense": "the same, 21 stripes, three times the noise",
}


def main() -> None:
    """Learn, test, and write the model; print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bodies", type=int, default=440, help="to learn from, of each family")
    parser.add_argument("--test", type=int, default=110, help="bodies of each test")
    parser.add_argument("--strangers", type=int, default=4, help="of each family that is no skein")
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
    print(
        _results(
            {name: {j: judged_by(judge, rows) for j, judge in judges.items()} for name, rows in tests.items()}
        )
    )
    print(_reliability({name: judged_by(judges["`learned`"], rows) for name, rows in tests.items()}))
    print(few_table(given.rendered, given.model))
    print(spread_table(given.rendered))
    print(strangers(given.model, range(STRANGERS_FROM, STRANGERS_FROM + given.strangers), given.cache))


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
        tests[rig] = rows_of(range(first, first + count), rig, cache, mix=LEARNING_MIX)
    return tests


def _results(found: Mapping[str, Mapping[str, Sequence[Judged]]]) -> str:
    """Write shares of all products whose defect, if they have one, a stripe shows by a millimetre."""
    rows = []
    for test, by_judge in found.items():
        for name, judged in by_judge.items():
            asked = [one for one in judged if one.row.name == GOOD or one.row.defect["shown_mm"] >= SHOWN_MM]
            good = [one.label == GOOD for one in asked if one.row.name == GOOD]
            caught = [one.caught for one in asked if one.row.name != GOOD]
            right = [one.label == one.row.name for one in asked]
            unknown = [one.label == UNKNOWN for one in asked]
            wrong = 1.0 - np.mean(right) - np.mean(unknown)
            if "paper" in name:  # it says good or not, and names no defect
                wrong = np.mean([(one.label == GOOD) != (one.row.name == GOOD) for one in asked])
            shares = [np.mean(good), np.mean(caught), np.mean(right), wrong, np.mean(unknown)]
            cells = [f"{100.0 * one:.1f} %" for one in shares]
            cells[2] = "names none" if "paper" in name else cells[2]
            rows.append([NAMES[test], str(len(asked)), name, *cells])
    head = ("products", "n", "classifier", "good kept", "caught", "right", "wrong", "unknown")
    return table(head, rows)


def _reliability(found: Mapping[str, Sequence[Judged]]) -> str:
    """Write stated probabilities against shares right, of what was stated by `learned`."""
    rows = []
    for test, judged in found.items():
        stated = [one for one in judged if one.label != UNKNOWN]
        if stated:
            p = np.mean([one.probability for one in stated])
            right = np.mean([one.label == one.row.name for one in stated])
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


if __name__ == "__main__":
    main()
