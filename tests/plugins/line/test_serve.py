"""A whole line with its processes and its file: what goes in comes out once, whatever dies."""

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

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from roemetry.errors import ConfigurationError
from roemetry.io.files import exclusive
from roemetry.records import Frame
from roemetry_files.dataset_source import DatasetSource
from roemetry_line import runs
from roemetry_line.feeds.image import decoded
from roemetry_line.line_file import Line
from roemetry_line.outbox import NewRow, Outbox
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


PLC = "outlets:\n  - {name: plc, use: tcp, options: {port: 9100}}\n"


@pytest.fixture
def at(line_file):
    """Write a line file with an outlet, with something replaced; gives its path."""
    return lambda *replaced: line_file(*replaced, end=PLC)


def test_a_whole_one_loads_with_its_history_as_an_outlet(at) -> None:
    loaded = Line.load(at())
    assert [one.name for one in loaded.outlets] == ["plc", "history"]
    assert loaded.history_url == f"sqlite:{loaded.folder / 'history.sqlite'}"
    assert loaded.stations[0].recipes[0].name == "recipe.yaml"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("port: 9100", "port: 91000", r"line\.yaml:9:37: .*port.*65535"),
        ("port: 9100", "prot: 9100", r"line\.yaml:9:37: .*did you mean `port`"),
        ("use: tcp", "use: tpc", r"(?s)line\.yaml:9:17: .*did you mean `tcp`"),
        ("use: folder-watch", "use: folder", r"(?s)line\.yaml:7:12: .*did you mean `folder-watch`"),
        ("recipe: recipe.yaml", "recipe: recpie.yaml", r"line\.yaml:6:5: .*recpie\.yaml"),
        ("name: one", "name: One", r"line\.yaml:5:5: "),
        ("name: one", "name: one\n    deadline_ms: 0", r"line\.yaml:6:5: .*deadline_ms.*greater than 0"),
        ("name: line-1", "name: line-1\npage: {prot: 1}", r"line\.yaml:3:8: .*did you mean `port`"),
        ("  - {name: plc", "  - {name: plc, use: tcp}\n  - {name: plc", r"line\.yaml:10:6: .*another.*`plc`"),
        ("name: plc", "name: history", r"line\.yaml:9:6: .*history's own name"),
        ("folder: data", "history: {url: mysql://x}", r"line\.yaml:3:11: .*url"),
        ("roemetry_line: 1", "roemetry_line: 2", r"line\.yaml:1:1: .*roemetry_line"),
    ],
)  # fmt: skip
def test_faults_are_told_at_their_place(at, old, new, told) -> None:
    with pytest.raises(ConfigurationError, match=told):
        Line.load(at((old, new)))


def test_a_recipe_without_calibration_is_refused(at) -> None:
    path = at()
    recipe = path.parent / "recipe.yaml"
    recipe.write_text(recipe.read_text("utf-8").replace("calibration: calibration.yaml\n", ""), "utf-8")
    with pytest.raises(ConfigurationError, match=r"line\.yaml:6:5: .*no calibration"):
        Line.load(path)


def test_all_faults_are_told_at_once(at) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Line.load(at(("use: tcp", "use: nobody"), ("folder-watch", "nothing")))
    assert len(caught.value.faults) == 2


def test_the_doctor_tries_what_a_line_names(at) -> None:
    images = ("FOLDER/in", "FOLDER/images, existing: true, settle_ms: 0")
    path = at(("port: 9100", "port: 1"), images, ("folder: data", "folder: data\npage: {port: 0}"))
    ran = typed("doctor", path, code=2)
    said = ran.output.splitlines()
    assert said[0] == "ok       line file: line-1: recipes and calibrations load, every stage is installed"
    assert "ok       station one, feed folder-watch: a frame of 320 × 240 pixels" in said
    assert any(
        line.startswith("WRONG    outlet plc (tcp): ") and "line.yaml:10:5: 127.0.0.1:1: Conn" in line
        for line in said
    )
    assert "           → does the receiver run and listen there?" in said
    assert "ok       outlet history (database): reached" in said
    assert "ok       page: 127.0.0.1:0 is free" in said


def test_the_doctor_says_how_a_line_is_that_runs(at) -> None:
    path = at()
    loaded = Line.load(path)
    outbox = Outbox(loaded.folder)
    outbox.beat("station one", "running", {})
    outbox.raise_alarm("one", "camera", "no frames from the camera: unplugged")
    with exclusive(loaded.folder):
        ran = typed("doctor", path, code=2)
    assert "ok       station one: running" in ran.output
    assert "WRONG    one: no frames from the camera: unplugged" in ran.output


