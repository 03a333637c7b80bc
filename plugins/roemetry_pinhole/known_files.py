"""A camera and planes of light that are known, from files.

OpenCV's (YAML, JSON or XML): a camera matrix with distortion coefficients, and rows A, B, C, D of planes in
the camera's frame, mm. Or a calibration of ours, for its camera.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from roemetry.errors import DataError
from roemetry.records.arrays import Floats
from roemetry.records.calibration import Calibration
from roemetry_pinhole.geometry import CAMERA
from roemetry_pinhole.pinhole_plane import camera_of

_HEAD_LINES = 10  # comments may stand above the first key

_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "intrinsics")
_LENS = ("distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "dist_coeffs", "D")
_PLANES = ("planes", "laser_planes")


def read_camera(path: Path) -> Floats:
    """Give (12,) fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 from OpenCV's file or a calibration of ours.

    Raises
    ------
    DataError
        There is no such file, or it holds no camera matrix, or a lens model this program does not know.
    """
    try:
        with path.open(encoding="utf-8") as file:
            head = list(itertools.islice(file, _HEAD_LINES))
    except (OSError, UnicodeDecodeError):
        head = []  # OpenCV says what is wrong with it
    if any(line.startswith("roemetry_calibration") for line in head):
        parameters = Calibration.load(path).parameters
        if not {"focal_px", "principal_px", "distortion"} <= set(parameters):
            raise DataError(
                f"{path}: this calibration holds no pinhole camera",
                hint="one of the calibrator pinhole-plane does, and so does a file of OpenCV's",
            )
        return camera_of(parameters)
    matrix, lens = _matrices(path, _MATRIX, _LENS)
    if matrix is None or matrix.shape != (3, 3):
        raise DataError(f"{path}: there is no 3 × 3 camera matrix here ({', '.join(_MATRIX)})")
    if abs(matrix[0, 1]) > 1e-9:
        raise DataError(f"{path}: the camera matrix has a skew of {matrix[0, 1]:g}; square axes are expected")
    numbers = np.zeros(0) if lens is None else np.ravel(lens)
    if numbers.size > 8 and numbers[8:].any():
        raise DataError(
            f"{path}: there are {numbers.size} distortion coefficients; up to 8 are known here",
            hint="calibrate with k1, k2, p1, p2, k3 (and k4, k5, k6)",
        )
    camera = np.zeros(CAMERA)
    camera[:4] = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    camera[4 : 4 + min(numbers.size, 8)] = numbers[:8]
    return camera


def plane_from(a: float, b: float, c: float, d: float, *, sign: int) -> Floats:
    """Give (3,) p·X = 1 from Ax + By + Cz + D = 0 (`sign` = 1) or Ax + By + Cz = D (`sign` = −1), mm.

    Raises
    ------
    DataError
        The plane goes through the origin, the camera's centre: it measures nothing.
    """
    distance = -sign * d
    size = float(np.sqrt(a * a + b * b + c * c))
    if size == 0.0 or abs(distance) < 1e-9 * size:
        raise DataError("the plane goes through the camera's centre, or has no direction")
    return np.array([a, b, c], np.float64) / distance


def read_planes(path: Path, *, sign: int = 1) -> Floats:
    """Give (stripe, 3) p·X = 1 from rows A, B, C, D named `planes` or `laser_planes`, camera frame, mm.

    `sign` is 1 where the rows mean Ax + By + Cz + D = 0, −1 where they mean Ax + By + Cz − D = 0. Raises
    DataError: there are no such rows, or a plane goes through the camera's centre.
    """
    (rows,) = _matrices(path, _PLANES)
    if rows is None or rows.ndim != 2 or rows.shape[1] != 4:
        raise DataError(f"{path}: there are no planes here: rows of A, B, C, D named `planes`")
    try:
        return np.stack([plane_from(*row, sign=sign) for row in rows.tolist()])
    except DataError as error:
        raise DataError(f"{path}: {error.message}") from error


def _matrices(path: Path, *wanted: tuple[str, ...]) -> list[Floats | None]:
    """Give the first matrix of a file that has one of the names wanted, for each of these; None: none has."""
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError) as error:
        raise DataError(f"{path}: not a file that OpenCV wrote") from error
    if not storage.isOpened():
        raise DataError(f"{path}: the file cannot be read, or OpenCV did not write it")
    try:
        found = [
            next((one for name in names if (one := storage.getNode(name).mat()) is not None), None)
            for names in wanted
        ]
    finally:
        storage.release()
    return [None if one is None else np.asarray(one, np.float64) for one in found]
