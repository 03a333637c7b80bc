"""A plate of equal balls in points on its surface: where it lies, and each ball's sphere.

Model. A point at a known height says on which circle its ball's centre lies: a Hough transform. The plate's
place and turn are those whose centres collect most votes. A sphere is fitted by least squares of the points'
distances off its surface (Gauss and Newton).

It fails where hardly a point lies on balls: the place is then that of anything round, and callers look at how
far the points are off.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from roemetry.records import SpherePlate
from roemetry.records.arrays import Floats

_CELL_SHARE = 0.08
"""Of a ball's radius, side of a cell of the votes: points are as noisy, and turns of 1° move a ball by it."""
_WAYS = 72
"""Directions in which a point votes for its ball's centre: 5°, a cell of the votes at a ball's radius."""
_ANCHORS = 8  # highest votes that are tried as a ball: some are shadows
_TURN_STEP_DEG = 1.0  # moves the outer balls of a plate of some 30 mm by a cell of the votes
_FIT_STEPS, _FIT_END_MM = 50, 1e-9  # the fit squares its error in each step: it ends by its tolerance


def centres(plate: SpherePlate, pose: Floats) -> Floats:
    """Give (ball, 3) the balls' centres in the belt frame, mm.

    `pose` (4,): x, y of the plate's middle, mm; its turn about Z, rad; its lengths over the described.
    """
    u = (np.arange(plate.columns) - 0.5 * (plate.columns - 1)) * plate.pitch_mm
    v = (np.arange(plate.rows) - 0.5 * (plate.rows - 1)) * plate.pitch_mm
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    xy = pose[3] * grid @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    return np.column_stack([xy, np.full(len(xy), pose[3] * plate.centre_height_mm)])


def place_of(at_mm: Floats, plate: SpherePlate, turn_max_deg: float) -> Floats:
    """Give (3,) x, y of the plate's middle, mm, and its turn, rad, by the votes of (point, 3) points.

    Right to a cell of the votes and a degree; turns up to `turn_max_deg` either way are tried.
    """
    radius = 0.5 * plate.diameter_mm
    cell = _CELL_SHARE * radius
    reach = np.sqrt(np.maximum(radius**2 - (at_mm[:, 2] - plate.centre_height_mm) ** 2, 0.0))
    turn = 2.0 * np.pi * np.arange(_WAYS) / _WAYS
    x = (at_mm[:, 0, None] + reach[:, None] * np.cos(turn)).ravel()
    y = (at_mm[:, 1, None] + reach[:, None] * np.sin(turn)).ravel()
    low = np.array([x.min(), y.min()]) - 2.0 * cell
    size = [int(np.ptp(one) / cell) + 6 for one in (x, y)]
    voted = ((x - low[0]) / cell).astype(int) * size[1] + ((y - low[1]) / cell).astype(int)
    votes = np.bincount(voted, minlength=size[0] * size[1]).reshape(size).astype(np.float64)
    for axis in (0, 1):
        votes = votes + np.roll(votes, 1, axis) + np.roll(votes, -1, axis)
    # one ball with many stripes must not outvote the others
    votes = np.sqrt(votes)
    anchors = low + (_peaks_of(votes, int(radius / cell)) + 0.5) * cell
    yaws, flat = _turned(plate, turn_max_deg)
    # (anchor, yaw, ball at the anchor, other ball)
    at_all = anchors[:, None, None, None] + flat[None, :, None] - flat[None, :, :, None]
    place = np.floor((at_all - low) / cell).astype(int)
    inside = np.asarray(((place >= 0) & (place < votes.shape)).all(axis=-1))
    u, v = np.moveaxis(np.where(inside[..., None], place, 0), -1, 0)
    score = (votes[u, v] * inside).sum(axis=-1)
    which, turn_at, ball = np.unravel_index(score.argmax(), score.shape)
    return np.array([*(anchors[which] - flat[turn_at, ball]), yaws[turn_at]])


@lru_cache(maxsize=8)
def _turned(plate: SpherePlate, turn_max_deg: float) -> tuple[Floats, Floats]:
    """Give the (yaw,) turns that are tried, rad, and (yaw, ball, 2) the balls' centres at the origin, mm."""
    yaws = np.radians(np.arange(-turn_max_deg, turn_max_deg + 0.5 * _TURN_STEP_DEG, _TURN_STEP_DEG))
    return yaws, np.stack([centres(plate, np.array([0.0, 0.0, yaw, 1.0]))[:, :2] for yaw in yaws])


def _peaks_of(votes: Floats, apart: int) -> Floats:
    """(anchor, 2) the highest cells, none nearer to another than so many cells."""
    left = votes.copy()
    found = []
    for _ in range(_ANCHORS):
        u, v = np.unravel_index(left.argmax(), left.shape)
        found.append((u, v))
        left[max(u - apart, 0) : u + apart + 1, max(v - apart, 0) : v + apart + 1] = 0.0
    return np.array(found, np.float64)


def fit_sphere(
    points_mm: Floats, centre_mm: Floats, radius_mm: float, *, known_radius: bool = False
) -> tuple[Floats, float]:
    """Fit a sphere to (point, 3) points from a start; give centre and radius, mm."""
    centre, radius = np.array(centre_mm, np.float64), float(radius_mm)
    for _ in range(_FIT_STEPS):
        away = points_mm - centre
        distance = np.linalg.norm(away, axis=1)
        jacobian = np.column_stack([-away / distance[:, None], -np.ones(len(away))])
        used = jacobian[:, :3] if known_radius else jacobian
        step = np.linalg.lstsq(used, radius - distance, rcond=None)[0]
        centre, radius = centre + step[:3], radius + float(step[3:].sum())
        if np.abs(step).max() < _FIT_END_MM:
            break
    return centre, radius
