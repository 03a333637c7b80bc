"""Camera and planes of light from files: only the belt is looked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.errors import CalibrationError, ConfigurationError, DataError
from roemetry.records.calibration import Calibration
from roemetry.records.view import write_camera
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.known_files import read_camera, read_planes
from roemetry_pinhole.pinhole_plane import camera_of, lines_at_height, view_of
from tests.command import typed


def write_planes(path: Path, planes: np.ndarray) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("planes", planes)
    storage.release()


def files(calibrated: Calibration, folder: Path, *, sign: float = 1.0) -> dict[str, object]:
    """The camera, and planes with D = −sign, written by OpenCV itself."""
    camera, planes = folder / "camera.yaml", folder / "planes.yaml"
    assert calibrated.view is not None
    write_camera(camera, calibrated.view)
    p = calibrated.parameters["planes_per_mm"]
    size = np.linalg.norm(p, axis=1)[:, None]
    write_planes(planes, np.column_stack([p / size, -sign / size]))
    return {"camera": camera, "planes": planes, "height_max_mm": 20.0}


@pytest.mark.parametrize(("sign", "form"), [(1.0, "Ax+By+Cz+D=0"), (-1.0, "Ax+By+Cz-D=0")])
def test_the_belt_is_found_in_either_form(calibrated, belt, tmp_path: Path, sign: float, form: str) -> None:
    options = PinholeCalibratorOptions(**files(calibrated, tmp_path, sign=sign), planes_form=form)
    found = PinholeCalibrator(options).calibrate(belt)
    assert found.parameters["planes_per_mm"] == pytest.approx(
        calibrated.parameters["planes_per_mm"], rel=1e-9
    )
    away = [1.0 / np.linalg.norm(one.parameters["belt_per_mm"]) for one in (found, calibrated)]
    assert away[0] == pytest.approx(away[1], rel=2e-3)
    assert found.height_range_mm == (0.0, 20.0)
    assert any("taken as exact" in note for note in found.notes)
    size = found.covariance.shape[0]
    assert not found.covariance[: size - 3, : size - 3].any(), "nothing is stated of what was read"
    assert (np.diag(found.covariance)[-3:] > 0).all()


def test_what_the_planes_are_uncertain_by_is_in_the_heights(calibrated, belt, tmp_path: Path, rng) -> None:
    """Each plane leaned or moved by its standard uncertainty, in a file; squares of heights' changes."""
    angle_deg, offset_mm = 0.004, 0.003
    given = files(calibrated, tmp_path)
    options = {**given, "planes_angle_std_deg": angle_deg, "planes_offset_std_mm": offset_mm}
    stated = PinholeCalibrator(PinholeCalibratorOptions(**options)).calibrate(belt)
    assert any("each uncertain by 0.003 mm" in note for note in stated.notes)
    exact = PinholeCalibrator(PinholeCalibratorOptions(**given)).calibrate(belt)
    row = np.array([60.0, 140.0])
    x = lines_at_height(exact.parameters, row, 10.0)
    stripe, at = np.nonzero(np.isfinite(x))
    places = np.column_stack([x[stripe, at], row[at]])

    def heights(one: Calibration) -> np.ndarray:
        return view_of(one.parameters, one.image_size).lift(places, stripe)[:, 2]

    squares = np.zeros(stripe.size)
    true = calibrated.parameters["planes_per_mm"]
    middle = lines_at_height(calibrated.parameters, np.array([99.5]), 0.0)[:, 0]
    for moved in range(len(true)):
        place = in_camera(calibrated, middle[moved], 99.5)
        place -= (true[moved] @ place - 1.0) / (true[moved] @ true[moved]) * true[moved]
        normal = true[moved] / np.linalg.norm(true[moved])
        ways = np.linalg.svd(normal[None])[2][1:]
        for lean, off in ((ways[0], 0.0), (ways[1], 0.0), (0.0 * normal, offset_mm)):
            rows = np.column_stack([true, np.full(len(true), -1.0)])
            leaned = normal + np.radians(angle_deg) * lean
            rows[moved] = [*leaned, -(leaned @ place + off)]
            write_planes(given["planes"], rows)
            other = PinholeCalibrator(PinholeCalibratorOptions(**given)).calibrate(belt)
            squares += (heights(other) - heights(exact)) ** 2
    only = replace(stated, covariance=stated.covariance - exact.covariance)
    redraws = only.redraws(rng)
    std = np.std([heights(next(redraws)) for _ in range(600)], axis=0)
    assert np.median(std / np.sqrt(squares)) == pytest.approx(1.0, abs=0.05)
    assert std / np.sqrt(squares) == pytest.approx(1.0, abs=0.2)


