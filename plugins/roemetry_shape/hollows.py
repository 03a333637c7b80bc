"""Dents: regions where the surface lies below the convex hull of its cross-section."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats
from roemetry_shape.sections import SAMPLES, Sections

_LEAST_MM = 0.4
"""Shallower is relief, not a dent."""


class Hollow(NamedTuple):
    """One dent.

    Attributes
    ----------
    depth_mm
        Largest depth below the hull, mm.
    area_mm2
        Area on the belt, mm²: widths times the distance each section stands for.
    x_mm, y_mm
        Place of the deepest point, belt frame, mm.
    stripes
        Number of stripes that show it.
    """

    depth_mm: float
    area_mm2: float
    x_mm: float
    y_mm: float
    stripes: int


def hollows_of(sections: Sections) -> tuple[Floats, tuple[Hollow, ...]]:
    """Give (section, sample) depths, mm, and the dents, the deepest first."""
    from scipy.ndimage import label

    from roemetry_kernels.hollows import hollow_depth

    if not len(sections.stripe):
        return np.empty((0, SAMPLES)), ()
    depth = hollow_depth(sections.across_mm, sections.height_mm)
    numbers, count = label(depth > _LEAST_MM, structure=np.ones((3, 3)))
    stands_for = _stands_for_mm(sections.along_mm)
    step = 2.0 * sections.half_width_mm / (SAMPLES - 1)
    cell = (stands_for * step)[:, None] * np.ones(SAMPLES)
    found = []
    for number in range(1, count + 1):
        mine = numbers == number
        deepest = int(np.argmax(np.where(mine, depth, -1.0)))
        section, sample = divmod(deepest, SAMPLES)
        found.append(
            Hollow(
                depth_mm=float(depth[section, sample]),
                area_mm2=float(cell[mine].sum()),
                x_mm=float(sections.middle_mm[section, 0]),
                y_mm=float(sections.middle_mm[section, 1] + sections.across_mm[section, sample]),
                stripes=int(mine.any(axis=1).sum()),
            )
        )
    return depth, tuple(sorted(found, key=lambda hollow: -hollow.depth_mm))


def _stands_for_mm(along_mm: Floats) -> Floats:
    """Length along the product that each section stands for: half way to its neighbours."""
    if len(along_mm) < 2:
        return np.zeros(len(along_mm))
    step = np.diff(along_mm)
    return np.asarray(0.5 * (np.concatenate([step[:1], step]) + np.concatenate([step, step[-1:]])))
