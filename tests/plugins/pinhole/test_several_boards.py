"""Several boards in one adjustment, their scales compared; stretched prints; the page of all images."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from roemetry.calibrating.evidence import findings_page
from roemetry.errors import CalibrationError
from roemetry.records import Board, CalibrationSet
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.pinhole_plane import points_of


def shared_out(observed: CalibrationSet, factor: float) -> CalibrationSet:
    """Every second pose shows another board, whose pitch is described wrongly by a factor."""
    poses = list(dict.fromkeys(one.pose for one in observed.observations if one.shows == "board"))
    others = set(poses[1::2])
    first = observed.board
    assert first is not None
    second = replace(first, name="second", pitch_mm=factor * first.pitch_mm)
    moved = tuple(replace(one, board=int(one.pose in others)) for one in observed.observations)
    return replace(observed, observations=moved, more_boards=(second,))


@pytest.mark.thorough
def test_two_boards_that_agree_give_what_one_does(observed: CalibrationSet) -> None:
    found = PinholeCalibrator().calibrate(shared_out(observed, 1.0))
    ratio, std = found.residuals["board_2_ratio"], found.residuals["board_2_ratio_std"]
    assert abs(ratio - 1.0) < 3.0 * std < 0.02
    alone = PinholeCalibrator().calibrate(observed)
    stripe, row = np.repeat(np.arange(7), 3), np.tile([40.0, 100.0, 160.0], 7)
    x_px = LinearRig().rest_px()[stripe, row.astype(int)] + 20.0
    heights = [points_of(one.parameters, stripe, x_px, row)[:, 2] for one in (found, alone)]
    assert heights[0] == pytest.approx(heights[1], abs=0.05)  # mm
    assert any("one board alone" in note for note in alone.notes)
    assert not any("one board alone" in note for note in found.notes)


@pytest.mark.parametrize(
    "factor", [0.98, *(pytest.param(factor, marks=pytest.mark.thorough) for factor in (1.02, 1.1))]
)
def test_two_boards_that_disagree_are_refused_with_the_ratio(observed: CalibrationSet, factor: float) -> None:
    with pytest.raises(CalibrationError, match=rf"the pitch of the board second is {1.0 / factor:.3}"):
        PinholeCalibrator().calibrate(shared_out(observed, factor))


def test_a_second_board_gives_the_scale_of_a_first_whose_print_is_not_trusted(
    observed: CalibrationSet,
) -> None:
    wrong = shared_out(observed, 1.0)
    board = observed.board
    assert board is not None
    wrong = replace(wrong, board=replace(board, pitch_mm=1.03 * board.pitch_mm))
    found = PinholeCalibrator(PinholeCalibratorOptions(scale="free")).calibrate(wrong)
    assert found.residuals["pitch_ratio"] == pytest.approx(
        1.0 / 1.03, abs=3.0 * found.residuals["pitch_ratio_std"]
    )


def test_a_stretched_print_is_told_and_can_be_described(observed: CalibrationSet) -> None:
    board = observed.board
    assert board is not None
    wrong = replace(observed, board=replace(board, row_pitch_mm=1.01 * board.pitch_mm))
    try:
        said = " ".join(PinholeCalibrator().calibrate(wrong).notes)
    except CalibrationError as error:
        said = error.message
    # all boards lie alike in these images, so that the camera takes the stretch
    differs = re.search(r"fx and fy differ by ([\d.]+)%", said)
    assert differs is not None
    assert float(differs[1]) == pytest.approx(1.0, abs=0.15)
    assert "print of a board stretched" in said
    assert replace(board, row_pitch_mm=2.0).size_mm[1] == 2.0 * board.rows


def test_each_image_is_shown_with_the_reason_also_where_nothing_comes_of_it(observed: CalibrationSet) -> None:
    laser = next(n for n, one in enumerate(observed.observations) if one.shows == "board" and len(one.peaks))
    nothing = next(one.peaks for one in observed.observations if one.frame.role == "plain")
    dark = replace(observed.observations[laser], peaks=nothing)
    spoiled = replace(
        observed, observations=(*observed.observations[:laser], dark, *observed.observations[laser + 1 :])
    )
    calibrator = PinholeCalibrator()
    calibrator.calibrate(spoiled)
    found = calibrator.findings(spoiled)
    assert [one.observation for one in found] == list(spoiled.observations)
    assert "no stripe is seen" in found[laser].why
    used = [one for one in found if not one.why]
    assert len(used) == len(found) - 1
    assert all(len(one.corners_px) or len(one.points_px) for one in used)
    board = Board("another", "chessboard", columns=20, rows=15, pitch_mm=5.0)
    refused = replace(observed, board=board)
    with pytest.raises(CalibrationError) as refusal:
        calibrator.calibrate(refused)
    page = findings_page(calibrator.findings(refused), "rig", str(refusal.value))
    assert page.count("data:image/jpeg") == len(refused.observations)
    assert "There is no calibration" in page
    assert "it is another board" in page
