"""Where lengths come from: the board, or a block, a staircase, the encoder; and what contradicts what."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roemetry.errors import CalibrationError
from roemetry.records import Block, CalibrationSet, Frame, Observation, Staircase
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.conformance import _image, _peaks, _pose, observed_of
from roemetry_pinhole.frames import lines_at_height

FREE = PinholeCalibrator(PinholeCalibratorOptions(scale="free"))
BLOCK = Block("block", 100.0, 30.0, 10.0, tolerance_mm=0.01)
STEPS = Staircase("steps", (10.0,), 10.0, 80.0, tolerance_mm=0.01)
WAY_MM = 0.05
"""Per encoder count, straight up in the image."""


@pytest.fixture(scope="module")
def seen() -> CalibrationSet:
    """Boards, the empty belt, a level of 10 mm as block and as staircase, and a board on the moving belt."""
    rig = LinearRig()
    observed = observed_of(rig)
    made = PinholeCalibrator().calibrate(observed)
    rows = np.arange(rig.rows, dtype=np.float64)
    top = lines_at_height(made.parameters, rows, 10.0)
    x_px = np.where((rows > 60) & (rows < 140), top, lines_at_height(made.parameters, rows, 0.0))
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


def test_the_belt_tells_its_way_per_count(seen) -> None:
    made = PinholeCalibrator().calibrate(seen)
    assert made.residuals["mm_per_count"] == pytest.approx(WAY_MM, rel=2e-3)
    off = made.residuals["mm_per_count"] - WAY_MM
    assert abs(off) < 4.0 * made.residuals["mm_per_count_std"] + 1e-4 * WAY_MM
    assert any("mm per count" in note for note in made.notes)


@pytest.mark.parametrize("by", ["block", "staircase", "encoder"])
def test_the_scale_comes_from_the_reference(seen, by: str) -> None:
    """A board printed 3 % larger than described; heights and distances come out right again."""
    right = PinholeCalibrator().calibrate(seen)
    given = {"block": {"block": BLOCK}, "staircase": {"staircase": STEPS}}
    asked = replace(smaller(seen, 1.03), **given.get(by, {"mm_per_count": (WAY_MM, 1e-5)}))
    made = FREE.calibrate(asked)
    assert made.residuals["pitch_ratio"] == pytest.approx(1.03, abs=4.0 * made.residuals["pitch_ratio_std"])
    assert made.residuals["pitch_ratio_std"] < 0.004
    assert made.target["pitch_mm"] == pytest.approx(seen.board.pitch_mm, rel=0.004)
    away, found = (1.0 / np.linalg.norm(one.parameters["belt_per_mm"]) for one in (right, made))
    assert found == pytest.approx(away, rel=0.005)
    assert any("scale: looked for" in note and by in note for note in made.notes)
    assert not any("from the board's pitch" in note for note in made.notes)
    assert (np.linalg.eigvalsh(made.covariance) > -1e-9 * np.abs(made.covariance).max()).all()


def test_the_covariance_holds_the_references_length(seen) -> None:
    """A block known to a tenth as well gives distances that are uncertain by as much more."""
    stds = []
    for tolerance_mm in (0.01, 0.2):
        made = FREE.calibrate(replace(seen, block=replace(BLOCK, tolerance_mm=tolerance_mm)))
        at = [name for name, array in made.parameters.items() for _ in np.ravel(array)].index(
            "belt_per_mm"
        ) + 2
        stds.append(np.sqrt(made.covariance[at, at]) / made.parameters["belt_per_mm"][2])
    assert stds[1] == pytest.approx(np.hypot(0.2 / np.sqrt(3.0) / 10.0, stds[0]), rel=0.05)


def test_a_free_scale_without_reference_is_refused(seen) -> None:
    with pytest.raises(CalibrationError, match="nothing beside the board tells it") as caught:
        FREE.calibrate(seen)
    assert "encoder_mm_per_count" in (caught.value.hint or "")


@pytest.mark.parametrize("known", [True, False])
def test_references_that_contradict_are_refused_with_the_ratio(seen, known: bool) -> None:
    both = replace(seen, block=BLOCK, mm_per_count=(1.04 * WAY_MM, 1e-5))
    method = PinholeCalibrator() if known else FREE
    with pytest.raises(CalibrationError, match=r"contradict each other.* (0\.96|1\.0[34])\d\d ± 0\.0"):
        method.calibrate(both)


def test_the_page_shows_the_calibration_with_the_scale_that_was_found(seen) -> None:
    asked = replace(smaller(seen, 1.03), block=BLOCK)
    made = FREE.calibrate(asked)
    figures = {one.title: one.value for one in FREE.evidence(asked, made).figures}
    assert figures["heights on other views, single points, rms"] < 0.1, "mm; 3 % of 20 mm are 0.6"
