"""Calibrations without a belt: the frame from a board's pose; the camera alone; stripes on the margin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet
from roemetry.records.calibration import ON_BELT, ON_BOARD, Calibration
from roemetry.testing import LinearRig
from roemetry_pinhole.boards import find_marks, plain_is_under
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.known_files import read_camera
from roemetry_pinhole.pinhole_plane import camera_of, points_of
from tests.command import typed


@pytest.fixture(scope="module")
def from_pose(boards: CalibrationSet) -> Calibration:
    return PinholeCalibrator(PinholeCalibratorOptions(reference_pose="pose 0")).calibrate(boards)


def test_without_belt_and_reference_it_is_refused(boards: CalibrationSet) -> None:
    with pytest.raises(CalibrationError, match="nothing shows where the belt is"):
        PinholeCalibrator().calibrate(boards)
    with pytest.raises(CalibrationError, match="not where they begin"):
        PinholeCalibrator(PinholeCalibratorOptions(gravity=(0.0, 0.0, 1.0))).calibrate(boards)
    with pytest.raises(CalibrationError, match="not seen in the pose '99'"):
        PinholeCalibrator(PinholeCalibratorOptions(reference_pose="99")).calibrate(boards)


def test_heights_count_from_the_named_board(from_pose: Calibration, calibrated: Calibration) -> None:
    assert from_pose.reference == ON_BOARD
    assert calibrated.reference == ON_BELT
    assert "reference" not in calibrated.to_dict()
    # the first pose lies level, 6 mm above the belt: the same points are 6 mm lower from there
    stripe, row = np.repeat(np.arange(7), 3), np.tile([40.0, 100.0, 160.0], 7)
    x_px = LinearRig().rest_px()[stripe, row.astype(int)] + 20.0
    low = points_of(from_pose.parameters, stripe, x_px, row)[:, 2]
    high = points_of(calibrated.parameters, stripe, x_px, row)[:, 2]
    assert high - low == pytest.approx(6.0, abs=0.1)


def test_heights_count_along_gravity_from_the_board_s_middle(
    boards: CalibrationSet, from_pose: Calibration
) -> None:
    # the camera looks straight down on boards that lie level: gravity is its z, or 10° beside it
    options = {"reference_pose": "pose 0", "gravity_std_deg": 0.2}

    def with_gravity(tilt_deg: float, sign: float = 1.0) -> Calibration:
        down = (float(np.sin(np.radians(tilt_deg))), 0.0, sign * float(np.cos(np.radians(tilt_deg))))
        return PinholeCalibrator(PinholeCalibratorOptions(**options, gravity=down)).calibrate(boards)

    flat, tilted = with_gravity(0.0), with_gravity(10.0)
    assert flat.parameters["belt_per_mm"] == pytest.approx(from_pose.parameters["belt_per_mm"], abs=5e-5)
    normal = tilted.parameters["belt_per_mm"] / np.linalg.norm(tilted.parameters["belt_per_mm"])
    assert np.degrees(np.arcsin(normal[0])) == pytest.approx(10.0, abs=1e-6)
    # heights begin at the board's middle, whose image is the mean of its marks'
    middle_px = find_marks(boards.observations[0].frame, boards.boards[0]).xy_px.mean(axis=0)
    ray = (middle_px - flat.parameters["principal_px"]) / flat.parameters["focal_px"]
    depth_mm = 1.0 / (np.append(ray, 1.0) @ tilted.parameters["belt_per_mm"])
    assert depth_mm == pytest.approx(1.0 / flat.parameters["belt_per_mm"][2], abs=0.1)
    assert depth_mm == pytest.approx(
        1.0 / (np.append(ray, 1.0) @ from_pose.parameters["belt_per_mm"]), abs=0.1
    )
    # a direction that is uncertain by 0.2° makes the plane uncertain by that
    at = slice(-3, None)
    angle = np.sqrt(tilted.covariance[at, at].diagonal()) / np.linalg.norm(tilted.parameters["belt_per_mm"])
    assert np.degrees(angle[1]) == pytest.approx(0.2, abs=0.1)
    with pytest.raises(CalibrationError, match="does not look down"):
        with_gravity(10.0, sign=-1.0)


def test_the_camera_of_a_calibration_is_known_to_another(
    from_pose: Calibration, boards: CalibrationSet, tmp_path: Path
) -> None:
    from_pose.save(tmp_path / "first.yaml")
    assert Calibration.load(tmp_path / "first.yaml").reference == ON_BOARD
    assert read_camera(tmp_path / "first.yaml") == pytest.approx(camera_of(from_pose.parameters))
    options = PinholeCalibratorOptions(reference_pose="pose 0", camera=tmp_path / "first.yaml")
    again = PinholeCalibrator(options).calibrate(boards)
    assert again.parameters["focal_px"] == pytest.approx(from_pose.parameters["focal_px"], abs=1e-9)


def test_the_camera_alone(boards: CalibrationSet) -> None:
    rig = LinearRig()
    plain = replace(boards, observations=tuple(o for o in boards.observations if o.frame.role == "plain"))
    found = PinholeCalibrator(PinholeCalibratorOptions(lens="none")).camera(plain)
    true_px = 300.0 / rig.mm_per_px
    assert found.images == 8
    assert (np.abs(found.focal_px - true_px) < 4.0 * found.std[:2]).all()
    assert (found.std[:2] < 0.005 * true_px).all()
    assert found.rms_px < 0.1


def test_a_camera_whose_focus_drifts_is_less_certain(boards: CalibrationSet) -> None:
    """Each image is larger than the one before by 0.4 %: no single focal length is that of all."""
    plain = [one for one in boards.observations if one.frame.role == "plain"]
    plain += [replace(one, pose=f"again {one.pose}") for one in plain]

    def focal_std(step: float) -> float:
        drifting = []
        for number, one in enumerate(plain):
            rows, columns = one.frame.size
            scale = 1.0 + step * (number - 7.5)
            move = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), 0.0, scale)
            how = {"flags": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REPLICATE}
            pixels = cv2.warpAffine(one.frame.pixels, move, (columns, rows), **how)
            drifting.append(replace(one, frame=replace(one.frame, pixels=pixels)))
        found = PinholeCalibrator(PinholeCalibratorOptions(lens="none")).camera(
            replace(boards, observations=tuple(drifting))
        )
        return float(found.std[0])

    assert focal_std(0.004) > 2.0 * focal_std(0.0)


def test_a_board_that_moved_between_its_images_makes_two_poses(boards: CalibrationSet) -> None:
    observations = list(boards.observations)
    last = max(n for n, one in enumerate(observations) if one.frame.role == "plain")
    moved = np.roll(observations[last].frame.pixels, 6, axis=1)
    observations[last] = replace(observations[last], frame=replace(observations[last].frame, pixels=moved))
    set_of = replace(boards, observations=tuple(observations))
    made = PinholeCalibrator(PinholeCalibratorOptions(reference_pose="pose 0")).calibrate(set_of)
    said = [note for note in made.notes if "taken for two poses" in note]
    assert len(said) == 1, made.notes
    assert "moved by 6.0 px" in said[0]


@pytest.mark.parametrize("way", [(0, 1), (0, -1), (1, 0), (-1, 0)])
def test_a_board_that_moved_by_a_pixel_darkens_some_of_its_edges(
    boards: CalibrationSet, way: tuple[int, int]
) -> None:
    plain, laser = (one.frame for one in boards.observations[-2:])
    assert (plain.role, laser.role) == ("plain", "laser")
    marks = find_marks(plain, boards.boards[0])
    assert plain_is_under(plain, laser, marks)
    assert not plain_is_under(replace(plain, pixels=np.roll(plain.pixels, way, (0, 1))), laser, marks)


def test_camera_only_writes_a_file_of_opencvs(boards: CalibrationSet, tmp_path: Path) -> None:
    for number, one in enumerate(o for o in boards.observations if o.frame.role == "plain"):
        cv2.imwrite(str(tmp_path / f"board_{number}.png"), one.frame.pixels)
    (tmp_path / "rig.yaml").write_text(
        "roemetry_rig: 1\nname: no laser at all\nimages: {board: ['board_*.png']}\n"
        "board: {kind: chessboard, name: b, columns: 9, rows: 6, pitch_mm: 5.5}\n"
        "calibrator: {use: pinhole-plane, options: {lens: none}}\n",
        "utf-8",
    )
    done = typed("calibrate", tmp_path / "rig.yaml", "--camera-only")
    assert "camera from 8 images" in done.output
    assert read_camera(tmp_path / "camera.yaml")[:2] == pytest.approx(1200.0, rel=0.005)
