"""A known block is measured while the line runs, and the laser's light is watched."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from roemetry.records import Frame
from roemetry.run.control_chart import Chart
from roemetry_line import line_file as line_file_module
from roemetry_line.block_checks import BlockChecks, LaserHealth
from roemetry_line.history import checks_of
from roemetry_line.line_file import Line
from roemetry_line.outbox import Outbox
from roemetry_line.outlets.database import connect
from tests.command import typed
from tests.plugins.line.loopback import wait_for

BLOCK = "kind: block\nname: block-12\nlength_mm: 40\nwidth_mm: 25\nheight_mm: 12\ntolerance_mm: 0.02\n"


@dataclass
class Checked:
    """What a test looks at."""

    line: Line
    outbox: Outbox
    checks: BlockChecks
    told: list[tuple[str, str]]

    def until_told(self, frame: Frame | None = None) -> tuple[str, str]:
        """Let the checks run, on this frame or none, until they say something; gives it."""
        stop, before = threading.Event(), len(self.told)
        running = threading.Thread(target=self.checks.run, args=(stop,))
        running.start()
        try:
            if frame is not None:
                wait_for(lambda: self.checks.takes(frame), "no frame is taken")
            wait_for(lambda: len(self.told) > before, "nothing is told")
        finally:
            stop.set()
            running.join()
        return self.told[-1]

    def after(self, frame: Frame) -> tuple[str, str]:
        number = self.outbox.ask_check("one", "otto")
        assert self.outbox.ask_check("one", "erika") == number, "one is enough"
        self.until_told(frame)
        assert not self.checks.takes(frame), "the next frame shows a product"
        assert self.outbox.last_check("one")["ended"] is not None
        return self.told[-1]


@pytest.fixture
def checked(line_file, monkeypatch):
    monkeypatch.setattr("roemetry_line.block_checks._LOOK_S", 0.02)
    path = line_file(("recipe: recipe.yaml", "recipe: recipe.yaml\n    check_block: block.yaml"))
    (path.parent / "block.yaml").write_text(BLOCK, "utf-8")
    loaded = Line.load(path)
    outbox, told = Outbox(loaded.folder), list[tuple[str, str]]()
    recipe = path.parent / "recipe.yaml"
    checks = BlockChecks(
        "one", loaded.stations[0].block, loaded.folder, outbox,
        lambda: line_file_module.load_recipe(recipe, loaded.folder), lambda *given: told.append(given),
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

    connect(checked.line.history_url).close()
    shown = typed("history", checked.line.path, "--report", tmp_path / "h.html")
    assert "calibration of one: 2 checks" in shown.output
    assert "height of the block: 13.0" in shown.output
    page = (tmp_path / "h.html").read_text("utf-8")
    assert "Calibration of station one" in page
    assert page.count("<svg") == 3, "a chart for each length"


@pytest.mark.parametrize("frame_s", [0.05, 0.0], ids=["in time", "asked for long ago"])
def test_a_check_that_gets_no_frame_ends_and_takes_no_products_frame(
    checked, rig, monkeypatch, frame_s
) -> None:
    monkeypatch.setattr("roemetry_line.block_checks._FRAME_S", frame_s)
    number = checked.outbox.ask_check("one", "otto")
    verdict, said = checked.until_told()
    assert (verdict, said[:54]) == ("failed", "the check block was not measured: no frame came within")
    assert len(checked.told) == 1
    assert checked.outbox.last_check("one")["n"] == number
    assert not checked.checks.takes(block_of(rig, 12.0))


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
    never_on = LaserHealth()
    assert [never_on.look(seen(0.0, many=0)) for _ in range(3)][-1].startswith("no stripe is seen")
