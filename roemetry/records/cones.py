"""Circles: light as cones round one axis from one point, and where lines of sight meet them.

A point P of the cone with apex A, axis a (length 1) and half angle α has a·(P − A) = cos α |P − A|. On a
line of sight S + t w that is a quadratic in t, with two roots: as a rule one on either half of the cone.
Halves are told by the camera's x, so each crosses a row of the image once, and is a stripe. A plane
through A is a cone of 90°.
"""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats

_AZIMUTHS = 181
"""Points of a half circle: between two of them it bends by 0.01 px of a radius of 300 px."""


def meet_cones(start_mm: Floats, way: Floats, cones: Floats, camera_x: Floats) -> Floats:
    """Give (…, 3) where lines of sight meet halves of cones; NaN where they do not.

    Parameters
    ----------
    start_mm, way
        (…, 3) a point of each line and its direction of length 1.
    cones
        (…, 7) as in `View.cones`.
    camera_x
        (3,) the camera's x, which tells left from right.
    """
    axis, cosine = cones[..., 3:6], np.cos(cones[..., 6])
    away = start_mm - cones[..., :3]
    along_way, along = dot(axis, way), dot(axis, away)
    square = cosine * cosine
    a = along_way * along_way - square
    b = along_way * along - square * dot(away, way)
    c = along * along - square * dot(away, away)
    side = np.sign(cones[..., 6])
    across = camera_x - dot(axis, camera_x)[..., None] * axis
    best, height = np.full(a.shape, np.nan), np.full(a.shape, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - a * c)
        for t in ((-b + root) / a, (-b - root) / a):
            z = np.abs(start_mm[..., 2] + t * way[..., 2])
            lit = along + t * along_way > 0.0
            mine = side * (dot(across, away) + t * dot(across, way)) > 0.0
            better = lit & mine & (z < height)
            best, height = np.where(better, t, best), np.where(better, z, height)
    return np.asarray(start_mm + best[..., None] * way)


def half_on_belt(cone: Floats, camera_x: Floats) -> Floats:
    """Give (azimuth, 3) points of half a circle on the belt, from one end to the other, mm."""
    return generators(cone, camera_x, np.linspace(-0.5, 0.5, _AZIMUTHS) * np.pi, 0.0)


def generators(cone: Floats, camera_x: Floats, azimuth: Floats, z_mm: float) -> Floats:
    """Give (azimuth, 3) points of a half at a height, at angles from its middle, rad; mm."""
    way = turned_generators(cone, camera_x, azimuth)
    return np.asarray(cone[:3] + ((z_mm - cone[2]) / way[:, 2])[:, None] * way)


def turned_generators(cone: Floats, camera_x: Floats, azimuth: Floats) -> Floats:
    """Give (azimuth, 3) directions of length 1 of a half's light, at angles from its middle, rad."""
    axis, angle = cone[3:6], float(cone[6])
    across = camera_x - (axis @ camera_x) * axis
    across = across / np.linalg.norm(across)
    beside = np.cross(axis, across)
    ring = np.outer(np.cos(azimuth), across) + np.outer(np.sin(azimuth), beside)
    return np.asarray(np.cos(angle) * axis + np.sin(angle) * ring)


def touching_planes(cones: Floats, camera_x: Floats) -> Floats:
    """Give (stripe, 4) planes that touch halves in their middle, n·X = d, normals towards the camera's x."""
    axis, angle = cones[:, 3:6], cones[:, 6:7]
    across = camera_x - (axis @ camera_x)[:, None] * axis
    normal = np.cos(angle) * across / np.sqrt(dot(across, across))[:, None] - np.sin(angle) * axis
    return np.column_stack([normal, dot(normal, cones[:, :3])])


def dot(one: Floats, other: Floats) -> Floats:
    """Give (…) scalar products of (…, 3) vectors, in single sums: over a small last axis numpy is slow."""
    return np.asarray(one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1] + one[..., 2] * other[..., 2])
