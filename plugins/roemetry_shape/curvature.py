"""Principal curvatures and shape index of a surface through the sections, for the maps of a report.

Model. Around each place, over three sections and six samples to either side, z = f + d·x + e·y + ½(a·x² +
2b·xy + c·y²) is fitted by least squares; the curvatures are those of the quadric by its first and second
fundamental form, at its own slope; the shape index is Koenderink's (1992). They are shown, not judged by:
the three sections span two pitches of the stripes, so the same body has other curvatures on another rig.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_shape.product_frame import SAMPLES, Sections

_REACH = 6
"""Samples to either side that a local quadric is fitted to, of every second sample."""
_EDGE = 8


class SurfaceShape(NamedTuple):
    """Shape of the surface at (section, place) points away from the edges."""

    x_mm: Floats
    y_mm: Floats
    z_mm: Floats
    """x_mm, y_mm, z_mm: where, belt frame, mm."""
    slope_deg: Floats
    """Angle between the surface's normal and Z."""
    normal_x: Floats
    normal_y: Floats
    """normal_x, normal_y: what the unit normal has along X and Y: it leans downhill."""
    curvature_max: Floats
    curvature_min: Floats
    """curvature_max, curvature_min: principal curvatures, 1/mm; positive is hollow (seen from above),
    negative is a hump."""
    shape_index: Floats
    """Koenderink's: −1 a cap, 0 a saddle, +1 a cup."""


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


_RIDGE = 1e-9
"""Of the normal equations, whose places are about 1: three sections one above the other have a fit, too."""


def local_quadrics(x: Floats, y: Floats, z: Floats, first: int, last: int, step: int, reach: int) -> Floats:
    """Fit z = f + d·x + e·y + ½(a·x² + 2b·xy + c·y²) about places, over three sections.

    Parameters
    ----------
    x, y, z
        (section, sample) places and heights, mm.
    first, last, step
        Samples about which to fit: from the first on, every so many, before the last.
    reach
        Samples to either side that take part, every second one.

    Returns
    -------
    ndarray, shape (section − 2, place, 6)
        f, d, e, a, b, c about each place, x and y from there; of all sections but the outer two.
    """
    places = np.arange(first, last, step)
    near = places[:, None] + np.arange(-reach, reach + 1, 2)
    count = len(x)

    def about(values: Floats) -> Floats:
        """(section, place, point) values of the points about each place."""
        three = [values[k : count - 2 + k][:, near] for k in range(3)]
        return np.concatenate(three, axis=-1)

    # Scales make the equations even, whatever the spacing of the sections.
    wide = np.maximum(0.5 * np.abs(x[2:, first] - x[:-2, first]), 1e-9)[:, None]
    fine = np.maximum(np.abs(y[1:-1, first + 1] - y[1:-1, first]) * reach, 1e-9)[:, None]
    u = (about(x) - x[1:-1, places, None]) / wide[..., None]
    v = (about(y) - y[1:-1, places, None]) / fine[..., None]
    rows = np.stack([np.ones_like(u), u, v, 0.5 * u**2, u * v, 0.5 * v**2], axis=-1)
    across = np.swapaxes(rows, -1, -2)
    normal = across @ rows + _RIDGE * np.eye(rows.shape[-1])
    fit = np.linalg.solve(normal, across @ about(z)[..., None])[..., 0]
    one = np.ones_like(wide)
    scales = np.stack([one, wide, fine, wide**2, wide * fine, fine**2], axis=-1)
    return np.asarray(fit / scales)
