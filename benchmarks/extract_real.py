"""Extractors on real camera images: stripes on a wheel set, a line in a weld groove, one on printed boards.

``python -m benchmarks extract_real [--methods WORD …] [--only wheelset weld boards]``

The images are not part of the project: the environment variable ROEMETRY_REAL_DATA names their folder
(default ``../shared/real``); what is not there is skipped with the reason.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import cv2

from benchmarks.extraction.methods import extractors
from benchmarks.real_images.boards import boards
from benchmarks.real_images.weld import weld
from benchmarks.real_images.wheelset import wheelset
from benchmarks.tables import Table, put_tables
from roemetry.stages import Extractor

_THRESHOLD = 20.0
PARTS = {"wheelset": wheelset, "weld": weld, "boards": boards}


def main() -> None:
    """Print a table for each set of images."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", nargs="*", default=[], help="only extractors whose name holds a word")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS), help="sets to judge")
    parser.add_argument("--page", action="store_true", help="put the tables into the documentation")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    stages = dict(chosen(given.methods))
    tables = []
    for part in given.only:
        table = PARTS[part](stages)
        if isinstance(table, Table):
            tables.append(table)
            print(table, flush=True)
        else:
            print(f"skipped: {part}: {table}", file=sys.stderr)
    if given.page and tables:
        put_tables(tables, "extract_real")


def chosen(words: Sequence[str]) -> Iterator[tuple[str, Extractor[Any]]]:
    """Make the extractors; those that find their threshold also with the one a user would set here."""
    for name, stage in extractors():
        if isinstance(stage, str) or (words and not any(word in name for word in words)):
            continue
        yield name, stage
        if getattr(stage.options, "threshold", None) == "auto":
            told = stage.options.model_copy(update={"threshold": _THRESHOLD})
            yield f"{name}, threshold {_THRESHOLD:.0f}", type(stage)(told)


if __name__ == "__main__":
    main()
