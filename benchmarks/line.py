"""A whole line with an emulated camera and a receiver on loopback: how long, what is lost, what survives.

``python -m benchmarks line``: time from a frame's arrival to the receiver's, lost frames, memory.
``python -m benchmarks line --rounds 50 --folder FOLDER``: parts of it die, hang and go away, round by round
(`line_faults.py`); the same command goes on where it was broken off.

Needs ``pip install 'roemetry[line,basler]'``. The figures are of one machine; the counts hold for any.
"""

from __future__ import annotations

import json
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from benchmarks.command import parser_of
from benchmarks.line_faults import CAMERA, IMAGES, ROOT, Receiver, asked, faults, serve

LINE = f"""\
roemetry_line: 1
name: bench
folder: data
stations:
  - name: cam
    recipe: {{recipe}}
    lights: {{lights}}
    deadline_ms: {{deadline_ms}}
{CAMERA}outlets:
  - {{{{name: gate, use: tcp, options: {{{{port: {{port}}, content: all}}}}}}}}
page: null
"""


class Served:
    """A line that runs in a folder."""

    def __init__(self, folder: Path, recipe: Path, rate: float, receiver: Receiver, plain: bool) -> None:
        self.database = folder / "data" / "line.sqlite"
        told = {"images": IMAGES, "lights": ["laser"], "deadline_ms": 50}
        if plain:
            told = {
                "images": _in_turn(folder / "images"), "lights": ["laser", "plain"], "deadline_ms": 1000
            }  # fmt: skip
        text = LINE.format(recipe=recipe, rate=rate, port=receiver.port, **told)
        (folder / "line.yaml").write_text(text, "utf-8")
        log, until_s = folder / "log.jsonl", time.monotonic() + 120.0
        self.serve = serve(folder, log)
        while '"ready"' not in log.read_text():
            if time.monotonic() > until_s or self.serve.process.poll() is not None:
                raise SystemExit(log.read_text())
            time.sleep(0.1)

    def figures(self) -> dict:
        """Give what the station has counted."""
        query = "select figures from health where component = 'station cam'"
        return json.loads(asked(self.database, query)[0][0])

    def memory_mb(self) -> dict[str, float]:
        """Give what each process that has said something holds for itself, MB."""
        pids = dict(asked(self.database, "select component, pid from health"))
        found = {}
        for name, pid in {**pids, "serve": self.serve.process.pid}.items():
            status = Path(f"/proc/{pid}/status").read_text()
            found[name] = int(status.split("RssAnon:")[1].split()[0]) / 1024.0
        return found


def _in_turn(folder: Path) -> Path:
    """Give a folder in which each laser image is followed by the one in plain light."""
    folder.mkdir()
    for laser in sorted(IMAGES.glob("*.png")):
        (folder / f"{laser.stem}-1.png").symlink_to(laser)
        (folder / f"{laser.stem}-2.png").symlink_to(IMAGES.parent / "images_plain" / laser.name)
    return folder


def _fastest(folder: Path, recipe: Path) -> Path:
    """Write the recipe with the fastest stages (those of ``benchmarks frame --sets fastest``)."""
    found = YAML().load(recipe)
    found["stages"] |= {"extractor": "log-parabola", "coder": "ordered", "classifier": "arc-curvature"}
    found["calibration"] = str(recipe.parent / found["calibration"])
    found["source"]["path"] = str(recipe.parent / found["source"]["path"])
    YAML().dump(found, folder / "fastest.yaml")
    return folder / "fastest.yaml"


def timed(seconds: float, rate: float, recipe: Path, plain: bool, quick: bool) -> None:
    """Run a line and print its times, losses and memory."""
    taken_in: list[tuple[str, float, float]] = []  # key, when it arrived, when its frame had; s since 1970
    with tempfile.TemporaryDirectory() as folder:
        recipe = _fastest(Path(folder), recipe) if quick else recipe
        receiver = Receiver(0, lambda row: taken_in.append((row["key"], time.time(), row["taken"]["time_s"])))
        served = Served(Path(folder), recipe, rate, receiver, plain)
        time.sleep(min(10.0, seconds / 4.0))
        first, begin = served.memory_mb(), len(taken_in)
        time.sleep(seconds)
        last, rows = served.memory_mb(), taken_in[begin:]
        served.serve.end()
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
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second")
    words = "every second frame in plain light, as with_outline.yaml wants it"
    parser.add_argument("--plain", action="store_true", help=words)
    parser.add_argument("--recipe", type=Path, default=ROOT / "recipes" / "herring_roe" / "recipe.yaml")
    parser.add_argument("--fastest", action="store_true", help="the recipe with its fastest stages")
    parser.add_argument("--rounds", type=int, default=0, help="of faults instead, at 10 frames a second")
    parser.add_argument("--folder", type=Path, default=Path("build/line-faults"), help="what the rounds keep")
    parser.add_argument("--seed", type=int, default=1)
    words = "how long broker, database and subscribers are gone, s"
    parser.add_argument("--outage", type=float, default=60.0, help=words)
    given = parser.parse_args()
    recipe = given.recipe.resolve()
    if given.rounds:
        signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped; the same command goes on"))
        rate = min(given.rate, 10.0)
        sys.exit(1 if faults(given.rounds, rate, recipe, given.seed, given.folder, given.outage) else 0)
    timed(given.seconds, given.rate, recipe, given.plain, given.fastest)
