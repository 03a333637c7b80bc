"""What is wrong with a line file is told at its place, with what to do, before anything starts."""

from __future__ import annotations

import pytest

from roemetry.errors import ConfigurationError
from roemetry.io.files import exclusive
from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox
from tests.command import typed

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
