"""Unknowns of a calibration: camera and lens, poses, planes of light, belt, travel, the board's shape.

Lens distortion in OpenCV's rational model, with its derivatives.

The shape of a board that is not flat: how far its print lies off a plane.

The unknowns of a calibration: camera, poses of the board, planes of light, belt, travel.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.lens import distort_places, undistort_places

COEFFICIENTS = 8
"""k1, k2, p1, p2, k3, k4, k5, k6: OpenCV's order."""


class Distorted(NamedTuple):
    """Distorted places (n, 2) on the plane at distance 1, and their derivatives.

    `by_place` is (n, 2, 2), `by_coefficient` (n, 2, 8).
    """

    xy: Floats
    by_place: Floats
    by_coefficient: Floats


def distort(xy: Floats, coefficients: Floats) -> Distorted:
    """Distort places (n, 2) by eight coefficients."""
    return Distorted(*distort_places(np.ascontiguousarray(xy), np.ascontiguousarray(coefficients)))


def undistort(places: Floats, coefficients: Floats, start: Floats | None = None) -> Floats:
    """Undistort places (n, 2) by Newton's method."""
    if not coefficients.any():
        return places
    places = np.ascontiguousarray(places)
    begin = places if start is None else np.ascontiguousarray(start)
    return np.asarray(undistort_places(places, np.ascontiguousarray(coefficients), begin))


_POWERS = np.array([(i, degree - i) for degree in (2, 3, 4) for i in range(degree, -1, -1)])
"""What is of lower order is the pose's."""
BENDS = len(_POWERS)
"""Number of coefficients."""


@dataclass(frozen=True, eq=False, slots=True)
class Bend:
    """Heights of the print over the board's plane, away from the camera.

    Attributes
    ----------
    middle_mm
        (2,) where the powers are counted from, on the board.
    reach_mm
        Length of which x and y are taken in the powers.
    coefficients_mm
        (12,) of x², xy, y², x³, … y⁴.
    """

    middle_mm: Floats
    reach_mm: float
    coefficients_mm: Floats

    @classmethod
    def none(cls, width_mm: float, height_mm: float) -> Bend:
        """Give that of a flat board of this size."""
        return cls(0.5 * np.array([width_mm, height_mm]), 0.5 * max(width_mm, height_mm), np.zeros(BENDS))

    def moved(self, step_mm: Floats) -> Bend:
        """Give it with other coefficients."""
        return replace(self, coefficients_mm=self.coefficients_mm + step_mm)

    def by_coefficient(self, place_mm: Floats) -> Floats:
        """Give (n, 12) what each coefficient adds at places (n, 2)."""
        x, y = self._powers(place_mm)
        return np.asarray((x[_POWERS[:, 0]] * y[_POWERS[:, 1]]).T)

    def height_mm(self, place_mm: Floats) -> Floats:
        """Give (n,) how far the print lies off the plane at places (n, 2)."""
        return np.asarray(self.by_coefficient(place_mm) @ self.coefficients_mm)

    def slopes(self, place_mm: Floats) -> Floats:
        """Give (n, 2) the derivatives of the height along x and y."""
        x, y = self._powers(place_mm)
        i, j = _POWERS.T
        along = (self.coefficients_mm * i) @ (x[np.maximum(i - 1, 0)] * y[j])
        down = (self.coefficients_mm * j) @ (x[i] * y[np.maximum(j - 1, 0)])
        return np.column_stack([along, down]) / self.reach_mm

    def range_mm(self) -> float:
        """Give the range of heights over the board's best plane."""
        x, y = np.meshgrid(*(middle + np.linspace(-1.0, 1.0, 21) * middle for middle in self.middle_mm))
        places = np.column_stack([x.ravel(), y.ravel()])
        height = self.height_mm(places)
        flat = np.column_stack([places, np.ones(len(places))])
        return float(np.ptp(height - flat @ np.linalg.lstsq(flat, height, rcond=None)[0]))

    def _powers(self, place_mm: Floats) -> Floats:
        """(2, 5, n) of x and of y, the powers 0 to 4."""
        from_middle = ((place_mm - self.middle_mm) / self.reach_mm).T
        powers = np.ones((2, 5, len(place_mm)))
        for power in range(1, 5):
            np.multiply(powers[:, power - 1], from_middle, out=powers[:, power])
        return powers


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