def test_the_doctor_does_not_guess_what_a_file_is(tmp_path) -> None:
    (tmp_path / "other.yaml").write_text("roemetry: 1\n")
    ran = typed("doctor", tmp_path / "other.yaml", code=1)
    assert isinstance(ran.exception, ConfigurationError)
    assert "the key `roemetry_line`" in str(ran.exception)


SHAPES = st.tuples(st.integers(1, 20), st.integers(1, 20)) | st.tuples(
    st.integers(1, 20), st.integers(1, 20), st.just(3)
)
IMAGES = st.sampled_from([np.uint8, np.uint16]).flatmap(lambda kind: arrays.arrays(kind, SHAPES))


@given(IMAGES)
def test_a_tiff_comes_back_bit_by_bit(tmp_path_factory, pixels) -> None:
    path = tmp_path_factory.getbasetemp() / "spooled.tif"
    path.write_bytes(runs.tiff_of(pixels))
    found = decoded(path)
    assert found.dtype == pixels.dtype
    np.testing.assert_array_equal(found, pixels)


def test_another_reader_agrees(tmp_path, rng) -> None:
    tifffile = pytest.importorskip("tifffile")
    pixels = rng.integers(0, 65536, (7, 5, 3)).astype(np.uint16)
    (tmp_path / "one.tif").write_bytes(runs.tiff_of(pixels))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "one.tif")[:, :, ::-1], pixels)


def test_a_spool_is_a_data_set(tmp_path, rng) -> None:
    run = runs.new_run(tmp_path, "s")
    spool = runs.Spool(run, runs.KeptImages(tmp_path, "s", 1.0))
    taken = [Frame(rng.integers(0, 4096, (6, 8)).astype(np.uint16), bit_depth=12, time_s=5.5 + n,
                   encoder_count=100.0 + n) for n in range(3)]  # fmt: skip
    given_on = [spool.add((frame,)) for frame in taken]
    spool.close()
    source = DatasetSource()
    references = source.references(run)
    for reference, frame, (acquisition, hashes) in zip(references, taken, given_on, strict=True):
        (read,) = source.read(reference).frames
        np.testing.assert_array_equal(read.pixels, frame.pixels)
        assert (read.bit_depth, read.time_s, read.encoder_count) == (12, frame.time_s, frame.encoder_count)
        assert acquisition.id == reference.id
        assert len(hashes["laser_sha256"]) == 64


def test_the_oldest_images_go_first(tmp_path) -> None:
    image = (Frame(np.zeros((100, 100), np.uint8)),)  # 10 kB, and a head
    first, second = runs.new_run(tmp_path, "s"), runs.new_run(tmp_path, "s")
    assert first != second, "runs of one second have names of their own"

    def left() -> list[list[str]]:
        return [[path.stem for path in sorted(run.glob("images/*"))] for run in (first, second)]

    spool = runs.Spool(first, runs.KeptImages(tmp_path, "s", 2.5e-5))
    for _ in range(4):
        spool.add(image)
    assert left()[0] == ["000003", "000004"]
    spool = runs.Spool(second, runs.KeptImages(tmp_path, "s", 4.5e-5))  # as after a restart
    for _ in range(3):
        spool.add(image)
    assert left() == [["000004"], ["000001", "000002", "000003"]]
    (first / "images" / "000004.tif").unlink()  # by hand
    for _ in range(3):
        spool.add(image)
    assert left() == [[], ["000003", "000004", "000005", "000006"]]


def test_a_record_is_completed_from_the_outbox(tmp_path) -> None:
    outbox = Outbox(tmp_path)
    run = runs.new_run(tmp_path, "s")
    lines = [f'{{"id": "00000{n}#1", "acquisition": "00000{n}"}}' for n in (1, 2, 3)]
    (run / "measurements.jsonl").write_text(lines[0] + "\n" + lines[1][:9])  # killed within a line
    for number, line in enumerate(lines):
        outbox.put([NewRow(f"l/{run.name}/{number}", "s", run.name, "product", {}, "{}", line)])
    assert runs.complete_record(run, outbox) == {"000001", "000002", "000003"}
    assert (run / "measurements.jsonl").read_text() == "".join(line + "\n" for line in lines)
    runs.complete_record(run, outbox)
    assert len((run / "measurements.jsonl").read_text().splitlines()) == 3
