"""A whole line with its processes: what goes in comes out once, whatever dies."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from roemetry.errors import ConfigurationError
from tests.command import typed
from tests.plugins.line.loopback import Receiver, wait_for

INCOMING = "options: {path: FOLDER/in, settle_ms: 0, poll_ms: 5}"


def outlets(port: int) -> str:
    return f"outlets:\n  - {{name: plc, use: tcp, options: {{port: {port}}}}}\npage: null\n"


class Served:
    """A line that runs beside a recipe, and pictures to put before its camera."""

    def __init__(self, line_file: Path) -> None:
        self.folder = line_file.parent
        self.incoming = self.folder / "in"
        self.incoming.mkdir()
        self.images = sorted((self.folder / "images").iterdir())
        self._count = 0
        self.log = self.folder / "log.jsonl"

    def start(self) -> None:
        """Start it, and wait until every station measures."""
        with self.log.open("a") as log:
            before = self.log.read_text().count('"ready"')
            self.process = subprocess.Popen(
                [sys.executable, "-m", "roemetry", "serve", str(self.folder / "line.yaml"), "--start-anyway"],
                stderr=log,
            )
        wait_for(lambda: self.log.read_text().count('"ready"') > before, "the line is not ready", 60.0)

    def put(self, many: int) -> None:
        """Put so many pictures before the camera, whole at once."""
        for _ in range(many):
            self._count += 1
            image = self.images[self._count % len(self.images)]
            part = self.incoming / f".{self._count}.part"
            shutil.copy(image, part)
            part.rename(self.incoming / f"{self._count:05d}.png")

    def state(self, component: str) -> tuple[int, str]:
        """Give a process's id and what it said of itself last."""
        with sqlite3.connect(self.folder / "data" / "line.sqlite") as db:
            found = db.execute("select pid, state from health where component = ?", (component,)).fetchone()
        db.close()
        return found

    def kill(self, component: str) -> None:
        """Kill one of its processes, as the system would for want of memory, and wait for the next one."""
        killed, _ = self.state(component)
        os.kill(killed, signal.SIGKILL)
        wait_for(
            lambda: self.state(component)[0] != killed and self.state(component)[1] == "running",
            f"{component} does not come back",
            60.0,
        )
        time.sleep(0.5)  # folder-watch begins with what comes after its start

    def stop(self) -> int:
        """Stop it as the system would."""
        self.process.terminate()
        return self.process.wait(60)

    def runs(self) -> list[Path]:
        return sorted((self.folder / "data" / "runs" / "one").iterdir())

    def recorded(self) -> list[str]:
        return [
            f"line-1/{run.name}/{json.loads(line)['id']}"
            for run in self.runs()
            for line in (run / "measurements.jsonl").read_text("utf-8").splitlines()
        ]


def products(receiver: Receiver) -> list[str]:
    """The products' keys, each where it came first."""
    return [key for key in dict.fromkeys(receiver.keys) if "!" not in key]


@pytest.fixture
def served(line_file, receiver):
    deadline = ("recipe: recipe.yaml", "recipe: recipe.yaml\n    deadline_ms: 1")
    made = Served(line_file(deadline, ("options: {path: FOLDER/in}", INCOMING), end=outlets(receiver.port)))
    try:
        made.start()
        yield made
    finally:
        if made.process.poll() is None:
            made.process.kill()
            made.process.wait()


def recovered(served, receiver) -> None:
    """Kill the whole line, as if before its second product came into the outbox: it is measured again."""
    served.put(2)
    wait_for(lambda: len(products(receiver)) >= 2, "two products are not told")
    served.process.kill()  # its children end with it
    served.process.wait()
    (run,) = served.runs()
    wait_for(lambda: not locked(served.folder), "the children live on")
    lines = (run / "measurements.jsonl").read_text("utf-8").splitlines(keepends=True)
    (run / "measurements.jsonl").write_text(lines[0] + lines[1][:40], "utf-8")
    provenance = json.loads((run / "provenance.json").read_text("utf-8")) | {"finished": None}
    (run / "provenance.json").write_text(json.dumps(provenance), "utf-8")
    with sqlite3.connect(served.folder / "data" / "line.sqlite") as db:
        db.execute("delete from rows where key like '%000002#1'")
        db.execute("update marks set n = (select max(n) from rows)")
    db.close()
    second = products(receiver)[1]
    served.start()
    wait_for(lambda: receiver.keys.count(second) == 2, "the product is not told after the restart")
    assert products(receiver)[1] == second
    assert (run / "measurements.jsonl").read_text("utf-8").splitlines(keepends=True) == lines


