"""Views kept out of the adjustment, and what the calibration that never saw them says of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry.errors import CalibrationError
from roemetry_pinhole.bending import Bend
from roemetry_pinhole.equations import ON_BELT, Feet, StripePoints, corner_residuals
from roemetry_pinhole.geometry import CAMERA, Geometry, unknowns_of
from roemetry_pinhole.lens import straightened
from roemetry_pinhole.measured import Measured, chosen

_FOLDS = 5
_POSES_MIN = 4


@dataclass(frozen=True, eq=False, slots=True)
class HeldOut:
    """Errors of a calibration at views it did not know.

    Attributes
    ----------
    mark_px, mark_at_px
        (mark, 2) seen less predicted, and where; each board's pose is found from its own marks.
    mark_pose
        (mark,) pose.
    height_mm, height_at_px
        (point,) measured less true height, along the belt's normal, of stripe points on the held-out boards,
        whose marks say where they are; and (point, 2) where in the image.
    height_pose, height_stripe
        (point,) pose and stripe.
    skipped
        Poses that cannot be spared: without them the rest determines no calibration.
    """

    mark_px: Floats
    mark_at_px: Floats
    mark_pose: Integers
    height_mm: Floats
    height_at_px: Floats
    height_pose: Integers
    height_stripe: Integers
    skipped: int


def held_out(measured: Measured, found: Geometry) -> HeldOut:
    """Leave every fifth pose out in turn; boards that lie on the belt always stay.

    Parameters
    ----------
    measured
        All that was seen.
    found
        What the adjustment of all found: a start for those of less.
    """
    poses = np.unique(measured.corners.pose)
    spare = np.setdiff1d(poses, measured.feet.pose)
    folds = min(_FOLDS, spare.size)
    marks: list[tuple[Any, ...]] = []
    heights: list[tuple[Any, ...]] = []
    skipped = 0
    for fold in range(folds):
        out = spare[fold::folds]
        kept = np.setdiff1d(poses, out)
        try:
            geometry = _calibrated(measured, kept, found)
        except CalibrationError:
            skipped += out.size
            continue
        for pose in out:
            board = _resected(measured, int(pose), replace(found, camera=geometry.camera, bend=geometry.bend))
            mine = chosen(measured.corners, measured.corners.pose == pose, np.array([pose]))
            off = -corner_residuals(board, mine).reshape(-1, 2)
            marks.append((off, mine.xy_px, np.full(len(off), pose)))
            points = chosen(measured.points, measured.points.pose == pose)
            at = np.column_stack([points.x_px, points.row_px])
            heights.append((_heights(geometry, board, points), at, points.pose, points.stripe))
    none, both, whole = np.empty(0), np.empty((0, 2)), np.empty(0, np.int64)
    mark_px, mark_at_px, mark_pose = _joined((both, both, whole), marks)
    height_mm, height_at_px, height_pose, stripe = _joined((none, both, whole, whole), heights)
    return HeldOut(
        mark_px, mark_at_px, mark_pose, height_mm, height_at_px, height_pose, stripe, skipped=skipped
    )


def _joined(nothing: tuple[Any, ...], parts: list[tuple[Any, ...]]) -> list[Any]:
    """Put parts one behind the other, column by column."""
    return [np.concatenate(column) for column in zip(nothing, *parts, strict=True)]


def lifted(geometry: Geometry, points: StripePoints) -> Floats:
    """Give (point, 3) where the points' rays meet their planes of light, camera frame, mm."""
    seen = np.column_stack([points.x_px, points.row_px])
    xy = straightened((seen - geometry.camera[2:4]) / geometry.camera[:2], geometry.camera[4:])
    ray = np.column_stack([xy, np.ones(len(xy))])
    return np.asarray(ray / (ray * geometry.planes[points.stripe]).sum(axis=1)[:, None])


