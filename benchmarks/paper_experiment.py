"""The paper's experiment again, on six skeins and on 500; writes docs/measurements/paper-experiment.md.

``python -m benchmarks paper_experiment [--count 500] [--images 60] [--cache DIR] [--page FILE]``

The six are the recipe's own images. The many are traced, not rendered: seeds from 80000, a rig each.
Classifiers with something to learn have learned from other seeds (see ``grade``). `--images` are rendered to
check against, from seed 9000, some seconds each, and kept in the temporary folder as ``herring_roe`` does.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.experiment.page import page
from benchmarks.experiment.rendered import on_images
from benchmarks.experiment.six import measured
from benchmarks.grade import LEARN_FROM, MODEL
from benchmarks.grading.judges import fitted_limits, judges_of
from benchmarks.grading.scores import judged_by
from benchmarks.products import made
from benchmarks.traced import rows_of
from benchmarks.traced.tables import LEARNING_MIX

FIRST = 80000
FIRST_IMAGE = 9000
RECIPE = Path("recipes/herring_roe")


def main() -> None:
    """Measure, and write page and figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--learn", type=int, default=750, help="skeins that limits are found on")
    parser.add_argument("--images", type=int, default=60, help="skeins that are rendered, too")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "roemetry-traced")
    parser.add_argument("--page", type=Path, default=Path("docs/measurements/paper-experiment.md"))
    given = parser.parse_args()
    rows = rows_of(range(FIRST, FIRST + given.count), "recipe-like", given.cache)
    learning = range(LEARN_FROM, LEARN_FROM + given.learn)
    limits = fitted_limits(rows_of(learning, "recipe-like", given.cache, mix=LEARNING_MIX))
    found = {name: judged_by(judge, rows) for name, judge in judges_of(MODEL, limits).items()}
    images = given.page.parent.parent / "images" / "paper"
    six = measured(RECIPE, images)
    rendered = on_images(RECIPE, made(RECIPE, FIRST_IMAGE, given.images), MODEL, given.images)
    text = page(six, rows, found, rendered, images)
    given.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
