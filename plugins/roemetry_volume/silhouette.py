"""From the outline in the image, a perspective silhouette, to the footprint's border on the belt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry.records.view import View


class Border(NamedTuple):
    """The footprint's border.

    Attributes
    ----------
    xy_mm : ndarray, shape (n, 2)
        Closed polygon on the belt.
    outward : ndarray, shape (n, 2)
        Unit normals.
    tilt : ndarray, shape (n,)
        Tangent of the viewing ray's tilt along the normal; positive where the camera looks from inside
        outwards and the wall is hidden, negative where it sees the wall.
    """

    xy_mm: Floats
    outward: Floats
    tilt: Floats


def border_at(view: View, contour_px: Floats, height_mm: Floats, fall_mm: Floats | None = None) -> Border:
    """Place a contour at the heights of the rim that made it.

    Where a dome falls to its rim as (z − z_rim)² = α·d, a ray of tilt t along the normal touches it α·t²/4
    outside the rim (for an ellipse c²·t²/(2b)): the border lies that much further inside.

    Parameters
    ----------
    view
        The camera.
    contour_px : ndarray, shape (n, 2)
        The silhouette in the image.
    height_mm : ndarray, shape (n,)
        Height of the rim at each of its points.
    fall_mm : ndarray, shape (n,), or None
        α at each point, mm.
    """
    start, way = view.rays(contour_px)
    xy = start[:, :2] + ((height_mm - start[:, 2]) / way[:, 2])[:, None] * way[:, :2]
    outward = _outward(xy)
    tilt = (way[:, :2] * outward).sum(axis=1) / -way[:, 2]
    if fall_mm is not None:
        xy = xy - outward * (0.25 * fall_mm * tilt * np.abs(tilt).clip(0.0, 1.0))[:, None]
    return Border(xy, outward, tilt)


def area_of(xy: Floats) -> float:
    """Signed area of a closed polygon; positive if it runs counter-clockwise."""
    x, y = xy[:, 0], xy[:, 1]
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def evenly(contour: Floats, points: int) -> Floats:
    """Resample a closed polygon to points at even distances."""
    closed = np.vstack([contour, contour[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    at = np.linspace(0.0, along[-1], points, endpoint=False)
    return np.column_stack([np.interp(at, along, closed[:, k]) for k in (0, 1)])


def _outward(xy: Floats) -> Floats:
    along = np.roll(xy, -2, axis=0) - np.roll(xy, 2, axis=0)
    length = np.hypot(along[:, 0], along[:, 1])
    sign = np.sign(area_of(xy)) or 1.0
    normal: Floats = (
        sign * np.column_stack([along[:, 1], -along[:, 0]]) / np.where(length > 0, length, 1.0)[:, None]
    )
    return normal
