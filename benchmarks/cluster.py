"""A cluster under blows, and what it costs.

``python -m benchmarks cluster kills [--verb run] [--rows 5000] [--kills 5] [--workers-killed 30]``
    Runs the shipped recipe over so many rows of a manifest, or compares two variants of it on as many items
    of a data set, on a scheduler and two workers. Scheduler and client are killed (SIGKILL) so many times
    each, and workers, at moments drawn at random, and what was killed is started again with --resume. At the
    end the record (of `compare`, its items) must be, byte for byte, that of a run nobody disturbed.
``python -m benchmarks cluster throughput [--rows 5000] [--recipe recipes/herring_roe]``
    Measures so many rows with a pool of one and of two processes, then on a scheduler with one and with two
    workers: products a second once all are at work, and the processor time of scheduler and client. What two
    processes gain over one is all that this machine's second core has to give.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.command import parser_of
from roemetry import Recipe, run_recipe
from roemetry.run.cluster import QUIET, Cluster
from roemetry.run.executors import Processes

_RECIPE = Path("recipes/herring_roe")
_PORT = 28786
_LONGEST_S = 12.0
"""Kills strike within so long, all together, after rows were written: not all are by then."""


def main() -> None:
    """Do what is asked for."""
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("kills", "throughput"))
    parser.add_argument("--rows", type=int, default=5000)
    parser.add_argument("--recipe", type=Path, default=_RECIPE, help="what `throughput` measures with")
    parser.add_argument("--verb", choices=("run", "compare"), default="run")
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--workers-killed", type=int, default=30)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if asked.what == "throughput":
            _throughput(asked.recipe.absolute(), Path(folder), asked.rows)
            return
        work = (_runs if asked.verb == "run" else _compares)(Path(folder), asked.rows)
        done, same = _killed(work, asked.kills, asked.workers_killed)
    told = ", ".join(f"{number} kills of the {victim}" for victim, number in sorted(done.items()))
    print(f"{told}: {'the same' if same else 'ANOTHER'} {work.grows.name}")
    sys.exit(not same)


@dataclass(frozen=True)
class _Work:
    """A command that is killed, and the file that it lets grow, within its `--out`."""

    command: tuple[str, ...]
    folder: Path
    grows: Path

    def begin(self, out: str, *more: str) -> subprocess.Popen[bytes]:
        """Start it, or go on with it where the folder holds something."""
        into = self.folder / out
        resume = ("--resume",) if (into / self.grows).exists() else ()
        command = [*_ROEMETRY, *self.command, "--out", str(into), *resume, *more]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def lines(self, out: str) -> int:
        """Count what it has written."""
        path = self.folder / out / self.grows
        return path.read_bytes().count(b"\n") if path.exists() else 0


def _runs(folder: Path, rows: int) -> _Work:
    sets = ["sinks=[csv]", "draws=0", f"source={_many(_RECIPE, folder, rows)}"]
    words = [word for text in sets for word in ("--set", text)]
    return _Work(("run", str(_RECIPE), *words), folder, Path("measurements.jsonl"))


def _many(recipe: Path, folder: Path, rows: int) -> str:
    """Make a manifest of so many rows of a recipe's images; give the source that reads it."""
    manifest = folder / "manifest.jsonl"
    subprocess.run([*_ROEMETRY, "manifest", str(recipe), str(manifest)], check=True)
    _repeat(manifest, rows)
    return f"{{use: manifest, path: {manifest}}}"


def _compares(folder: Path, rows: int) -> _Work:
    data = folder / "data"
    shutil.copytree(_RECIPE, data)
    _repeat(data / "items.jsonl", rows)
    varied = ("--vary", "stages.extractor.options.threshold=10,20")
    return _Work(("compare", str(_RECIPE), "--data", str(data), *varied), folder, Path("items.jsonl"))


def _repeat(listed: Path, rows: int) -> None:
    """Make a list of files or items longer, those of each product under an id of its own."""
    products: dict[str, list[dict[str, Any]]] = {}
    for line in map(json.loads, listed.read_text("utf-8").splitlines()):
        products.setdefault(line["id"], []).append(line)
    each = [*products.values()]
    many = (line | {"id": f"p{k:05d}"} for k in range(rows) for line in each[k % len(each)])
    listed.write_text("".join(json.dumps(line) + "\n" for line in many), "utf-8")


