"""Lens distortion in OpenCV's model, and its inverse."""

from __future__ import annotations

import numpy as np

from roemetry.records.arrays import Floats


def distorted(xy: Floats, distortion: Floats) -> Floats:
    """Bend places on the plane at distance 1 as the lens does.

    Parameters
    ----------
    xy
        (n, 2) without distortion.
    distortion
        (k,) in OpenCV's order k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, τx, τy.
    """
    if not distortion.any():
        return np.asarray(xy, np.float64)
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = _all(distortion)
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    bent = np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4),
        ]
    )
    if tau_x == 0 and tau_y == 0:
        return bent
    tilted = np.column_stack([bent, np.ones(len(bent))]) @ _tilt(tau_x, tau_y).T
    return np.asarray(tilted[:, :2] / tilted[:, 2:])


def undistorted(xy: Floats, distortion: Floats) -> Floats:
    """Take the lens's distortion out: the inverse of `distorted`, by Newton's method to 1e-13.

    Places beyond the fold of a strong distortion have no inverse and come back NaN.
    """
    bent = np.asarray(xy, np.float64)
    if not distortion.any():
        return bent
    straight = bent.copy()
    for step in range(_NEWTON_STEPS + 1):
        wrong = distorted(straight, distortion) - bent
        a, b, c, d = slopes(straight, distortion)
        determinant = a * d - b * c
        if step == _NEWTON_STEPS or not np.nanmax(np.abs(wrong), initial=0.0) > _NEWTON_RESIDUAL:
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            straight[:, 0] -= (d * wrong[:, 0] - b * wrong[:, 1]) / determinant
            straight[:, 1] -= (a * wrong[:, 1] - c * wrong[:, 0]) / determinant
    missed = np.abs(wrong).max(axis=1)
    # Beyond the fold the image is turned over: a root there fits, but no light takes that way.
    proper = (determinant > 0) & (a + d > 0)
    straight[~((missed < _MISSED_MAX) & proper)] = np.nan
    return straight


def slopes(xy: Floats, distortion: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Give ∂x′/∂x, ∂x′/∂y, ∂y′/∂x, ∂y′/∂y of `distorted` at places (n, 2), each (n,)."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = _all(distortion)
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    above, below = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = above / below
    rising = (k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / below
    cross = 2 * (x * y * rising + p1 * x + p2 * y)
    prism_x, prism_y = 2 * (s1 + 2 * r2 * s2), 2 * (s3 + 2 * r2 * s4)
    by_x = np.stack([radial + 2 * (x * x * rising + p1 * y + 3 * p2 * x) + prism_x * x, cross + prism_y * x])
    by_y = np.stack([cross + prism_x * y, radial + 2 * (y * y * rising + 3 * p1 * y + p2 * x) + prism_y * y])
    if tau_x or tau_y:
        turn = _tilt(tau_x, tau_y)
        bent = distorted(xy, np.concatenate([distortion[:12], np.zeros(2)])).T
        ahead = turn[2, :2] @ bent + turn[2, 2]
        place = (turn[:2, :2] @ bent + turn[:2, 2:]) / ahead
        by_x, by_y = ((turn[:2, :2] @ by - place * (turn[2, :2] @ by)) / ahead for by in (by_x, by_y))
    return by_x[0], by_y[0], by_x[1], by_y[1]


_NEWTON_STEPS = 30
_NEWTON_RESIDUAL = 1e-13
_MISSED_MAX = 1e-9


def _all(distortion: Floats) -> list[float]:
    return [*map(float, distortion), *[0.0] * (14 - distortion.size)]


def _tilt(tau_x: float, tau_y: float) -> Floats:
    """Homography of a tilted sensor (OpenCV's model, τ in radians)."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    turn = about_y @ about_x
    return np.asarray(
        np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]) @ turn
    )
