"""The unknowns of a calibration: camera, poses of the board, planes of light, belt, travel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from roemetry.arrays import Flags, Floats, Integers
from roemetry_pinhole.bending import BENDS, Bend
from roemetry_pinhole.lens import COEFFICIENTS

CAMERA = 4 + COEFFICIENTS
"""fx, fy, cx, cy (px), then the lens's coefficients."""


@dataclass(frozen=True, eq=False, slots=True)
class Geometry:
    """Everything the adjustment finds. Lengths in mm, all in the camera's frame.

    Attributes
    ----------
    camera
        (12,) fx, fy, cx, cy, px; k1, k2, p1, p2, k3, k4, k5, k6.
    rotation, shift
        (pose, 3, 3) and (pose, 3): to the camera's frame from the board's.
    planes
        (stripe, 3) p with p·X = 1, 1/mm: normal over distance. It cannot hold a plane through the camera's
        centre, and such a plane measures nothing.
    belt
        (3,) the same of the belt; NaN where it is not asked for.
    travel
        (3,) way of the belt per encoder count, mm; 0 where it is not asked for.
    bend
        Shape of the board's print; None where it is taken to be flat.
    """

    camera: Floats
    rotation: Floats
    shift: Floats
    planes: Floats
    belt: Floats
    travel: Floats
    bend: Bend | None = None

    @property
    def stripe_count(self) -> int:
        """Number of planes of light."""
        return int(self.planes.shape[0])


@dataclass(frozen=True, eq=False, slots=True)
class Unknowns:
    """Where each unknown stands in the vector of parameters; −1 for what is held fixed.

    Attributes
    ----------
    camera
        (12,)
    planes
        (stripe, 3)
    belt, travel
        (3,)
    poses
        (pose, 6) turn about the camera's axes, rad, then shift, mm.
    bend
        (12,) of the board's shape, mm; (0,) where it is taken to be flat.
    """

    camera: Integers
    planes: Integers
    belt: Integers
    travel: Integers
    poses: Integers
    bend: Integers = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def count(self) -> int:
        """Number of unknowns."""
        parts = (self.camera, self.planes.ravel(), self.belt, self.travel, self.poses.ravel(), self.bend)
        return int(np.concatenate(parts).max()) + 1

    def moved(self, geometry: Geometry, step: Floats) -> Geometry:
        """Give the geometry after a step of the unknowns."""
        turn = _part(step, self.poses[:, :3])
        bend = geometry.bend
        if bend is not None and self.bend.size:
            bend = bend.moved(_part(step, self.bend))
        return replace(
            geometry,
            camera=geometry.camera + _part(step, self.camera),
            planes=geometry.planes + _part(step, self.planes),
            belt=geometry.belt + _part(step, self.belt),
            travel=geometry.travel + _part(step, self.travel),
            rotation=turned(turn) @ geometry.rotation,
            shift=geometry.shift + _part(step, self.poses[:, 3:]),
            bend=bend,
        )


def unknowns_of(
    geometry: Geometry, *, free_camera: Flags, planes: bool, belt: bool, travel: bool, bend: bool = False
) -> Unknowns:
    """Number the unknowns: the camera's first, poses last.

    Parameters
    ----------
    geometry
        For its sizes.
    free_camera
        (12,) which of the camera's numbers are looked for.
    planes, belt, travel, bend
        Whether these are looked for.
    """
    start = 0

    def numbered(free: Flags) -> Integers:
        """Give the free ones the next numbers, in their order; −1 to the others."""
        nonlocal start
        flat = np.ravel(free)
        numbers = np.where(flat, start + np.cumsum(flat) - 1, -1)
        start += int(flat.sum())
        return numbers.reshape(np.shape(free)).astype(np.int64)

    return Unknowns(
        camera=numbered(free_camera),
        planes=numbered(np.full(geometry.planes.shape, planes)),
        belt=numbered(np.full(3, belt)),
        travel=numbered(np.full(3, travel)),
        poses=numbered(np.ones((geometry.shift.shape[0], 6), np.bool_)),
        bend=numbered(np.full(BENDS if bend else 0, True)),
    )


def turned(vectors: Floats) -> Floats:
    """Give (n, 3, 3) rotations by vectors (n, 3), rad (Rodrigues)."""
    angle = np.sqrt((vectors**2).sum(axis=1))
    axis = vectors / np.where(angle > 0, angle, 1.0)[:, None]
    zero = np.zeros(angle.size)
    x, y, z = axis.T
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    rotation: Floats = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return rotation


def crossed(a: Floats, b: Floats) -> Floats:
    """Give the cross products of vectors (…, 3): numpy's to the last digit, in a third of its time."""
    made = np.empty(np.broadcast_shapes(a.shape, b.shape))
    (a0, a1, a2), (b0, b1, b2) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (a, b))
    made[..., 0] = a1 * b2 - a2 * b1
    made[..., 1] = a2 * b0 - a0 * b2
    made[..., 2] = a0 * b1 - a1 * b0
    return made


def _part(step: Floats, at: Integers) -> Floats:
    return np.where(at >= 0, step[np.maximum(at, 0)], 0.0)
