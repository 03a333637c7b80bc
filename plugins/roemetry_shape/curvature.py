"""Principal curvatures and shape index of a surface through the sections."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats
from roemetry_shape.sections import SAMPLES, Sections

_REACH = 6
"""Samples to either side that a local quadric is fitted to, of every second sample."""
_EDGE = 8


class SurfaceShape(NamedTuple):
    """Shape of the surface at (section, place) points away from the edges.

    Attributes
    ----------
    x_mm, y_mm, z_mm
        Where, belt frame, mm.
    slope_deg
        Angle between the surface's normal and Z.
    normal_x, normal_y
        What the unit normal has along X and Y: it leans downhill.
    curvature_max, curvature_min
        Principal curvatures, 1/mm; positive is hollow (seen from above), negative is a hump.
    shape_index
        Koenderink's: −1 a cap, 0 a saddle, +1 a cup.
    """

    x_mm: Floats
    y_mm: Floats
    z_mm: Floats
    slope_deg: Floats
    normal_x: Floats
    normal_y: Floats
    curvature_max: Floats
    curvature_min: Floats
    shape_index: Floats


def surface_shape(sections: Sections) -> SurfaceShape:
    """Fit z = f + d·x + e·y + ½(a·x² + 2b·xy + c·y²) around each place, over three sections.

    Curvatures are those of the fitted quadric (first and second fundamental form, at its own slope).
    """
    count = len(sections.stripe)
    place = np.arange(_EDGE, SAMPLES - _EDGE, 2)
    x = np.broadcast_to(sections.middle_mm[:, 0, None], (count, SAMPLES))
    y = sections.middle_mm[:, 1, None] + sections.across_mm
    if count < 3:
        nothing = np.empty((0, place.size))
        return SurfaceShape(*[nothing] * 9)
    from roemetry_kernels.shape.quadrics import local_quadrics

    heights = np.ascontiguousarray(sections.height_mm)
    fit = local_quadrics(np.ascontiguousarray(x), y, heights, _EDGE, SAMPLES - _EDGE, 2, _REACH)
    inner = slice(1, count - 1), slice(_EDGE, SAMPLES - _EDGE, 2)
    d, e, a, b, c = (fit[..., k] for k in range(1, 6))
    long = np.sqrt(1.0 + d**2 + e**2)
    gauss = (a * c - b**2) / long**4
    across = np.sqrt(d**2 + e**2)
    mean = ((1 + e**2) * a - 2 * d * e * b + (1 + d**2) * c) / (2 * long**3)
    root = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
    high, low = mean + root, mean - root
    index = 2.0 / np.pi * np.arctan2(high + low, high - low)
    return SurfaceShape(
        x_mm=x[inner],
        y_mm=y[inner],
        z_mm=heights[inner],
        slope_deg=np.degrees(np.arctan(across)),
        normal_x=-d / long,
        normal_y=-e / long,
        curvature_max=high,
        curvature_min=low,
        shape_index=index,
    )


def curvature_features(found: SurfaceShape) -> dict[str, float]:
    """Quantiles of the maps: a healthy product is a cap nearly everywhere."""
    if not found.shape_index.size:
        return {}
    slope, hollow, ridge, index = (
        np.sort(values.ravel())
        for values in (found.slope_deg, found.curvature_max, found.curvature_min, found.shape_index)
    )
    return {
        "slope_high_deg": _quantile(slope, 0.9),
        "hollow_curvature_high_per_mm": _quantile(hollow, 0.98),
        "hollow_curvature_share": float((hollow > 0.02).mean()),
        "ridge_curvature_high_per_mm": -_quantile(ridge, 0.02),
        "shape_index_high": _quantile(index, 0.95),
        "shape_index_median": _quantile(index, 0.5),
        "cup_share": float((index > 0.25).mean()),
    }


def _quantile(rising: Floats, share: float) -> float:
    """Quantile of sorted values, as numpy's; which takes longer to find out what it is given."""
    at = share * (rising.size - 1)
    below = int(at)
    above = min(below + 1, rising.size - 1)
    return float(rising[below] + (at - below) * (rising[above] - rising[below]))
