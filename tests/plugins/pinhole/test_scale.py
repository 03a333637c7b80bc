"""Where lengths come from: the board, or a block, a staircase, the encoder; and what contradicts what."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import CalibrationError
from roemetry.records import Block, CalibrationSet, Frame, Observation, Ruler, SpherePlate
from roemetry.records.calibration import Calibration
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.conformance import _image, _peaks, _pose
from roemetry_pinhole.pinhole_plane import lines_at_height, view_of
from roemetry_pinhole.prints import tolerance_of
from roemetry_pinhole.scale import by_scale, check_scale
from tests.plugins.pinhole.solids_seen import over_balls

FREE = PinholeCalibrator(PinholeCalibratorOptions(scale="free"))
BLOCK = Block("block", 100.0, 30.0, 10.0, tolerance_mm=0.01)
BALLS = SpherePlate("balls", 3, 2, pitch_mm=18.0, diameter_mm=14.0, centre_height_mm=9.0, tolerance_mm=0.01)
WAY_MM = 0.05
"""Per encoder count, straight up in the image."""


@pytest.fixture(scope="module")
def seen(observed, calibrated) -> CalibrationSet:
    """Boards, the empty belt, a level of 10 mm as block and as staircase, and a board on the moving belt."""
    rig = LinearRig()
    rows = np.arange(rig.rows, dtype=np.float64)
    top = lines_at_height(calibrated.parameters, rows, 10.0)
    x_px = np.where((rows > 60) & (rows < 140), top, lines_at_height(calibrated.parameters, rows, 0.0))
    belt = next(one for one in observed.observations if one.shows == "belt")
    levels = [
        replace(belt, shows=shows, peaks=rig.peaks(x_px, scatter_px=0.03).peaks)
        for shows in ("block", "staircase")
    ]
    rotation, shift = _pose(0)
    carried = []
    for count in (0.0, 40.0, 80.0):
        image = _image(rig, rotation, shift + np.array([0.0, -WAY_MM * count, 0.0]))
        frame = Frame(image, role="plain", name=f"carried {count:g}", encoder_count=count)
        carried.append(
            Observation("board_on_belt", frame, _peaks(rig, np.empty((0, 2))), f"carried {count:g}")
        )
    board = replace(observed.board, thickness_mm=6.0, flatness_mm=0.02)
    return replace(observed, observations=(*observed.observations, *levels, *carried), board=board)


def smaller(seen: CalibrationSet, factor: float) -> CalibrationSet:
    """The same with a board that is described smaller than it is."""
    return replace(seen, board=replace(seen.board, pitch_mm=seen.board.pitch_mm / factor))


@pytest.fixture(scope="module")
def right(seen) -> Calibration:
    return PinholeCalibrator().calibrate(seen)


@pytest.fixture(scope="module")
def by_block(seen) -> Calibration:
    """The scale from a block; the board is 3 % larger than described."""
    return FREE.calibrate(replace(smaller(seen, 1.03), block=BLOCK))


def test_the_belt_tells_its_way_per_count(right) -> None:
    made = right
    assert made.residuals["mm_per_count"] == pytest.approx(WAY_MM, rel=2e-3)
    off = made.residuals["mm_per_count"] - WAY_MM
    assert abs(off) < 4.0 * made.residuals["mm_per_count_std"] + 1e-4 * WAY_MM
    assert any("mm per count" in note for note in made.notes)


@pytest.mark.parametrize("by", ["block", "encoder", "ruler", "sphere plate"])
def test_the_scale_comes_from_the_reference(seen, right, by_block, by: str) -> None:
    """A board printed 3 % larger than described; heights and distances come out right again."""
    plates = [balls_on_belt(seen, right, 1.0, x_mm) for x_mm in (1.5, -2.0)]
    given = {
        "encoder": {"mm_per_count": (WAY_MM, 1e-5)},
        "ruler": {"ruler": Ruler(100.0, 103.0, 0.1)},
        "sphere plate": {"sphere_plate": BALLS, "observations": (*seen.observations, *plates)},
    }
    made = by_block if by == "block" else FREE.calibrate(replace(smaller(seen, 1.03), **given[by]))
    assert made.residuals["pitch_ratio"] == pytest.approx(1.03, abs=4.0 * made.residuals["pitch_ratio_std"])
    assert made.residuals["pitch_ratio_std"] < 0.004
    assert made.target["pitch_mm"] == pytest.approx(seen.board.pitch_mm, rel=0.004)
    away, found = (1.0 / np.linalg.norm(one.parameters["belt_per_mm"]) for one in (right, made))
    assert found == pytest.approx(away, rel=0.005)
    assert any("scale: looked for" in note and by in note for note in made.notes)
    assert not any("from the board's pitch" in note for note in made.notes)
    assert (np.linalg.eigvalsh(made.covariance) > -1e-9 * np.abs(made.covariance).max()).all()
    if by == "ruler":
        assert made.residuals["pitch_ratio_std"] == pytest.approx(0.1 / 103.0, rel=1e-3)
        way, std = by_scale(made.parameters), np.sqrt(np.diag(made.covariance))
        beyond = (made.covariance - (0.1 / 103.0) ** 2 * np.outer(way, way))[np.ix_(std > 0.0, std > 0.0)]
        least = np.linalg.eigvalsh(beyond / np.outer(std[std > 0.0], std[std > 0.0])).min()
        assert least > -1e-6, "no combination of the parameters may be surer of lengths than the ruler"


def way_std(made: Calibration) -> float:
    """Relative standard deviation of the belt's way per count, as the covariance has it."""
    names = [name for name, array in made.parameters.items() for _ in np.ravel(array)]
    at = names.index("belt_per_mm") + 2
    return float(np.sqrt(made.covariance[at, at]) / abs(made.parameters["belt_per_mm"][2]))