def in_camera(calibrated: Calibration, x_px: float, row_px: float) -> np.ndarray:
    """Where a place on the belt is, camera frame, mm."""
    ray = np.array([x_px, row_px, 1.0])
    ray[:2] = (ray[:2] - calibrated.parameters["principal_px"]) / calibrated.parameters["focal_px"]
    return ray / (ray @ calibrated.parameters["belt_per_mm"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"planes_form": "Ax+By+Cz-D=0"}, "behind the camera"),
        ({"camera": None}, "without the camera"),
        ({"height_max_mm": None}, "up to which height"),
    ],
)
def test_what_cannot_be_is_refused(
    calibrated, belt, tmp_path: Path, change: dict[str, object], says: str
) -> None:
    options = PinholeCalibratorOptions(**(files(calibrated, tmp_path) | change))
    with pytest.raises(CalibrationError, match=says) as caught:
        PinholeCalibrator(options).calibrate(belt)
    assert caught.value.hint


def test_another_number_of_planes_and_no_belt(calibrated, belt, boards, tmp_path: Path) -> None:
    method = PinholeCalibrator(PinholeCalibratorOptions(**files(calibrated, tmp_path)))
    with pytest.raises(CalibrationError, match="planes holds"):
        method.calibrate(replace(belt, stripe_count=belt.stripe_count + 1))
    with pytest.raises(CalibrationError, match="where the belt is"):
        method.calibrate(boards)
    path = tmp_path / "through.yaml"
    write_planes(path, np.array([[1.0, 0.0, 0.2, 0.0]]))
    with pytest.raises(DataError, match=r"through\.yaml: the plane goes through"):
        read_planes(path)


def test_the_command_line_writes_what_is_read_back(calibrated, belt, tmp_path: Path) -> None:
    """From a calibration file to OpenCV's and back: the same camera, the same planes."""
    calibrated.save(tmp_path / "line.yaml")
    done = typed("export", tmp_path / "line.yaml", "opencv")
    written = tmp_path / "line-opencv.yaml"
    assert str(written) in done.output
    assert read_camera(written) == pytest.approx(camera_of(calibrated.parameters), rel=1e-12)
    assert read_planes(written) == pytest.approx(calibrated.parameters["planes_per_mm"], rel=1e-9)
    options = PinholeCalibratorOptions(camera=written, planes=written, height_max_mm=20.0)
    again = PinholeCalibrator(options).calibrate(belt).parameters["planes_per_mm"]
    assert again == pytest.approx(calibrated.parameters["planes_per_mm"], rel=1e-9)
    typed("export", tmp_path / "line.yaml", "opencv", "-o", tmp_path / "c.xml")
    assert read_camera(tmp_path / "c.xml") == pytest.approx(camera_of(calibrated.parameters), rel=1e-12)


def test_what_cannot_be_written_is_told(calibrated, tmp_path: Path) -> None:
    calibrated.save(tmp_path / "line.yaml")
    LinearRig().calibration().save(tmp_path / "block.yaml")
    replace(calibrated, view=replace(calibrated.view, exact=False)).save(tmp_path / "rough.yaml")
    for words, kind, says in (
        (["line.yaml", "parquet"], ConfigurationError, "only `opencv` can be written, not `parquet`"),
        (["block.yaml", "opencv"], CalibrationError, "knows no camera"),
        (["rough.yaml", "opencv"], CalibrationError, "knows no camera"),
        (["line.yaml", "opencv", "-o", str(tmp_path / "c.txt")], DataError, "cannot be written"),
        (["line.yaml", "opencv", "-o", str(tmp_path / "no" / "c.yaml")], DataError, "cannot be written"),
    ):
        done = typed("export", tmp_path / words[0], *words[1:], code=1)
        assert isinstance(done.exception, kind), words
        assert says in str(done.exception)
