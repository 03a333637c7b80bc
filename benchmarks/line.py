"""A whole line with an emulated camera and a receiver on loopback: how long, what is lost, what survives.

``python -m benchmarks line``: time from a frame's arrival to the receiver's, lost frames, memory.
``python -m benchmarks line --rounds 50 --folder FOLDER``: parts of it die, hang and go away, round by round
(`line_faults.py`); the same command goes on where it was broken off.

Needs ``pip install 'roemetry[line,basler]'``. The figures are of one machine; the counts hold for any.
"""

from __future__ import annotations

import argparse
import json
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.line_faults import Receiver, faults

ROOT = Path(__file__).parents[1]

LINE = """\
roemetry_line: 1
name: bench
folder: data
stations:
  - name: cam
    recipe: {recipe}
    lights: {lights}
    deadline_ms: {deadline_ms}
    feed:
      use: basler
      options:
        emulated: true
        trigger: software
        rate_hz: {rate}
        nodes:
          {{ImageFileMode: "On", TestImageSelector: "Off", ImageFilename: {images},
           Width: 640, Height: 480, PixelFormat: Mono8}}
outlets:
  - {{name: gate, use: tcp, options: {{port: {port}, content: all}}}}
page: null
"""


class Served:
    """A line that runs in a folder."""

    def __init__(self, folder: Path, recipe: Path, rate: float, receiver: Receiver, plain: bool) -> None:
        self.folder = folder
        images, lights, deadline_ms = ROOT / "recipes" / "herring_roe" / "images", ["laser"], 50
        if plain:
            images, lights, deadline_ms = _in_turn(folder / "images", images), ["laser", "plain"], 1000
        text = LINE.format(
            recipe=recipe,
            rate=rate,
            images=images,
            port=receiver.port,
            lights=lights,
            deadline_ms=deadline_ms,
        )
        (folder / "line.yaml").write_text(text, "utf-8")
        self.log = (folder / "log.jsonl").open("w")
        command = [sys.executable, "-m", "roemetry", "serve", str(folder / "line.yaml"), "--start-anyway"]
        self.process = subprocess.Popen(command, stderr=self.log)
        until_s = time.monotonic() + 120.0
        while '"ready"' not in (folder / "log.jsonl").read_text():
            if time.monotonic() > until_s or self.process.poll() is not None:
                raise SystemExit((folder / "log.jsonl").read_text())
            time.sleep(0.1)

    def ask(self, query: str, file: str = "line.sqlite") -> list[tuple]:
        """Give the rows of a query."""
        db = sqlite3.connect(self.folder / "data" / file, timeout=10.0)
        try:
            return db.execute(query).fetchall()
        finally:
            db.close()

    def pids(self) -> dict[str, int]:
        """Give the processes that have said something, by name."""
        return dict(self.ask("select component, pid from health"))

    def figures(self) -> dict:
        """Give what the station has counted."""
        return json.loads(self.ask("select figures from health where component = 'station cam'")[0][0])

    def memory_mb(self) -> dict[str, float]:
        """Give what each process holds for itself, MB."""
        found = {}
        for name, pid in {**self.pids(), "serve": self.process.pid}.items():
            status = Path(f"/proc/{pid}/status").read_text()
            found[name] = int(status.split("RssAnon:")[1].split()[0]) / 1024.0
        return found

    def stop(self) -> None:
        """Stop it, and wait until it has drained."""
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(90)
        self.log.close()


def _in_turn(folder: Path, images: Path) -> Path:
    """Give a folder in which each laser image is followed by the one in plain light."""
    folder.mkdir()
    for laser in sorted(images.glob("*.png")):
        (folder / f"{laser.stem}-1.png").symlink_to(laser)
        (folder / f"{laser.stem}-2.png").symlink_to(images.parent / "images_plain" / laser.name)
    return folder


def fastest(folder: Path, recipe: Path) -> Path:
    """Write the recipe with the fastest stages (those of ``benchmarks frame --sets fastest``)."""
    from ruamel.yaml import YAML

    found = YAML().load(recipe)
    found["stages"] |= {"extractor": "log-parabola", "coder": "ordered", "classifier": "arc-curvature"}
    found["calibration"] = str(recipe.parent / found["calibration"])
    found["source"]["path"] = str(recipe.parent / found["source"]["path"])
    YAML().dump(found, folder / "fastest.yaml")
    return folder / "fastest.yaml"


def timed(seconds: float, rate: float, recipe: Path, plain: bool, quick: bool) -> None:
    """Run a line and print its times, losses and memory."""
    with tempfile.TemporaryDirectory() as folder:
        recipe = fastest(Path(folder), recipe) if quick else recipe
        taken_in: list[
            tuple[str, float, float]
        ] = []  # key, when it arrived, when its frame had; s since 1970
        receiver = Receiver(0, lambda row: taken_in.append((row["key"], time.time(), row["taken"]["time_s"])))
        served = Served(Path(folder), recipe, rate, receiver, plain)
        time.sleep(min(10.0, seconds / 4.0))
        first, begin = served.memory_mb(), len(taken_in)
        time.sleep(seconds)
        last, rows = served.memory_mb(), taken_in[begin:]
        served.stop()
        figures = served.figures()
        receiver.stop()
    products = [row for row in rows if "!" not in row[0]]
    ms = 1e3 * np.array([arrived - taken for _, arrived, taken in products])
    p50, p99 = np.percentile(ms, [50, 99])
    print(f"{recipe.name}, {rate:g} frames/s for {seconds:g} s: {len(products)} products at the receiver")
    print(
        f"frame to receiver: mean {ms.mean():.1f} ms, p50 {p50:.1f} ms, p99 {p99:.1f} ms "
        f"({p99 / ms.mean() - 1.0:+.0%} of the mean), worst {ms.max():.1f} ms"
    )
    print(
        f"frames {figures['frames']}, lost {figures['lost']}, late {figures['late']}, products told "
        f"{len({key for key, *_ in taken_in if '!' not in key})} of {figures['products']}; "
        f"taking waited {figures['waited_s']:.2f} s"
    )
    for name in first:
        print(f"memory of {name}: {first[name]:.0f} MB, then {last.get(name, float('nan')):.0f} MB")


def main() -> None:
    """Measure a line, or kill it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second")
    parser.add_argument(
        "--plain",
        action="store_true",
        help="every second frame in plain light, as with_outline.yaml wants it",
    )
    parser.add_argument("--recipe", type=Path, default=ROOT / "recipes" / "herring_roe" / "recipe.yaml")
    parser.add_argument("--fastest", action="store_true", help="the recipe with its fastest stages")
    parser.add_argument(
        "--rounds", type=int, default=0, help="rounds of faults instead, at 10 frames a second"
    )
    parser.add_argument("--folder", type=Path, default=Path("build/line-faults"), help="what the rounds keep")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--outage", type=float, default=60.0, help="how long broker, database and subscribers are gone, s"
    )
    given = parser.parse_args()
    if given.rounds:
        signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped; the same command goes on"))
        rate = min(given.rate, 10.0)
        recipe = given.recipe.resolve()
        found = faults(given.rounds, rate, recipe, given.seed, given.folder, given.outage)
        sys.exit(1 if found else 0)
    timed(given.seconds, given.rate, given.recipe.resolve(), given.plain, given.fastest)


if __name__ == "__main__":
    main()
