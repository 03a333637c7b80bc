"""Cameras and planes of light that are known from files.

OpenCV's camera files: a matrix and distortion coefficients, YAML, JSON or XML.

Planes of light that are known beforehand: only the belt is looked for.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from roemetry.errors import CalibrationError, DataError
from roemetry.records import CalibrationSet
from roemetry.records.arrays import Floats
from roemetry_pinhole.bundle import Adjusted, Measured
from roemetry_pinhole.equations import Corners, Feet
from roemetry_pinhole.geometry import CAMERA, Geometry, undistort, unknowns_of
from roemetry_pinhole.stripes import belt_points

_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "intrinsics")
_LENS = ("distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "dist_coeffs", "D")
_PLANES = ("planes", "laser_planes")


def read_camera(path: Path) -> Floats:
    """Give (12,) fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 from a file that OpenCV wrote.

    Raises
    ------
    DataError
        There is no such file, or it holds no camera matrix, or a lens model this program does not know.
    """
    storage = _opened(path)
    try:
        matrix, lens = _first(storage, _MATRIX), _first(storage, _LENS)
    finally:
        storage.release()
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

    Parameters
    ----------
    path
        YAML, JSON or XML as OpenCV writes it.
    sign
        1 where the rows mean Ax + By + Cz + D = 0, −1 where they mean Ax + By + Cz − D = 0.

    Raises
    ------
    DataError
        There are no such rows, or a plane goes through the camera's centre.
    """
    storage = _opened(path)
    try:
        rows = _first(storage, _PLANES)
    finally:
        storage.release()
    if rows is None or rows.ndim != 2 or rows.shape[1] != 4:
        raise DataError(f"{path}: there are no planes here: rows of A, B, C, D named `planes`")
    try:
        return np.stack([plane_from(*row, sign=sign) for row in rows.tolist()])
    except DataError as error:
        raise DataError(f"{path}: {error.message}") from error


def _opened(path: Path):  # type: ignore[no-untyped-def]  # noqa: ANN202
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError) as error:
        raise DataError(f"{path}: not a file that OpenCV wrote") from error
    if not storage.isOpened():
        raise DataError(f"{path}: the file cannot be read, or OpenCV did not write it")
    return storage


def _first(storage, names: tuple[str, ...]) -> Floats | None:  # type: ignore[no-untyped-def]  # noqa: ANN001
    for name in names:
        node = storage.getNode(name)
        if not node.empty():
            found = node.mat()
            if found is not None:
                return np.asarray(found, np.float64)
    return None


_OFF_MAX_PX = 3.0


def with_known_planes(observed: CalibrationSet, camera: Floats, planes: Floats) -> Measured:
    """Give the belt's stripes, to be adjusted with camera and planes as they are.

    Parameters
    ----------
    observed
        With images of the empty belt.
    camera
        (12,)
    planes
        (stripe, 3) p·X = 1, 1/mm, from left to right.

    Raises
    ------
    CalibrationError
        Another number of planes than stripes, one stripe alone, no image of the belt, or the stripes on it
        do not lie where the planes could meet one belt.
    """
    if len(planes) != observed.stripe_count:
        raise CalibrationError(
            f"the file of planes holds {len(planes)}, the rig has {observed.stripe_count} stripes",
            hint="give a row A, B, C, D for each stripe, from left to right",
        )
    if len(planes) < 2 or not observed.showing("belt"):
        raise CalibrationError(
            "nothing shows where the belt is",
            hint="with known planes, name images of the empty belt in images.belt; with a single stripe they "
            "do not tell its tilt: calibrate with boards",
        )
    points, belt = belt_points(observed.showing("belt"), camera, planes)
    start = Geometry(camera, np.empty((0, 3, 3)), np.empty((0, 3)), planes, belt, np.zeros(3))
    unknowns = unknowns_of(
        start, free_camera=np.zeros(CAMERA, np.bool_), planes=False, belt=True, travel=False
    )
    none, whole = np.empty(0), np.empty(0, np.int64)
    corners = Corners(whole, np.empty((0, 3)), np.empty((0, 2)), none)
    measured = Measured(start, unknowns, corners, points, Feet(whole, np.empty((0, 3)), none), 0.01)
    hint = "are they in the camera's frame, in mm, from left to right, and is `planes_form` right?"
    if belt[2] <= 0:
        raise CalibrationError("by the known planes the belt is behind the camera", hint=hint)
    off_px = float(np.median(np.abs(measured.adjusted().stripe_px)))
    if off_px > _OFF_MAX_PX:
        raise CalibrationError(
            f"the known planes meet no belt where the stripes are: those are off by {off_px:.1f} px",
            hint=hint,
        )
    return measured


def of_planes(measured: Measured, found: Adjusted, angle_std_deg: float, offset_std_mm: float) -> Floats:
    """Give the covariance, of planes and belt, that the known planes' own uncertainty makes.

    Each plane may lean about two axes through the middle of its stripe on the belt, and lie beside that
    place, all on their own; the belt follows, since it is where the planes and the stripes on it meet.

    Parameters
    ----------
    measured, found
        The adjustment of the belt.
    angle_std_deg, offset_std_mm
        Standard uncertainty of each plane's direction about either axis, and of its place along its normal.

    Returns
    -------
    ndarray
        (3 stripe + 3, 3 stripe + 3) of `planes_per_mm` and `belt_per_mm`, flattened.
    """
    before = found.geometry
    mean = np.concatenate([before.planes.ravel(), measured.stepped(found).belt])
    covariance = np.zeros((mean.size, mean.size))
    for stripe, plane in enumerate(before.planes):
        middle = _middle(measured, before, stripe)
        for moved in _moved(plane, middle, np.radians(angle_std_deg), offset_std_mm):
            planes = before.planes.copy()
            planes[stripe] = moved
            there = replace(found, geometry=replace(before, planes=planes))
            way = np.concatenate([planes.ravel(), measured.stepped(there).belt]) - mean
            covariance += np.outer(way, way)
    return covariance


def _middle(measured: Measured, geometry: Geometry, stripe: int) -> Floats:
    """Where a stripe's plane passes the middle of its line on the bare belt, camera frame, mm."""
    mine = measured.points.stripe == stripe
    seen = np.array([[measured.points.x_px[mine].mean(), measured.points.row_px[mine].mean()]])
    camera = geometry.camera
    xy = undistort((seen - camera[2:4]) / camera[:2], camera[4:])[0]
    ray = np.array([*xy, 1.0])
    place = ray / (ray @ geometry.belt)
    plane = geometry.planes[stripe]
    return np.asarray(place - (plane @ place - 1.0) / (plane @ plane) * plane)


def _moved(plane: Floats, middle: Floats, angle: float, offset_mm: float) -> tuple[Floats, Floats, Floats]:
    """Give p·X = 1 leaned about two axes through a place on it, and moved along its normal."""
    normal = plane / np.sqrt(plane @ plane)
    one = np.cross(normal, [0.0, 1.0, 0.0])
    one /= np.sqrt(one @ one)
    lean = [normal + angle * way for way in (one, np.cross(normal, one))]
    return lean[0] / (lean[0] @ middle), lean[1] / (lean[1] @ middle), normal / (normal @ middle + offset_mm)