def _throughput(path: Path, folder: Path, rows: int) -> None:
    """Print products a second by the process pool and by clusters, and what those cost beside the work."""
    recipe = Recipe.load(path, sets=["sinks=[csv]", f"source={_many(path, folder, rows)}"])
    address = f"tcp://127.0.0.1:{_PORT}"
    run_recipe(Recipe.load(path, sets=["sinks=[]"]), folder / "warm")
    print("| by | products a second | client, ms a product | scheduler, ms a product |\n|---|---|---|---|")
    for count, workers in ((1, 0), (2, 0), (1, 1), (2, 2)):
        name = f"cluster of {workers}" if workers else f"pool of {count}"
        made = _cluster(workers) if workers else ()
        executor = Cluster(address) if workers else Processes(count)
        moments: list[tuple[float, float, float]] = []
        look = partial(_look, moments, psutil.Process(made[0].pid) if made else None)
        try:
            run_recipe(recipe, folder / f"by-{name}", executor=executor, on_progress=look)
        finally:
            for process in made:
                process.kill()
        # rows come chunk by chunk: a line through the last two thirds, when all have long been at work
        later = np.array(moments[len(moments) // 3 :])
        wall, client, scheduler = np.polyfit(np.arange(len(later)), later - later[0], 1)[0]
        print(f"| {name} | {1.0 / wall:.1f} | {1e3 * client:.2f} | {1e3 * scheduler:.2f} |", flush=True)


def _look(
    moments: list[tuple[float, float, float]], scheduler: psutil.Process | None, done: int, of: int
) -> None:
    """Note the time, and the processor times of this process and of the scheduler's, s."""
    its = 0.0 if scheduler is None else sum(scheduler.cpu_times()[:2])
    moments.append((time.perf_counter(), time.process_time(), its))


def _killed(work: _Work, kills: int, workers_killed: int) -> tuple[Counter[str], bool]:
    """Kill until it is finished; what was killed how often, and whether the file is that of a whole run."""
    if code := work.begin("whole").wait():
        raise SystemExit(f"the undisturbed command ended with exit code {code}")
    rng, done = random.Random(1), Counter[str]()
    victims = ["scheduler", "client"] * kills + ["worker"] * workers_killed
    rng.shuffle(victims)
    longest_s = _LONGEST_S / max(1, len(victims) // 2)
    scheduler, workers = _cluster()
    on_cluster = ("--cluster", f"tcp://127.0.0.1:{_PORT}")
    client = work.begin("killed", *on_cluster)
    try:
        for number, victim in enumerate(victims, start=1):
            before = work.lines("killed")
            while client.poll() is None and work.lines("killed") == before:
                time.sleep(0.1)  # until it writes
            time.sleep(rng.uniform(0.0, longest_s))
            if client.poll() is not None:
                print(f"finished after {number - 1} kills: more --rows are needed")
                break
            if victim == "worker":
                os.kill(rng.choice(_processes_of(workers)), signal.SIGKILL)
            else:
                (scheduler if victim == "scheduler" else client).send_signal(signal.SIGKILL)
                client.wait()
            done[victim] += 1
            print(f"kill {number}, {victim}: {work.lines('killed')} lines", flush=True)
            if victim == "scheduler":
                workers.kill()
                scheduler, workers = _cluster()
            if victim != "worker":
                client = work.begin("killed", *on_cluster)
        code = client.wait()
        print(f"last client: exit code {code}, {work.lines('killed')} lines")
    finally:
        scheduler.kill()
        workers.kill()
        client.kill()
    whole, killed = (work.folder / name / work.grows for name in ("whole", "killed"))
    return done, whole.read_bytes() == killed.read_bytes()


_ROEMETRY = (sys.executable, "-m", "roemetry")


def _cluster(workers: int = 2) -> tuple[subprocess.Popen[bytes], subprocess.Popen[bytes]]:
    # dask reads these variables as its settings
    settings = {f"DASK_{key.replace('.', '__').replace('-', '_').upper()}": str(QUIET[key]) for key in QUIET}
    quiet: Any = {
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "env": os.environ | settings,
    }
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "dask", "scheduler", "--port", str(_PORT), "--no-dashboard"], **quiet
    )
    time.sleep(3.0)
    address = f"tcp://127.0.0.1:{_PORT}"
    command = [sys.executable, "-m", "dask", "worker", address, "--nworkers", str(workers)]
    command += ["--nthreads", "1"]
    return scheduler, subprocess.Popen([*command, "--no-dashboard"], **quiet)


def _processes_of(workers: subprocess.Popen[bytes]) -> list[int]:
    """Give the workers that are alive; their nanny starts a dead one again."""
    while True:
        children = psutil.Process(workers.pid).children()
        if found := [child.pid for child in children if "spawn_main" in " ".join(child.cmdline())]:
            return found
        time.sleep(0.1)