def test_a_line_measures_reloads_survives_kills_and_drains(served, receiver) -> None:
    recovered(served, receiver)
    served.put(4)
    wait_for(lambda: len(products(receiver)) >= 6, "four products are not told")

    served.kill("station one")
    assert '"process-died"' in served.log.read_text()
    served.put(3)
    wait_for(lambda: len(products(receiver)) >= 9, "three products after the station's death are not told")

    recipe = served.folder / "recipe.yaml"
    whole = recipe.read_text("utf-8")
    recipe.write_text(whole.replace("threshold: 60", "threshold: sixty"), "utf-8")
    wait_for(lambda: '"recipe"' in served.log.read_text(), "a faulty recipe is not told")
    served.kill("outlets")  # what tells does not need the recipe
    served.put(3)
    wait_for(lambda: len(products(receiver)) >= 12, "three products after the outlets' death are not told")
    recipe.write_text(whole.replace("threshold: 60", "threshold: 70"), "utf-8")
    wait_for(lambda: "the changed recipe is whole" in served.log.read_text(), "a whole recipe is not taken")
    time.sleep(0.2)
    served.put(3)
    wait_for(lambda: len(products(receiver)) >= 15, "three products by the changed recipe are not told")

    served.incoming.rename(served.folder / "elsewhere")  # the camera is gone
    wait_for(lambda: '"camera"' in served.log.read_text(), "nobody tells that the camera is gone")
    (served.folder / "elsewhere").rename(served.incoming)
    wait_for(lambda: "there again" in served.log.read_text(), "nobody tells that the camera is back")
    served.put(2)
    wait_for(lambda: len(products(receiver)) >= 17, "two products after the camera's return are not told")

    assert served.stop() == 0
    assert len(products(receiver)) == 17
    assert any(key.endswith("!late") for key in receiver.keys), "a millisecond is too short for any product"
    assert served.recorded() == products(receiver)
    with sqlite3.connect(served.folder / "data" / "history.sqlite") as db:
        found = db.execute("select line, run, id from roemetry_rows order by rowid").fetchall()
        punctual = "select count(*) from roemetry_rows where kind = 'product' and late = 0"
        assert db.execute(punctual).fetchone() == (0,)
    db.close()
    kept = ["/".join(key) for key in found if "!" not in key[2]]
    assert kept == products(receiver)

    *_, last = served.runs()
    again = served.folder / "again"
    changes = ["source.use=dataset", "source.options={}", f"source.path={last}", "sinks=[]"]
    words = ["run", str(recipe), "--out", str(again), *(f"--set={change}" for change in changes)]
    typed(*words)
    assert (again / "measurements.jsonl").read_bytes() == (last / "measurements.jsonl").read_bytes()
    typed("report", last)
    said = typed("history", served.folder / "line.yaml", "--json")
    counts = json.loads(said.output)["counts"]
    assert sum(count for name, count in counts.items() if name != "late") == 17


def locked(folder: Path) -> bool:
    """Say whether a process of the line is still there."""
    found = subprocess.run(["pgrep", "-f", str(folder / "line.yaml")], capture_output=True, check=False)
    return found.returncode == 0


def test_a_line_that_cannot_reach_a_receiver_does_not_start(line_file) -> None:
    path = line_file(("FOLDER/in", "FOLDER/images, existing: true"), end=outlets(1))
    tried = typed("serve", path, code=1)
    assert isinstance(tried.exception, ConfigurationError)
    (fault,) = tried.exception.faults
    assert "line.yaml:9:5: 127.0.0.1:1: Connection refused (outlet plc (tcp)): does the receiver run" in fault
    assert not (path.parent / "data" / "runs").exists()


def test_a_unit_names_this_line(line_file) -> None:
    path = line_file()
    shown = typed("serve", path, "--unit")
    assert f"serve {path} --start-anyway" in shown.output
    assert "Type=notify" in shown.output
