"""A known block is measured while the line runs, and the laser's light is watched."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from roemetry.cli.main import app
from roemetry.records import Frame
from roemetry.run.control_chart import Chart
from roemetry_line import line_file
from roemetry_line.block_checks import BlockChecks, LaserHealth
from roemetry_line.history import checks_of
from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox

LINE = """\
roemetry_line: 1
name: line-1
folder: data
stations:
  - name: one
    recipe: recipe.yaml
    check_block: block.yaml
    feed: {use: folder-watch, options: {path: in}}
"""
BLOCK = "kind: block\nname: block-12\nlength_mm: 40\nwidth_mm: 25\nheight_mm: 12\ntolerance_mm: 0.02\n"


@dataclass
class Checked:
    """What a test looks at."""

    line: Line
    outbox: Outbox
    checks: BlockChecks
    told: list[tuple[str, str]]

    def until_told(self) -> None:
        """Let the checks run without a frame until they say something."""
        stop = threading.Event()
        running = threading.Thread(target=self.checks.run, args=(stop,))
        running.start()
        for _ in range(400):
            if self.told:
                break
            stop.wait(0.02)
        stop.set()
        running.join()

    def after(self, frame: Frame) -> tuple[str, str]:
        """Ask for a check, give a frame, and wait for what is told."""
        number = self.outbox.ask_check("one", "otto")
        assert self.outbox.ask_check("one", "erika") == number, "one is enough"
        stop = threading.Event()
        running = threading.Thread(target=self.checks.run, args=(stop,))
        running.start()
        before = len(self.told)
        for _ in range(400):
            if self.checks.takes(frame):
                break
            stop.wait(0.02)
        for _ in range(1000):
            if len(self.told) > before:
                break
            stop.wait(0.02)
        stop.set()
        running.join()
        assert not self.checks.takes(frame), "the next frame shows a product"
        assert self.outbox.last_check("one")["ended"] is not None
        return self.told[-1]


@pytest.fixture
def checked(line, monkeypatch):
    monkeypatch.setattr("roemetry_line.block_checks._LOOK_S", 0.02)
    recipe = line()
    (recipe.parent / "block.yaml").write_text(BLOCK, "utf-8")
    (recipe.parent / "line.yaml").write_text(LINE, "utf-8")
    loaded = Line.load(recipe.parent / "line.yaml")
    outbox, told = Outbox(loaded.folder), list[tuple[str, str]]()
    checks = BlockChecks(
        "one", loaded.stations[0].block, loaded.folder, outbox,
        lambda: line_file.load_recipe(recipe, loaded.folder), lambda *given: told.append(given),
    )  # fmt: skip
    return Checked(loaded, outbox, checks, told)


def block_of(rig, height_mm: float) -> Frame:
    """Draw the block under the inner stripes."""
    heights = np.zeros((rig.stripes, rig.rows))
    heights[1:5, 60:160] = height_mm
    return Frame(rig.image(rig.x_px(heights), lens_px=1.0))


def test_a_block_is_measured_when_somebody_asks(checked, rig, tmp_path) -> None:
    assert not checked.checks.takes(block_of(rig, 12.0)), "nobody has asked"
    verdict, said = checked.after(block_of(rig, 12.0))
    assert verdict == "in order", said
    assert "height 12.0" in said
    verdict, said = checked.after(block_of(rig, 13.0))
    assert verdict == "out"
    assert "height 13.0" in said
    verdict, said = checked.after(Frame(rig.image(rig.x_px(np.zeros((rig.stripes, rig.rows))))))
    assert verdict == "failed", "there is no block"
    last = checked.outbox.last_check("one")
    assert (last["who"], last["verdict"], last["text"]) == ("otto", "failed", said)
    assert [one.verdict for one in checks_of(checked.line, checked.line.stations[0])] == ["in order", "out"]
    kept = list((checked.line.folder / "checks").glob("*.tif"))
    assert len(kept) == 3, "every frame that was taken for a check is kept"
    assert Chart(checked.line.folder / "checks" / "one.sqlite").checks()[0].image in {
        one.name for one in kept
    }

    from roemetry_line.outlets.database import connect

    connect(checked.line.history_url).close()
    shown = CliRunner().invoke(app, ["history", str(checked.line.path), "--report", str(tmp_path / "h.html")])
    assert shown.exit_code == 0, shown.output
    assert "calibration of one: 2 checks" in shown.output
    assert "height of the block: 13.0" in shown.output
    page = (tmp_path / "h.html").read_text("utf-8")
    assert "Calibration of station one" in page
    assert page.count("<svg") == 3, "a chart for each length"


def test_a_check_that_gets_no_frame_ends(checked, monkeypatch) -> None:
    monkeypatch.setattr("roemetry_line.block_checks._FRAME_S", 0.05)
    number = checked.outbox.ask_check("one", "otto")
    checked.until_told()
    assert checked.told == [("failed", "the check block was not measured: no frame came within 0.05 s")]
    assert checked.outbox.last_check("one")["n"] == number


def seen(height: float, many: int = 50) -> SimpleNamespace:
    """Give as much of a trace as the laser's health looks at."""
    return SimpleNamespace(
        frame=SimpleNamespace(white=255.0), peaks=SimpleNamespace(amplitude=np.full(many, height))
    )


def test_a_laser_that_dims_or_goes_out_is_told_after_three_frames() -> None:
    laser = LaserHealth()
    assert [laser.look(seen(153.0)) for _ in range(30)] == [""] * 30
    assert laser.percent == pytest.approx(60.0)
    assert [laser.look(seen(80.0)) for _ in range(3)] == [""] * 3, "half of the light is left"
    assert [laser.look(seen(70.0)) for _ in range(2)] == [None, None], "a hand before the camera"
    assert (
        laser.look(seen(70.0))
        == "the stripes have 27 % of white, 60 % when the run began: is the window dirty?"
    )
    assert laser.look(seen(0.0, many=0)) == "no stripe is seen: is the laser on, and its window clean?"
    assert laser.look(seen(150.0)) == ""
    assert laser.look(None) is None


def test_a_laser_that_was_never_on_is_told() -> None:
    laser = LaserHealth()
    assert [laser.look(seen(0.0, many=0)) for _ in range(3)][-1] == (
        "no stripe is seen: is the laser on, and its window clean?"
    )


def test_a_check_that_was_asked_for_long_ago_takes_no_products_frame(checked, rig, monkeypatch) -> None:
    monkeypatch.setattr("roemetry_line.block_checks._FRAME_S", 0.0)
    checked.outbox.ask_check("one", "otto")
    checked.until_told()
    assert not checked.checks.takes(block_of(rig, 12.0))
    ((verdict, said),) = checked.told
    assert verdict == "failed"
    assert "no frame came" in said
