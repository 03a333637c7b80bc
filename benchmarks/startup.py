"""Time of ``roemetry --help`` over that of a two-command Typer program, in turn in one run.

``python -m benchmarks startup [--repeats 15]``
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from pathlib import Path

from benchmarks.command import parser_of
from benchmarks.extraction.timing import in_turn, script

TRIVIAL = '''
import typer
app = typer.Typer()

@app.command()
def one(name: str = "x") -> None:
    """The first command."""

@app.command()
def two(name: str = "x") -> None:
    """The second command."""

app()
'''


def main() -> None:
    """Print both medians and the median of the pairwise ratios."""
    parser = parser_of(__doc__)
    parser.add_argument("--repeats", type=int, default=15)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        commands = {
            "trivial": [*script(Path(folder) / "trivial.py", TRIVIAL), "--help"],
            "roemetry": [sys.executable, "-m", "roemetry", "--help"],
        }
        times = in_turn(commands, given.repeats)
    for name, seconds in times.items():
        print(f"{name:9} --help {1e3 * statistics.median(seconds):6.0f} ms (median of {given.repeats})")
    ratios = [a / b for a, b in zip(times["roemetry"], times["trivial"], strict=True)]
    print(f"ratio            {statistics.median(ratios):6.2f}")
