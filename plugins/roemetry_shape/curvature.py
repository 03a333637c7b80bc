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
from roemetry_kernels.compiling import kernel
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


COLUMNS = 6
_RIDGE = 1e-9


@kernel
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
    sections = x.shape[0]
    places = (last - first + step - 1) // step
    found = np.full((sections - 2, places, COLUMNS), np.nan)
    normal = np.empty((COLUMNS, COLUMNS + 1))
    row = np.empty(COLUMNS)
    for section in range(1, sections - 1):
        # Scales make the equations even, whatever the spacing of the sections.
        wide = 0.5 * abs(x[section + 1, first] - x[section - 1, first])
        fine = abs(y[section, first + 1] - y[section, first]) * reach
        wide, fine = max(wide, 1e-9), max(fine, 1e-9)
        for place in range(places):
            at = first + place * step
            normal[:] = 0.0
            for neighbour in range(section - 1, section + 2):
                for sample in range(at - reach, at + reach + 1, 2):
                    dx = (x[neighbour, sample] - x[section, at]) / wide
                    dy = (y[neighbour, sample] - y[section, at]) / fine
                    row[0], row[1], row[2] = 1.0, dx, dy
                    row[3], row[4], row[5] = 0.5 * dx * dx, dx * dy, 0.5 * dy * dy
                    for i in range(COLUMNS):
                        for j in range(COLUMNS):
                            normal[i, j] += row[i] * row[j]
                        normal[i, COLUMNS] += row[i] * z[neighbour, sample]
            for i in range(COLUMNS):
                normal[i, i] += _RIDGE
            _eliminate(normal)
            scales = (1.0, wide, fine, wide * wide, wide * fine, fine * fine)
            for i in range(COLUMNS):
                found[section - 1, place, i] = normal[i, COLUMNS] / scales[i]
    return found


@kernel
def _eliminate(rows: Floats) -> None:
    """Solve a symmetric positive system in place (Gauss and Jordan): the last column becomes the answer."""
    count = rows.shape[0]
    for i in range(count):
        pivot = rows[i, i]
        for j in range(i, count + 1):
            rows[i, j] /= pivot
        for k in range(count):
            if k != i:
                factor = rows[k, i]
                if factor != 0.0:
                    for j in range(i, count + 1):
                        rows[k, j] -= factor * rows[i, j]
