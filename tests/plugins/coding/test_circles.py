"""Circles: cones and lines of sight, and images that are not of the circles that were calibrated."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry import Recipe
from roemetry.config.rig import Rig
from roemetry.config.scene import Scene
from roemetry.errors import ConfigurationError, StageError
from roemetry.records import Frame, Sensor
from roemetry.records.calibration import Calibration
from roemetry.records.cones import meet_cones
from roemetry.records.view import write_camera
from roemetry.testing.patterns import CircleRig, level
from roemetry_coding.belt_circles import BeltCircles
from roemetry_coding.circles import CircleOrder
from roemetry_peaks.circle_curves import CircleCurves
from roemetry_pinhole.cones import PinholeCircles

CIRCLES = Path("recipes/potato_circles")


def test_a_line_of_sight_meets_the_half_it_is_asked_for() -> None:
    # a cone of 45° with its apex 10 mm up: on the belt a circle of 10 mm
    half = np.array([0.0, 0.0, 10.0, 0.0, 0.0, -1.0, np.pi / 4.0])
    cones = np.array([half, half * [1, 1, 1, 1, 1, 1, -1]])
    start, way = np.array([[10.0, 0.0, 50.0], [-6.0, 8.0, 50.0]]), np.tile([0.0, 0.0, -1.0], (2, 1))
    found = meet_cones(start, way, cones, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(found, [[10.0, 0.0, 0.0], [-6.0, 8.0, 0.0]], atol=1e-12)
    assert np.isnan(meet_cones(start, way, cones[::-1], np.array([1.0, 0.0, 0.0]))).all()


def test_halves_are_stripes_and_circles_are_counted_in_both_files() -> None:
    assert Rig.load(CIRCLES / "rig.yaml").file.stripes == 22
    laser = Scene.load(CIRCLES / "simulated.yaml").simulator.options.laser
    assert (laser.circles.count, laser.circles.spacing_mm) == (11, 8.0)
    with pytest.raises(ConfigurationError, match="22 halves of circles, `stripes` says 11"):
        Rig.load(CIRCLES / "rig.yaml", sets=["stripes=11"])
    with pytest.raises(ConfigurationError, match="`circle-curves` is made for circles, the pattern is dots"):
        Rig.load(CIRCLES / "rig.yaml", sets=["pattern={kind: dots, lines_x: 11, lines_y: 11}"])


def test_what_is_not_the_calibrated_circles_is_refused() -> None:
    calibration = Calibration.load(CIRCLES / "calibration.yaml")
    for path, says in (
        (Path("recipes/potato_grid/images/potato_02.png"), "of the 11 calibrated circles"),
        (min(Path("recipes/potato_dots/images").glob("*.png")), "of the 11 calibrated circles"),
    ):
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert pixels is not None
        peaks = CircleCurves().extract(Frame(pixels.astype(np.uint8), sensor=Sensor(0.0255, 0.2)))
        with pytest.raises(StageError, match=says):
            CircleOrder().code(peaks, calibration)


def test_turned_images_of_the_circles_are_refused() -> None:
    calibration = Calibration.load(CIRCLES / "calibration.yaml")
    pixels = cv2.imread(str(CIRCLES / "images/potato_01.png"), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    for turned in (pixels[::-1, ::-1], pixels[:, ::-1]):
        frame = Frame(np.ascontiguousarray(turned, np.uint8), sensor=Sensor(0.0255, 0.2))
        with pytest.raises(StageError, match="calibrated"):
            CircleOrder().code(CircleCurves().extract(frame), calibration)


def test_a_hidden_circle_shifts_no_label() -> None:
    rig = CircleRig()
    places = rig.x_on_rows(rig.circle_dome(10.0))
    places[2], places[7, :90] = np.nan, np.nan
    peaks, stripe = rig.circle_peaks(places)
    coded = CircleOrder().code(peaks, rig.circle_calibration())
    assert (coded.peak_stripe == stripe).mean() > 0.98
    assert not ((coded.peak_stripe >= 0) & (coded.peak_stripe != stripe)).any()


def test_without_height_every_place_lies_on_the_belt() -> None:
    rig = CircleRig()
    peaks, _ = rig.circle_peaks(rig.x_on_rows(level))
    coded = CircleOrder().code(peaks, rig.circle_calibration())
    assert coded.circles
    assert set(np.unique(coded.product)) == {-1, 0}


def test_a_lost_column_is_refused_and_no_motion_of_the_camera() -> None:
    """All circles right of it lie a pixel aside, which shift, turn and zoom explain in part."""
    calibration = Calibration.load(CIRCLES / "calibration.yaml")
    pixels = cv2.imread(str(CIRCLES / "images/potato_02.png"), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    moved = PinholeCircles().moved
    torn = np.concatenate([np.delete(pixels, 470, axis=1), pixels[:, -1:]], axis=1)
    peaks = CircleCurves().extract(Frame(torn.astype(np.uint8), sensor=Sensor(0.0255, 0.2)))
    with pytest.raises(StageError, match="columns of the image are lost"):
        BeltCircles().align(peaks, calibration, moved)
    shifted = cv2.warpAffine(
        pixels, np.array([[1.0, 0.0, 0.8], [0.0, 1.0, -0.5]]), pixels.shape[::-1], flags=cv2.INTER_LANCZOS4
    )
    peaks = CircleCurves().extract(Frame(shifted.astype(np.uint8), sensor=Sensor(0.0255, 0.2)))
    assert BeltCircles().align(peaks, calibration, moved).moved


def test_circles_without_an_outline_have_no_volume() -> None:
    (product, *_) = Recipe.load(CIRCLES, sets=["sinks=[]", "stages.outliner=null"]).run()
    assert product.volume is None
    assert any("circles need an outline" in reason.text for reason in product.absent.values())


def test_a_file_for_other_programs_holds_no_planes_of_circles(tmp_path: Path) -> None:
    view = Calibration.load(CIRCLES / "calibration.yaml").view
    assert view is not None
    write_camera(tmp_path / "camera.yaml", view)
    text = (tmp_path / "camera.yaml").read_text()
    assert "camera_matrix" in text
    assert "laser_planes" not in text
