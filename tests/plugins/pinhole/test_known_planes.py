"""Camera and planes of light from files: only the belt is looked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roemetry.calibration import Calibration
from roemetry.errors import CalibrationError, DataError
from roemetry.records import CalibrationSet
from roemetry.testing import LinearRig
from roemetry_pinhole.calibrator import PinholeCalibrator, PinholeCalibratorOptions
from roemetry_pinhole.conformance import observed_of
from roemetry_pinhole.opencv_file import read_planes, write_camera


@pytest.fixture(scope="module")
def made() -> Calibration:
    return PinholeCalibrator().calibrate(observed_of(LinearRig()))


@pytest.fixture(scope="module")
def belt() -> CalibrationSet:
    observed = observed_of(LinearRig())
    only = tuple(one for one in observed.observations if one.shows == "belt")
    return replace(observed, observations=only, board=None)


def files(made: Calibration, folder: Path, *, sign: float = 1.0) -> dict[str, object]:
    """The camera, and planes with D = −sign, written by OpenCV itself."""
    camera, planes = folder / "camera.yaml", folder / "planes.yaml"
    assert made.view is not None
    write_camera(camera, made.view)
    p = made.parameters["planes_per_mm"]
    size = np.linalg.norm(p, axis=1)[:, None]
    storage = cv2.FileStorage(str(planes), cv2.FILE_STORAGE_WRITE)
    storage.write("planes", np.column_stack([p / size, -sign / size]))
    storage.release()
    return {"camera": camera, "planes": planes, "height_max_mm": 20.0}


@pytest.mark.parametrize(("sign", "form"), [(1.0, "Ax+By+Cz+D=0"), (-1.0, "Ax+By+Cz-D=0")])
def test_the_belt_is_found_in_either_form(made, belt, tmp_path: Path, sign: float, form: str) -> None:
    options = PinholeCalibratorOptions(**files(made, tmp_path, sign=sign), planes_form=form)
    found = PinholeCalibrator(options).calibrate(belt)
    assert found.parameters["planes_per_mm"] == pytest.approx(made.parameters["planes_per_mm"], rel=1e-9)
    away = [1.0 / np.linalg.norm(one.parameters["belt_per_mm"]) for one in (found, made)]
    assert away[0] == pytest.approx(away[1], rel=2e-3)
    assert found.height_range_mm == (0.0, 20.0)
    assert any("taken as exact" in note for note in found.notes)
    size = found.covariance.shape[0]
    assert not found.covariance[: size - 3, : size - 3].any(), "nothing is stated of what was read"
    assert (np.diag(found.covariance)[-3:] > 0).all()


def test_what_is_written_is_what_is_read(made, tmp_path: Path) -> None:
    """`write_camera` puts the planes into the same file, in the camera's frame."""
    path = tmp_path / "camera.yaml"
    assert made.view is not None
    write_camera(path, made.view)
    assert read_planes(path) == pytest.approx(made.parameters["planes_per_mm"], rel=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"planes_form": "Ax+By+Cz-D=0"}, "behind the camera"),
        ({"camera": None}, "without the camera"),
        ({"height_max_mm": None}, "up to which height"),
    ],
)
def test_what_cannot_be_is_refused(made, belt, tmp_path: Path, change: dict[str, object], says: str) -> None:
    options = PinholeCalibratorOptions(**(files(made, tmp_path) | change))
    with pytest.raises(CalibrationError, match=says) as caught:
        PinholeCalibrator(options).calibrate(belt)
    assert caught.value.hint


def test_another_number_of_planes_and_no_belt(made, belt, tmp_path: Path) -> None:
    method = PinholeCalibrator(PinholeCalibratorOptions(**files(made, tmp_path)))
    with pytest.raises(CalibrationError, match="planes holds"):
        method.calibrate(replace(belt, stripe_count=belt.stripe_count + 1))
    observed = observed_of(LinearRig())
    boards = tuple(one for one in observed.observations if one.shows != "belt")
    with pytest.raises(CalibrationError, match="where the belt is"):
        method.calibrate(replace(observed, observations=boards))


def test_a_plane_through_the_camera_is_told_with_its_file(tmp_path: Path) -> None:
    path = tmp_path / "planes.yaml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("planes", np.array([[1.0, 0.0, 0.2, 0.0]]))
    storage.release()
    with pytest.raises(DataError, match=r"planes\.yaml: the plane goes through"):
        read_planes(path)
