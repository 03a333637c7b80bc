"""Time of ``roemetry --help`` over that of a two-command Typer program, in turn in one run.

``python -m benchmarks startup [--repeats 15]``
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=15)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        trivial = Path(folder) / "trivial.py"
        trivial.write_text(TRIVIAL, encoding="utf-8")
        commands = {
            "trivial": [sys.executable, str(trivial), "--help"],
            "roemetry": [sys.executable, "-m", "roemetry", "--help"],
        }
        times: dict[str, list[float]] = {name: [] for name in commands}
        for repeat in range(given.repeats + 1):
            for name, command in commands.items():
                begin = time.perf_counter()
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
                if repeat:
                    times[name].append(time.perf_counter() - begin)
    for name, seconds in times.items():
        print(f"{name:9} --help {1e3 * statistics.median(seconds):6.0f} ms (median of {given.repeats})")
    ratios = [a / b for a, b in zip(times["roemetry"], times["trivial"], strict=True)]
    print(f"ratio            {statistics.median(ratios):6.2f}")


if __name__ == "__main__":
    main()
