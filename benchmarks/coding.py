"""Coders against known truth: what they label, what they get wrong, where they break, how long they take.

``python -m benchmarks coding [--parts easy,breaking,…] [--skeins 1000] [--coders a,b] [--page FILE]``

Every part leaves its result as JSON in ``--results``, and every run writes the page anew from all results
that lie there; so parts can be measured one at a time, and one coder again without the others. Seeds begin at
``--first`` = 500000: these rigs and products were never used while coders were made.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.coding_page import write_page
from benchmarks.coding_parts import PARTS
from benchmarks.coding_results import Results, coders_named


def main() -> None:
    """Measure the chosen parts and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}; or none")
    parser.add_argument("--coders", default="", help="names, as the page has them; default: all")
    parser.add_argument("--skeins", type=int, default=1000, help="skeins on each rig")
    parser.add_argument("--few", type=int, default=24, help="products for each point of the smaller parts")
    parser.add_argument("--first", type=int, default=500_000, help="first seed")
    folder = Path(tempfile.gettempdir()) / "roemetry-coding"
    parser.add_argument("--results", type=Path, default=folder, help="folder of results and of traced scenes")
    parser.add_argument("--page", type=Path, default=Path("docs/measurements/coding.md"))
    given = parser.parse_args()
    coders = coders_named([name for name in given.coders.split(",") if name])
    results = Results(given.results)
    for name in [] if given.parts == "none" else given.parts.split(","):
        if name not in PARTS:
            parser.error(f"there is no part `{name}`; there are {', '.join(PARTS)}")
        print(f"{name}: {PARTS[name].__doc__}")
        PARTS[name](results, coders, given)
    write_page(results, given.page)
    print(f"written: {given.page}")


if __name__ == "__main__":
    main()
