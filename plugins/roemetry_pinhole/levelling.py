"""A level plane instead of the plane of a board: gravity, as an inclinometer on the camera shows it.

Where nothing flat and level can be laid under the stripes, the direction of gravity g in the camera's frame
says how heights point, and the middle c of one board says where they begin. That middle lies on the sight r,
in the board's plane b·X = 1, so c = r/(b·r), and the level plane through it is

    b'·X = 1,   b' = g (b·r)/(g·r):

linear in b, whose covariance goes through it. What the inclinometer is uncertain by, in both directions
across g, comes on top.

Assumed: the inclinometer and the camera's axes are aligned, or their angle is in its uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roemetry.errors import CalibrationError
from roemetry.records.arrays import Floats
from roemetry_pinhole.bundle import Adjusted

_GRAZING = 0.05
"""Cosine between gravity and a sight: nearer to level sights, heights would hardly be seen."""


def levelled(adjusted: Adjusted, middle_mm: Floats, gravity: Floats, std_deg: float) -> Adjusted:
    """Let heights count along gravity, from a board's middle.

    Parameters
    ----------
    adjusted
        The belt in it is the board's plane.
    middle_mm
        (3,) the board's middle in the camera's frame.
    gravity
        (3,) downwards, in the camera's frame of the turned image (x right, y down, z forward), of any length.
    std_deg
        Standard uncertainty of its direction, degrees.

    Raises
    ------
    CalibrationError
        The camera does not look down onto the level plane.
    """
    length = float(np.linalg.norm(gravity))
    down = gravity / (length or 1.0)
    sight = middle_mm / np.linalg.norm(middle_mm)
    drop = float(down @ sight)
    if not (length > 0.0 and drop > _GRAZING and down[2] > _GRAZING):
        raise CalibrationError(
            f"the camera does not look down onto a level plane: gravity is {gravity.tolist()}, the "
            f"cosine of its angle with the sight of the board {drop:.2f}, with its axis {down[2]:.2f}; "
            f"both have to be above {_GRAZING}",
            hint="gravity is the direction downwards in the turned image's camera frame: x right, y down, z "
            "forward; leave it out to count heights from the plane of the board itself",
        )
    turn = np.outer(down, sight) / drop
    step = np.eye(adjusted.covariance.shape[0])
    at = adjusted.unknowns.belt
    step[np.ix_(at, at)] = turn
    covariance = step @ adjusted.covariance @ step.T
    across = np.linalg.svd(down[None, :])[2][1:].T  # (3, 2): two directions across gravity
    scale = float(adjusted.geometry.belt @ sight) / drop
    moved = np.radians(std_deg) * scale * (across - np.outer(down, sight @ across) / drop)
    covariance[np.ix_(at, at)] += moved @ moved.T
    belt = turn @ adjusted.geometry.belt
    return replace(adjusted, geometry=replace(adjusted.geometry, belt=belt), covariance=covariance)
