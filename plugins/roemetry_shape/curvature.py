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
    curvature_max, curvature_min
        Principal curvatures, 1/mm; positive is hollow (seen from above), negative is a hump.
    shape_index
        Koenderink's: −1 a cap, 0 a saddle, +1 a cup.
    """

    x_mm: Floats
    y_mm: Floats
    z_mm: Floats
    slope_deg: Floats
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
        return SurfaceShape(*[nothing] * 7)
    reach = np.arange(-_REACH, _REACH + 1, 2)
    middle = np.arange(1, count - 1)
    at = np.stack(np.broadcast_arrays(middle[:, None], place[None, :]), axis=-1)
    section = (at[:, :, 0, None, None] + np.array([-1, 0, 1])[:, None]) + 0 * reach
    sample = (at[:, :, 1, None, None] + reach) + 0 * np.array([0, 0, 0])[:, None]
    cells = at.shape[:2]
    dx = (x[section, sample] - x[at[..., 0], at[..., 1]][..., None, None]).reshape(*cells, -1)
    # Neighbouring sections are looked up at the same share of their width; what they mean is their own Y.
    dy = (y[section, sample] - y[at[..., 0], at[..., 1]][..., None, None]).reshape(*cells, -1)
    z = sections.height_mm[section, sample].reshape(*cells, -1)
    columns = np.stack([np.ones_like(dx), dx, dy, 0.5 * dx**2, dx * dy, 0.5 * dy**2], axis=-1)
    scale = np.sqrt((columns**2).mean(axis=(0, 1, 2)))
    scaled = columns / scale
    normal = np.einsum("stpk,stpl->stkl", scaled, scaled) + 1e-9 * np.eye(6)
    right = np.einsum("stpk,stp->stk", scaled, z)
    fit = np.linalg.solve(normal, right[..., None])[..., 0] / scale
    d, e, a, b, c = (fit[..., k] for k in range(1, 6))
    long = np.sqrt(1.0 + d**2 + e**2)
    gauss = (a * c - b**2) / long**4
    mean = ((1 + e**2) * a - 2 * d * e * b + (1 + d**2) * c) / (2 * long**3)
    root = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
    high, low = mean + root, mean - root
    index = 2.0 / np.pi * np.arctan2(high + low, high - low)
    return SurfaceShape(
        x_mm=x[at[..., 0], at[..., 1]],
        y_mm=y[at[..., 0], at[..., 1]],
        z_mm=sections.height_mm[at[..., 0], at[..., 1]],
        slope_deg=np.degrees(np.arctan(np.hypot(d, e))),
        curvature_max=high,
        curvature_min=low,
        shape_index=index,
    )


def curvature_features(found: SurfaceShape) -> dict[str, float]:
    """Quantiles of the maps: a healthy product is a cap nearly everywhere."""
    if not found.shape_index.size:
        return {}
    return {
        "slope_high_deg": float(np.quantile(found.slope_deg, 0.9)),
        "hollow_curvature_high_per_mm": float(np.quantile(found.curvature_max, 0.98)),
        "hollow_curvature_share": float((found.curvature_max > 0.02).mean()),
        "ridge_curvature_high_per_mm": float(-np.quantile(found.curvature_min, 0.02)),
        "shape_index_high": float(np.quantile(found.shape_index, 0.95)),
        "shape_index_median": float(np.median(found.shape_index)),
        "cup_share": float((found.shape_index > 0.25).mean()),
    }
