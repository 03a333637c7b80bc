"""Dents: regions where the surface lies below the convex hull of its cross-section."""

from __future__ import annotations

import numpy as np

from roemetry.arrays import Floats
from roemetry_shape.regions import Region, regions_of
from roemetry_shape.sections import SAMPLES, Sections

_LEAST_MM = 0.4
"""Shallower is relief, not a dent."""


def hollows_of(sections: Sections) -> tuple[Floats, tuple[Region, ...]]:
    """Give (section, sample) depths, mm, and the dents, the deepest first."""
    from roemetry_kernels.shape.hollows import hollow_depth

    if not len(sections.stripe):
        return np.empty((0, SAMPLES)), ()
    depth = hollow_depth(sections.across_mm, sections.height_mm)
    return depth, regions_of(depth, sections, _LEAST_MM)
