"""A record of a million rows: how long its table, report and questions take, and how much memory.

``python -m benchmarks million --rows 1000000 --out FOLDER [--recipe recipes/herring_roe]``

The rows are made: those of a run of a shipped recipe, over and over, each with an id of its
own, scattered numbers, and one in two hundred failed for one of a few reasons. Their images are not there, so
the report's time is that of the record; its examples say why they have no pictures. Every step is a process
of its own, which says what it took: s by the clock, s of processor time, MB at most.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.command import parser_of
from roemetry.cli.main import main as roemetry

_RECIPE = Path("recipes/herring_roe/with_outline.yaml")
_FAULTS = ("unreadable", "belt-not-seen", "image-torn", "process-died")


def main() -> None:
    """Make the record where it is not there yet, and time what is made of it."""
    parser = parser_of(__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--recipe", type=Path, default=_RECIPE, help="whose rows are repeated")
    parser.add_argument("--step", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.step:
        _told(asked.step)
        return
    if not (asked.out / "measurements.jsonl").exists():
        _make(asked.recipe, asked.out, asked.rows)
    record = asked.out / "measurements.jsonl"
    print(f"{asked.rows} rows, record of {record.stat().st_size / 1e9:.2f} GB")
    folder, some = str(asked.out), f"p{asked.rows * 2 // 3:07d}"
    for step in (
        ["report", folder],
        ["export", folder, "parquet"],
        ["query", folder, "--product", some],
        ["query", folder, "select grade, count(*), avg(weight_g) from products group by grade"],
        ["report", folder, "--product", some],
    ):
        command = [sys.executable, "-m", "benchmarks", "million", "--out", folder, "--step", *step]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{' '.join(step)}: exit code {done.returncode}\n{done.stderr}")
        print(f"{' '.join(step)}: {done.stderr.strip().splitlines()[-1]}", flush=True)
    print(f"report.html {(asked.out / 'report.html').stat().st_size / 1e6:.1f} MB")


def _told(step: list[str]) -> None:
    begin = time.perf_counter()
    sys.argv[1:] = step
    try:
        roemetry()
    finally:
        used = resource.getrusage(resource.RUSAGE_SELF)
        sys.stderr.write(
            f"{time.perf_counter() - begin:.2f} s, {used.ru_utime + used.ru_stime:.2f} s of processor time, "
            f"{used.ru_maxrss / 1024:.0f} MB\n"
        )


def _make(recipe: Path, out: Path, count: int) -> None:
    subprocess.run([sys.executable, "-m", "roemetry", "run", str(recipe), "--out", str(out)], check=True)
    record = out / "measurements.jsonl"
    rows = [json.loads(line) for line in record.read_text("utf-8").splitlines()]
    rng = random.Random(1)
    with record.open("w", encoding="utf-8") as file:
        for number in range(count):
            name, row = f"p{number:07d}", rows[number % len(rows)]
            made = row | {"id": f"{name}#1", "acquisition": name, "status": "measured", "absent": {}}
            for result, key in (("weight", "mass_g"), ("volume", "visible_mm3")):
                factor, estimate = rng.gauss(1.0, 0.002), row[result][key]
                value, bounds = factor * estimate["value"], [factor * bound for bound in estimate["interval"]]
                made[result] = row[result] | {key: estimate | {"value": value, "interval": bounds}}
            if rng.random() < 0.005:
                why = {"code": rng.choice(_FAULTS), "text": "made to fail"}
                made |= dict.fromkeys(("volume", "weight", "grade", "decision"))
                made |= {"status": "failed", "absent": {"source": why}, "reasons": [why]}
            file.write(json.dumps(made, ensure_ascii=False) + "\n")
