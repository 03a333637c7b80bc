"""A product's outline: the border of its vertical footprint on the belt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roemetry_simulate.solid import Solid

Floats = NDArray[np.float64]

_HALVINGS = 30


def outline_mm(solid: Solid, step_mm: float = 0.5) -> Floats:
    """Find the border of a solid's footprint; of several pieces, the longest border.

    Parameters
    ----------
    solid : Solid
        Anything on the belt; what is thinner than a step may be missed.
    step_mm : float
        Distance of the places that are looked at; neighbours on the outline lie about as far apart.

    Returns
    -------
    ndarray, shape (n, 2)
        (x, y) in the belt frame, millimetres, counter-clockwise seen from above, not closed by a repeated
        point. Each lies on the border to 1e-6 mm, searched at right angles to it; corners are cut by up to
        a step. Shape (0, 2) for nothing.
    """
    import cv2

    x_min, x_max, y_min, y_max = solid.footprint_extent_mm()
    if not np.isfinite(x_min):
        return np.empty((0, 2))
    x = np.arange(x_min - 3.0 * step_mm, x_max + 3.0 * step_mm, step_mm)
    y = np.arange(y_min - 3.0 * step_mm, y_max + 3.0 * step_mm, step_mm)
    inside = np.isfinite(solid.heights_mm(*np.meshgrid(x, y))[0])
    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return np.empty((0, 2))
    columns, rows = max(contours, key=len)[:, 0, :].T
    soft = cv2.GaussianBlur(inside.astype(np.float64), (0, 0), 1.5)
    down_y, down_x = (-slope[rows, columns] for slope in np.gradient(soft))
    length = np.maximum(np.hypot(down_x, down_y), 1e-12)
    start = np.stack([x[columns], y[rows]], axis=1)
    away = np.stack([down_x, down_y], axis=1) / length[:, None]
    near, far = np.zeros(len(start)), np.full(len(start), 3.0 * step_mm)
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        place = start + middle[:, None] * away
        is_in = np.isfinite(solid.heights_mm(place[:, 0], place[:, 1])[0])
        near, far = np.where(is_in, middle, near), np.where(is_in, far, middle)
    border: Floats = start + near[:, None] * away
    u, v = border.T
    turning = float(np.sum(u * np.roll(v, -1) - v * np.roll(u, -1)))
    return border if turning >= 0.0 else np.ascontiguousarray(border[::-1])
