"""The pattern file: what it says to rig and scene, and what contradicts it."""

from __future__ import annotations

from pathlib import Path

import pytest

from roemetry.config.rig import Rig
from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError

GRID, DOTS = Path("recipes/potato_grid"), Path("recipes/potato_dots")
_RIG, _SCENE = "rig.yaml", "simulated.yaml"


def test_one_file_tells_rig_and_scene() -> None:
    for folder, lines, columns in ((GRID, 11, 15), (DOTS, 20, 20)):
        rig = Rig.load(folder / _RIG)
        assert rig.file.stripes == columns
        assert rig.calibrator.options.lines == lines
        laser = Scene.load(folder / _SCENE).simulator.options.laser
        assert laser.planes == columns
        assert (laser.grid or laser.dots).lines == lines


def test_a_cross_hair_is_a_grid_of_one_line_and_one() -> None:
    sets = ["pattern={kind: cross-hair}"]
    assert Rig.load(GRID / _RIG, sets=sets).calibrator.options.lines == 1
    laser = Scene.load(GRID / _SCENE, sets=sets).simulator.options.laser
    assert (laser.planes, laser.grid.lines) == (1, 1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("stripes=11", "the pattern has 15 lines along X, `stripes` says 11"),
        ("calibrator.options.lines=9", "the pattern has 11 lines along Y, `lines` says 9"),
        (
            "pattern={kind: dots, lines_x: 15, lines_y: 11}",
            "`grid-lines` is made for grid, the pattern is dots",
        ),
        ("pattern={kind: grid, lines_x: 15}", "grid need lines_y"),
        ("pattern={kind: lines, lines_x: 15, lines_y: 2}", "along X alone"),
        ("pattern={kind: cross-hair, lines_x: 2}", "one line along each side"),
        ("pattern=none.yaml", "cannot be read"),
    ],
)
def test_a_rig_that_contradicts_its_pattern_is_refused(change: str, says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        Rig.load(GRID / _RIG, sets=[change])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("simulator.options.laser.planes=9", "the pattern says planes: 15, and laser.planes 9"),
        ("simulator.options.laser.dots={lines: 4}", "the pattern says dots: None"),
        ("pattern={kind: grid, lines_x: 3, lines_y: 3}", "needs spacing_x_mm"),
    ],
)
def test_a_scene_that_contradicts_its_pattern_is_refused(change: str, says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        Scene.load(GRID / _SCENE, sets=[change])
