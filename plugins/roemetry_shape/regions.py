"""Regions of a surface that stand out: what hangs together, from stripe to stripe, beyond a least depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats, Integers
from roemetry_shape.sections import SAMPLES, Sections


class Region(NamedTuple):
    """One dent or hump.

    Attributes
    ----------
    depth_mm
        Largest depth below (of a hump: height above) what it is measured from, mm.
    area_mm2
        Area on the belt, mm²: widths times the distance each section stands for.
    x_mm, y_mm
        Place of that, belt frame, mm.
    stripes
        Number of stripes that show it.
    cells
        (cell, 2) section and sample of each place in it.
    """

    depth_mm: float
    area_mm2: float
    x_mm: float
    y_mm: float
    stripes: int
    cells: Integers


def regions_of(depth: Floats, sections: Sections, least_mm: float) -> tuple[Region, ...]:
    """Give the regions of (section, sample) depths beyond the least, the deepest first."""
    if not (depth > least_mm).any():
        return ()
    from scipy.ndimage import label

    numbers, count = label(depth > least_mm, structure=np.ones((3, 3)))
    stands_for = _stands_for_mm(sections.along_mm)
    step = 2.0 * sections.half_width_mm / (SAMPLES - 1)
    cell = (stands_for * step)[:, None] * np.ones(SAMPLES)
    found = []
    for number in range(1, count + 1):
        mine = numbers == number
        deepest = int(np.argmax(np.where(mine, depth, -1.0)))
        section, sample = divmod(deepest, SAMPLES)
        found.append(
            Region(
                depth_mm=float(depth[section, sample]),
                area_mm2=float(cell[mine].sum()),
                x_mm=float(sections.middle_mm[section, 0]),
                y_mm=float(sections.middle_mm[section, 1] + sections.across_mm[section, sample]),
                stripes=int(mine.any(axis=1).sum()),
                cells=np.argwhere(mine),
            )
        )
    return tuple(sorted(found, key=lambda region: -region.depth_mm))


def _stands_for_mm(along_mm: Floats) -> Floats:
    """Length along the product that each section stands for: half way to its neighbours."""
    if len(along_mm) < 2:
        return np.zeros(len(along_mm))
    step = np.diff(along_mm)
    return np.asarray(0.5 * (np.concatenate([step[:1], step]) + np.concatenate([step, step[-1:]])))
