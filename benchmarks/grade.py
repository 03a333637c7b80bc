"""Classifiers on unseen skeins and rigs: the model beside the recipe, and docs/explanation/grading.md.

``python -m benchmarks grade [--learn 750] [--test 450] [--strangers 10] [--cache DIR] …``

Learns on skeins from seed 50000 on rigs about the recipe's, each kind by turns. Tests on the population on
such rigs (from 80200), and on a third and a sixth as many on another design (from 71000) and on quite another
with 21 stripes (from 72000). A skein takes half a second; the cache keeps it.
Strangers, which must be unknown, are products that are no skeins, from seed 66000.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.grading.grade_page import page
from benchmarks.grading.judges import fitted_limits, fitted_model, judges_of
from benchmarks.grading.scores import judged_by
from benchmarks.grading.strangers import strangers
from benchmarks.traced import rows_of
from benchmarks.traced.tables import LEARNING_MIX, Row

MODEL = Path("recipes/herring_roe/classifier.json")
LEARN_FROM = 50000
STRANGERS_FROM = 66000
DENSE_LEARN = (73000, 73250)
TESTS = {
    "recipe-like": (80200, 1.0, ()),
    "farther": (71000, 1 / 3, LEARNING_MIX),
    "dense": (72000, 1 / 6, LEARNING_MIX),
}
"""First seed, how many of `--test`, and the mix of kinds; none: as the population has them."""


def main() -> None:
    """Learn, test, and write model, page and curve."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--learn", type=int, default=750, help="skeins to learn from")
    parser.add_argument("--test", type=int, default=450, help="skeins of the first test")
    parser.add_argument("--strangers", type=int, default=10, help="of each family that is no skein")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-traced")
    parser.add_argument("--model", type=Path, default=MODEL)
    parser.add_argument("--page", type=Path, default=Path("docs/explanation/grading.md"))
    given = parser.parse_args()
    learning = rows_of(
        range(LEARN_FROM, LEARN_FROM + given.learn), "recipe-like", given.cache, mix=LEARNING_MIX
    )
    fitted, limits = fitted_model(learning), fitted_limits(learning)
    given.model.write_text(_with_origin(fitted.content, learning), encoding="utf-8")
    judges = judges_of(given.model, limits)
    tests = {
        rig: rows_of(range(first, first + round(part * given.test)), rig, given.cache, mix=mix)
        for rig, (first, part, mix) in TESTS.items()
    }
    found = {
        rig: {name: judged_by(judge, rows) for name, judge in judges.items()} for rig, rows in tests.items()
    }
    again = fitted_model(rows_of(range(*DENSE_LEARN), "dense", given.cache, mix=LEARNING_MIX))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dense.json"
        path.write_text(again.content, encoding="utf-8")
        judge = judges_of(path, limits)["`learned`"]
        found["dense"]["`learned`, fitted on such rigs"] = judged_by(judge, tests["dense"])
    text = page(learning, fitted, limits, tests, found, given.model.stat().st_size, given.page.parent.parent)
    seeds = range(STRANGERS_FROM, STRANGERS_FROM + given.strangers)
    text += strangers(given.model, seeds, given.cache)
    given.page.write_text(text, encoding="utf-8")
    print(text)


def _with_origin(content: str, learning: Sequence[Row]) -> str:
    """Say in the model itself what it was fitted on."""
    model = json.loads(content)
    model["about"]["fitted_on"] = (
        f"{len(learning)} simulated herring roe skeins, seeds {learning[0].seed} to {learning[-1].seed}, "
        "traced without images on rigs about the recipe's, eleven stripes; no real skein"
    )
    return json.dumps(model, allow_nan=False, separators=(",", ":")) + "\n"


if __name__ == "__main__":
    main()
