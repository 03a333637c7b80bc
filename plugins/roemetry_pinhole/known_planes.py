"""Planes of light that are known beforehand: only the belt is looked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roemetry.arrays import Floats
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet
from roemetry_pinhole.adjustment import Adjusted
from roemetry_pinhole.equations import Corners, Feet
from roemetry_pinhole.geometry import CAMERA, Geometry, unknowns_of
from roemetry_pinhole.lens import straightened
from roemetry_pinhole.measured import Measured
from roemetry_pinhole.stripe_points import belt_points

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
    xy = straightened((seen - camera[2:4]) / camera[:2], camera[4:])[0]
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
