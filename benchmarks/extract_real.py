"""Extractors on real camera images: stripes on a wheel set, a line in a weld groove, one on printed boards.

``python -m benchmarks extract_real [--methods WORD …] [--only wheelset weld boards]``

The images are not part of the project: the environment variable ROEMETRY_REAL_DATA names their folder
(default ``../shared/real``); what is not there is skipped with the reason.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import Any

import cv2

from benchmarks.command import parser_of
from benchmarks.extraction.methods import there
from benchmarks.real_images import folder_of
from benchmarks.real_images.boards import boards
from benchmarks.real_images.weld import weld
from benchmarks.real_images.wheelset import wheelset
from benchmarks.tables import put_tables
from roemetry.stages import Extractor

_THRESHOLD = 20.0
PARTS = {
    "wheelset": ("multi_stripe", wheelset), "weld": ("weld_mit", weld),
    "boards": ("laser_on_circle_grid", boards),
}  # fmt: skip
"""By name: the folder of the images, and what judges extractors on them."""


def main() -> None:
    """Print a table for each set of images."""
    parser = parser_of(__doc__)
    parser.add_argument("--methods", nargs="*", default=[], help="only extractors whose name holds a word")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS), help="sets to judge")
    parser.add_argument("--page", action="store_true", help="put the tables into the documentation")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    stages = dict(chosen(given.methods))
    tables = []
    for part in given.only:
        folder, judged = PARTS[part]
        home = folder_of(folder)
        if home is None:
            print(f"skipped: {part}: {folder} is not there: set ROEMETRY_REAL_DATA", file=sys.stderr)
            continue
        tables.append(judged(home, stages))
        print(tables[-1], flush=True)
    if given.page and tables:
        put_tables(tables, "extract_real")


def chosen(words: Sequence[str]) -> Iterator[tuple[str, Extractor[Any]]]:
    """Make the extractors; those that find their threshold also with the one a user would set here."""
    for name, stage in there(words):
        yield name, stage
        if getattr(stage.options, "threshold", None) == "auto":
            told = stage.options.model_copy(update={"threshold": _THRESHOLD})
            yield f"{name}, threshold {_THRESHOLD:.0f}", type(stage)(told)
