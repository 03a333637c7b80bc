"""A cluster under blows, and a cluster of many workers.

``python -m benchmarks cluster kills [--rows 5000] [--kills 5]``
    Runs the shipped recipe over so many rows of a manifest on a scheduler and two workers; the scheduler and
    the client are killed (SIGKILL) so many times each, at moments drawn at random, and what was killed is
    started again with --resume. At the end the record must be, byte for byte, that of a run nobody disturbed.
``python -m benchmarks cluster scaling [--workers 1 4 16 64] [--task 0.1]``
    Tasks that sleep, on so many workers in threads of this process: throughput over that of as many workers
    that lose nothing.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from roemetry.run.cluster import Cluster

_RECIPE = Path("recipes/herring_roe")
_PORT = 28786
_LONGEST_S = 12.0
"""Kills strike up to so long after a client began: some rows are written by then, and not all."""


def main() -> None:
    """Do one of the two."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("kills", "scaling"))
    parser.add_argument("--rows", type=int, default=5000)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 4, 16, 64])
    parser.add_argument("--task", type=float, default=0.1, help="how long a task sleeps, s")
    asked = parser.parse_args()
    if asked.what == "scaling":
        for workers in asked.workers:
            print(f"{workers:3} workers: {_efficiency(workers, asked.task):.3f} of linear", flush=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        same = _killed(Path(folder), asked.rows, asked.kills)
    found = "the same" if same else "ANOTHER"
    print(f"{asked.kills} kills of the scheduler, {asked.kills} of the client: {found} record")
    sys.exit(not same)


class Sleeps:
    """Sleeps and gives back what it was given."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __call__(self, number: int) -> int:
        """Sleep."""
        time.sleep(self.seconds)
        return number


def _efficiency(workers: int, task_s: float) -> float:
    """Give the throughput, once every worker is at work, over one task in `task_s` for each worker."""
    from distributed import LocalCluster

    count = int(workers * 60.0 / task_s)  # a minute of work for each
    with LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=":0"
    ) as made:
        moments = []
        for number, found in enumerate(
            Cluster(made.scheduler_address).in_order(Sleeps, (task_s,), range(count))
        ):
            if number != found:
                raise AssertionError(f"{found} came in place of {number}")
            moments.append(time.perf_counter())
    first, last = count // 4, count - count // 10  # without the start, and the end when some are idle
    return (last - first) / (moments[last] - moments[first]) * task_s / workers


def _killed(folder: Path, rows: int, kills: int) -> bool:
    manifest = folder / "manifest.jsonl"
    subprocess.run([*_ROEMETRY, "manifest", str(_RECIPE), str(manifest)], check=True)
    listed = [json.loads(line) for line in manifest.read_text("utf-8").splitlines()]
    many = (listed[number % len(listed)] | {"id": f"p{number:05d}"} for number in range(rows))
    manifest.write_text("".join(json.dumps(row) + "\n" for row in many), "utf-8")
    _client(folder, manifest, "whole").wait()
    rng, victims = random.Random(1), ["scheduler", "client"] * kills
    scheduler, workers = _cluster()
    try:
        for number, victim in enumerate(victims, start=1):
            client = _client(folder, manifest, "killed", "--cluster", f"tcp://127.0.0.1:{_PORT}")
            before = _lines(folder)
            while client.poll() is None and _lines(folder) == before:
                time.sleep(0.1)  # until it writes
            time.sleep(rng.uniform(0.0, _LONGEST_S / kills))
            (scheduler if victim == "scheduler" else client).send_signal(signal.SIGKILL)
            client.wait()
            print(f"kill {number}, {victim}: {_lines(folder)} rows", flush=True)
            if victim == "scheduler":
                workers.kill()
                scheduler, workers = _cluster()
        code = _client(folder, manifest, "killed", "--cluster", f"tcp://127.0.0.1:{_PORT}").wait()
        print(f"last client: exit code {code}, {_lines(folder)} rows")
    finally:
        scheduler.kill()
        workers.kill()
    whole, killed = (folder / name / "measurements.jsonl" for name in ("whole", "killed"))
    return whole.read_bytes() == killed.read_bytes()


_ROEMETRY = (sys.executable, "-m", "roemetry")


def _client(folder: Path, manifest: Path, out: str, *more: str) -> subprocess.Popen[bytes]:
    command = [*_ROEMETRY, "run", str(_RECIPE), "--set", "sinks=[csv]", "--set", "draws=0"]
    command += [
        "--set",
        f"source={{use: manifest, path: {manifest}}}",
        "--out",
        str(folder / out),
        "--resume",
    ]
    return subprocess.Popen([*command, *more], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _cluster() -> tuple[subprocess.Popen[bytes], subprocess.Popen[bytes]]:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "dask", "scheduler", "--port", str(_PORT), "--no-dashboard"], **quiet
    )
    time.sleep(3.0)
    address = f"tcp://127.0.0.1:{_PORT}"
    command = [sys.executable, "-m", "dask", "worker", address, "--nworkers", "2", "--nthreads", "1"]
    return scheduler, subprocess.Popen([*command, "--no-dashboard"], **quiet)


def _lines(folder: Path) -> int:
    record = folder / "killed" / "measurements.jsonl"
    return record.read_bytes().count(b"\n") if record.exists() else 0


if __name__ == "__main__":
    main()