def _calibrated(measured: Measured, kept: Integers, found: Geometry) -> Geometry:
    """Adjust without the others; raise CalibrationError where a stripe or the lens is then not determined."""
    if kept.size < _POSES_MIN:
        raise CalibrationError(f"{kept.size} poses are left")
    less = measured.of(kept, found)
    for stripe in range(found.stripe_count):
        if np.unique(less.points.pose[less.points.stripe == stripe]).size < 2:
            raise CalibrationError(f"stripe {stripe + 1} is left on one surface")
    return less.adjusted().geometry


def _resected(measured: Measured, pose: int, start: Geometry) -> Geometry:
    """Find one board's pose from its own marks with a given camera."""
    alone = measured.of(np.array([pose]), start)
    nothing = np.zeros(alone.points.pose.size, np.bool_)
    unknowns = unknowns_of(
        alone.start, free_camera=np.zeros(CAMERA, np.bool_), planes=False, belt=False, travel=False
    )
    nobody = Feet(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0))
    only = replace(alone, unknowns=unknowns, points=chosen(alone.points, nothing), feet=nobody)
    return only.adjusted().geometry


def _heights(geometry: Geometry, board: Geometry, points: StripePoints) -> Floats:
    """Heights over the board's surface along the belt's normal, mm."""
    normal, place = board.rotation[0][:, 2], board.shift[0] + points.counts[:, None] * geometry.travel
    up = -geometry.belt / np.sqrt(geometry.belt @ geometry.belt)
    away = lifted(geometry, points) - place
    off = away @ normal
    if board.bend is not None:
        off = off - board.bend.height_mm((away @ board.rotation[0])[:, :2])
    return np.asarray(off / (normal @ up))


def stripe_offsets(geometry: Geometry, points: StripePoints) -> tuple[Floats, Floats, Integers]:
    """Say how far stripes are apart on one surface: a plane through all their points, each stripe's mean.

    Returns
    -------
    offset_mm, at_px, surface
        (n,) mean distance from the plane of a stripe's points on one surface, positive towards the camera;
        (n, 2) where their middle is in the image; (n,) pose of the surface, −1 of the belt.
    """
    offset, at, surface = [], [], []
    xyz = lifted(geometry, points)
    if geometry.bend is not None and points.face is None:
        xyz = xyz - _print_off_plane(geometry, geometry.bend, points, xyz)
    level = np.zeros(points.pose.size, np.int64)
    if points.face is not None:
        level = np.unique(points.face, axis=0, return_inverse=True)[1].ravel()
    for pose, number in np.unique(np.column_stack([points.pose, level]), axis=0):
        on = np.flatnonzero((points.pose == pose) & (level == number))
        stripes = np.unique(points.stripe[on])
        if stripes.size < _STRIPES_MIN or (pose == ON_BELT and np.ptp(points.counts[on]) > 0):
            continue
        middle = xyz[on].mean(axis=0)
        normal = np.linalg.svd(xyz[on] - middle, full_matrices=False)[2][2]
        normal = normal * (-1.0 if normal[2] > 0 else 1.0)
        for stripe in stripes:
            mine = on[points.stripe[on] == stripe]
            offset.append(float(((xyz[mine] - middle) @ normal).mean()))
            at.append([points.x_px[mine].mean(), points.row_px[mine].mean()])
            surface.append(pose)
    return np.array(offset), np.array(at).reshape(-1, 2), np.array(surface, np.int64)


def _print_off_plane(geometry: Geometry, bend: Bend, points: StripePoints, xyz: Floats) -> Floats:
    """Give (point, 3) the way from each board's plane to its print at these points; 0 on the belt."""
    way = np.zeros_like(xyz)
    on = np.flatnonzero(points.pose != ON_BELT)
    rotation, place = geometry.rotation[points.pose[on]], geometry.shift[points.pose[on]]
    place = place + points.counts[on, None] * geometry.travel
    there = ((xyz[on] - place)[:, None, :] @ rotation)[:, 0, :2]
    way[on] = bend.height_mm(there)[:, None] * rotation[:, :, 2]
    return way


_STRIPES_MIN = 4
