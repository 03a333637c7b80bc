"""Extractors on real camera images: stripes on a wheel set, a line in a weld groove, one on printed boards.

``python -m benchmarks extract_real [--methods WORD …] [--only wheelset weld boards] [--out FOLDER]``

The images are not part of the project: the environment variable ROEMETRY_REAL_DATA names their folder
(default ``../shared/real``); what is not there is skipped with the reason. ``--out`` writes overlays.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2

from benchmarks.extraction.methods import extractors
from benchmarks.extraction.page import machine, put_into_page
from benchmarks.extraction.tables import Table
from benchmarks.real_images.boards import boards
from benchmarks.real_images.weld import weld
from benchmarks.real_images.wheelset import wheelset
from roemetry.stages import Extractor

PARTS = {"wheelset": wheelset, "weld": weld, "boards": boards}
BLOCK = "extract_real"


def main() -> None:
    """Print a table for each set of images."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", nargs="*", default=[], help="only extractors whose name holds a word")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS), help="sets to judge")
    parser.add_argument("--out", type=Path, help="folder for overlays")
    parser.add_argument("--page", action="store_true", help="put the tables into the documentation")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    stages = {
        name: stage
        for name, stage in extractors()
        if isinstance(stage, Extractor) and (not given.methods or any(word in name for word in given.methods))
    }
    tables = []
    for part in given.only:
        table = PARTS[part](stages, given.out)
        if isinstance(table, Table):
            tables.append(table)
            print(table, flush=True)
        else:
            print(f"skipped: {part}: {table}", file=sys.stderr)
    if given.page and tables:
        put_into_page(tables, f"Measured by `python -m benchmarks extract_real` on {machine()}.", BLOCK)


if __name__ == "__main__":
    main()
