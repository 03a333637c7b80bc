"""Planes of light that are known beforehand: only the belt is looked for."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry.errors import CalibrationError
from roemetry.records import CalibrationSet
from roemetry_pinhole.equations import Corners, Feet
from roemetry_pinhole.geometry import CAMERA, Geometry, unknowns_of
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
