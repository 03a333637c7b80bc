"""Two runs contend for one folder while processes are killed: no row may be lost, none stand twice.

``python -m benchmarks kills [--kills 100] [--seed 1]``

Two processes run one recipe into one folder, going on where the other was killed, over and over; at a random
moment one of them is killed (SIGKILL). After each kill the record must hold whole lines and no row twice, and
every row that it held before. At the end a last run completes it, and its rows must be those of a run that
no one disturbed. Processes are forked from one whose kernels are loaded, so that a kill strikes the writing
and not the start.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.command import parser_of
from roemetry import Recipe, RoemetryError, run_recipe
from roemetry.run.record import RECORD, read_record

_RECIPE = Path("recipes/herring_roe/recipe.yaml")
_LONGEST_S = 0.5
"""Kills strike up to so long after a process began: some rows are written by then."""


def main() -> None:
    """Kill, and say what was lost."""
    parser = parser_of(__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        recipe = Recipe.load(_RECIPE, sets=["sinks=[csv]", "draws=0", "uncertainty=linear"])
        faults, finished = killed(recipe, Path(folder), asked.kills, asked.seed)
    for fault in faults:
        print(fault)
    print(f"{asked.kills} kills, {finished} runs came to their end between them, {len(faults)} faults")
    sys.exit(bool(faults))


def killed(recipe: Recipe, folder: Path, kills: int, seed: int) -> tuple[list[str], int]:
    """Kill one of two contending runs so many times; what was lost or doubled, and how many runs ended."""
    whole = folder / "whole"
    run_recipe(recipe, whole)  # compiles, too
    expected = {row.id: row for row in read_record(whole)}
    rng, faults, finished = np.random.default_rng(seed), [], 0
    target, runs, before = folder / "run_0", 0, set[str]()
    processes: list[int] = []
    for number in range(kills):
        while len(processes) < 2:
            processes.append(_begun(recipe, target))
        time.sleep(float(rng.uniform(0.0, _LONGEST_S)))
        victim = processes.pop(int(rng.integers(2)))
        os.kill(victim, signal.SIGKILL)
        os.waitpid(victim, 0)
        there, said = _held(target)
        faults += [f"kill {number + 1}: {text}" for text in said]
        if lost := before - there:
            faults.append(f"kill {number + 1}: lost {', '.join(sorted(lost))}")
        before = there
        processes = [one for one in processes if os.waitpid(one, os.WNOHANG)[0] != one]
        if there == set(expected):  # begin anew, once the other has let go
            for one in processes:
                os.waitpid(one, 0)
            finished, runs, processes, before = finished + 1, runs + 1, [], set()
            target = folder / f"run_{runs}"
    for one in processes:
        os.waitpid(one, 0)
    run_recipe(recipe, target, resume=True)
    found = {row.id: row for row in read_record(target)}
    if {name: row.to_json() for name, row in found.items()} != {
        name: row.to_json() for name, row in expected.items()
    }:
        faults.append("the last run's rows are not those of a run that no one disturbed")
    return faults, finished


def _begun(recipe: Recipe, target: Path) -> int:
    """Fork a process that runs the recipe into the folder until it is done, however often it is refused."""
    process = os.fork()
    if process:
        return process
    while True:
        try:
            run_recipe(recipe, target, resume=True)
            os._exit(0)
        except RoemetryError:  # the other one has the folder
            time.sleep(0.01)
        except BaseException:
            os._exit(1)


def _held(target: Path) -> tuple[set[str], list[str]]:
    """Give the rows that a folder holds, and what is wrong with them; a half last line is not."""
    if not (target / RECORD).exists():
        return set(), []
    names: list[str] = []
    try:
        for row in read_record(target):
            names.append(row.id)
    except RoemetryError as error:
        if "the last line is cut off" not in str(error):
            return set(names), [str(error)]
    return set(names), []
