"""Circles: a projector's cones of light as what the ray caster draws and finds.

The halves of each cone stand where planes of light stand in a fan: a point X lies on the cone with apex
A, axis a and half angle α where n·X = d + b |X − A| for n = −a / sin α, d = n·A and b = −cot α; beside it
the two sides differ by the distance to the cone, to first order. A plane has b = 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roemetry_simulate.optics import LaserFan

Floats = NDArray[np.float64]


def circles_through(
    projector_mm: ArrayLike, centre_mm: ArrayLike, radii_mm: ArrayLike, right: ArrayLike, *,
    sigma_mm: float, peak_grey: float,
) -> LaserFan:  # fmt: skip
    """Return circles round a centre on the belt, of these radii there across the axis, increasing.

    Halves come from left to right: the left ones from the largest circle inwards, the right ones outwards.
    `right` is the direction that tells them, the camera's x.
    """
    projector = np.asarray(projector_mm, dtype=np.float64)
    axis = np.asarray(centre_mm, dtype=np.float64) - projector
    away = float(np.linalg.norm(axis))
    axis = axis / away
    across = np.asarray(right, dtype=np.float64)
    across = across - (axis @ across) * axis
    across = across / np.linalg.norm(across)
    radii = np.atleast_1d(np.asarray(radii_mm, dtype=np.float64))
    angle = np.arctan(np.concatenate([radii[::-1], radii]) / away)
    side = np.repeat([-1.0, 1.0], len(radii))
    normals = -axis / np.sin(angle)[:, None]
    halves = np.column_stack([-1.0 / np.tan(angle), side[:, None] * across])
    # no angle along a line is counted: a circle's light is even all round
    return LaserFan(
        projector, normals, normals @ projector, np.zeros(3), sigma_mm, np.full(len(angle), peak_grey),
        halves=halves,
    )  # fmt: skip