@pytest.mark.thorough
def test_the_covariance_holds_the_references_length(seen, by_block) -> None:
    """A block known to a tenth as well gives distances that are uncertain by as much more."""
    rough = replace(BLOCK, tolerance_mm=0.2)
    stds = [way_std(made) for made in (by_block, FREE.calibrate(replace(smaller(seen, 1.03), block=rough)))]
    assert stds[1] == pytest.approx(np.hypot(0.2 / np.sqrt(3.0) / 10.0, stds[0]), rel=0.05)


def test_a_free_scale_without_reference_is_refused(seen) -> None:
    with pytest.raises(CalibrationError, match="needs a reference besides the board") as caught:
        FREE.calibrate(seen)
    assert "encoder_mm_per_count" in (caught.value.hint or "")


@pytest.mark.thorough
@pytest.mark.parametrize("known", [True, False])
def test_references_that_contradict_are_refused_with_the_ratio(seen, right, known: bool) -> None:
    both = replace(seen, block=BLOCK, mm_per_count=(1.04 * WAY_MM, 1e-5))
    with pytest.raises(CalibrationError, match=r"contradict each other.* (0\.96|1\.0[34])\d\d ± 0\.0"):
        check_scale(right, both) if known else FREE.calibrate(both)


def test_a_ruler_checks_the_print(seen, right) -> None:
    """A print of which 100 mm measure 103 ± 0.1; and one that is right."""
    with pytest.raises(CalibrationError, match=r"board and ruler contradict each other.* 0\.9709 ± 0\.001"):
        check_scale(right, replace(seen, ruler=Ruler(100.0, 103.0, 0.1)))
    fine = check_scale(right, replace(seen, ruler=Ruler(100.0, 100.05, 0.1)))["residuals"]
    assert fine["ruler_ratio"] == pytest.approx(1.0 / 1.0005, abs=1e-6)
    std = np.hypot(0.1 / 100.05, tolerance_of(seen.board))
    assert fine["ruler_ratio_std"] == pytest.approx(std, rel=1e-3)


def balls_on_belt(seen: CalibrationSet, right: Calibration, size: float, x_mm: float = 1.5) -> Observation:
    """What the rig of the boards sees of six balls that are larger than described by a factor."""
    rig = LinearRig()
    belt = lines_at_height(right.parameters, np.arange(rig.rows, dtype=np.float64), 0.0)
    view = view_of(right.parameters, right.image_size)
    x_px = over_balls(view, BALLS, np.array([x_mm, -0.8, np.radians(4.0), size]), belt)
    bare = next(one for one in seen.observations if one.shows == "belt")
    return replace(bare, shows="sphere_plate", peaks=rig.peaks(x_px, scatter_px=0.03).peaks)


def test_a_sphere_plate_is_measured(seen, right) -> None:
    """1 % off is told with the ratio; nothing is measured where nothing lies."""
    bare = next(one for one in seen.observations if one.shows == "belt")
    images = {
        "right": balls_on_belt(seen, right, 1.0),
        "small": balls_on_belt(seen, right, 0.99),
        "none": replace(bare, shows="sphere_plate"),
    }
    said = {}
    for name, image in images.items():
        observed = replace(seen, observations=(image,), sphere_plate=BALLS)
        try:
            said[name] = check_scale(right, observed)
        except CalibrationError as error:
            assert name == "small"
            assert re.search(r"board and sphere plate contradict .* 0\.9[89]\d\d ± 0\.00", error.message)
    std = said["right"]["residuals"]["sphere_plate_ratio_std"]
    assert said["right"]["residuals"]["sphere_plate_ratio"] == pytest.approx(1.0, abs=3.0 * std)
    assert std < 0.004
    assert any("on 6 balls lie 0.0" in note for note in said["right"]["notes"])
    assert "sphere_plate_ratio" not in said["none"]["residuals"]
    assert any("sphere plate was not found" in note for note in said["none"]["notes"])
    assert set(said) == {"right", "none"}
