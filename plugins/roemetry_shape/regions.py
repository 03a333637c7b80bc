"""Dents and humps: regions of a product's surface that stand out of what it would be without them.

Model. A dent is where a section lies below its own upper convex hull (Andrew's monotone chain): a sound
section is convex from above. A hump is where the surface stands above the smooth dome that fits most of it:
the squared height of a dome is nearly a polynomial of low order over its footprint (of a half-ellipsoid one
of second order), so a polynomial, quadratic across and cubic along, is fitted to it with weights that let
single regions go their own way (Cauchy's, six rounds of reweighted least squares). What hangs together from
stripe to stripe, deeper than a least depth, is a region.

It fails for a dent as wide as its section (nothing is left to span the hull) and where a hump is most of the
surface. At the outer 15 % of the width, where a dome is steep, no hump is told.

`relief_of` gathers what the report shows of it: maps, regions, sizes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from roemetry.records import Relief, ReliefMap, ReliefRegion
from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_shape.curvature import SurfaceShape
from roemetry_shape.product_frame import SAMPLES, Sections

DENT_LEAST_MM = 0.4
"""Shallower is relief, not a dent: twice the deepest hollow that noise of 0.1 mm makes
in a smoothed section."""

HUMP_LEAST_MM = 0.8
"""Lower is relief, or a body that is not as smooth as the fit."""

_INNER = 0.85
"""Share of the half width within which a dome is fitted and humps are told."""

_ROUNDS = 6
"""Of reweighting: after them the fit moves by less than 0.01 mm."""

_STEP = 2
"""Every second sample is fitted: neighbours say the same."""

_SECTIONS_MIN = 5
"""For a cubic along: one more than its coefficients."""

_SPREAD_LEAST_MM2 = 4.0
"""Of squared heights: 0.15 mm at a height of 13 mm. Weights do not follow finer relief than this."""


class Region(NamedTuple):
    """One dent or hump."""

    depth_mm: float
    """Largest depth below (of a hump: height above) what it is measured from, mm."""
    area_mm2: float
    """Area on the belt, mm²: widths times the distance each section stands for."""
    x_mm: float
    y_mm: float
    """x_mm, y_mm: place of that, belt frame, mm."""
    stripes: int
    """Number of stripes that show it."""
    cells: Integers
    """(cell, 2) section and sample of each place in it."""


def hollows_of(sections: Sections) -> tuple[Floats, tuple[Region, ...]]:
    """Give (section, sample) depths, mm, and the dents, the deepest first."""
    if not len(sections.stripe):
        return np.empty((0, SAMPLES)), ()
    depth = hollow_depth(sections.across_mm, sections.height_mm)
    return depth, regions_of(depth, sections, DENT_LEAST_MM)


def humps_of(sections: Sections) -> tuple[Floats, tuple[Region, ...]]:
    """Give (section, sample) heights above the smooth body, mm, and the humps, the highest first."""
    height: Floats = np.zeros((len(sections.stripe), SAMPLES))
    if len(sections.stripe) < _SECTIONS_MIN:
        return height, ()
    inner = np.abs(np.linspace(-1.0, 1.0, SAMPLES)) <= _INNER
    height[:, inner] = np.maximum(sections.height_mm - dome_of(sections), 0.0)[:, inner]
    return height, regions_of(height, sections, HUMP_LEAST_MM)


def dome_of(sections: Sections) -> Floats:
    """(section, sample) heights of the smooth body that fits most of the surface, mm; see `humps_of`."""
    t: Floats = np.linspace(-1.0, 1.0, SAMPLES)
    along = sections.along_mm / max(float(sections.along_mm[-1]), 1e-9) * 2.0 - 1.0
    inner = np.abs(t) <= _INNER
    design = _basis(along, t)
    squared = sections.height_mm**2
    chosen = np.flatnonzero(inner)[::_STEP]
    rows = np.ascontiguousarray(design[:, chosen].reshape(-1, design.shape[-1]).T)
    wanted = squared[:, chosen].ravel()
    weight: Floats = np.ones(wanted.size)
    fit: Floats = np.zeros(len(rows))
    for _ in range(_ROUNDS):
        weighed = weight * rows
        normal = weighed @ rows.T + 1e-9 * np.eye(len(rows))
        fit = np.asarray(np.linalg.solve(normal, weighed @ wanted), np.float64)
        off = wanted - fit @ rows
        spread = max(1.4826 * _middle_of(np.abs(off)), _SPREAD_LEAST_MM2)
        weight = 1.0 / (1.0 + (off / (2.0 * spread)) ** 2)
    return np.sqrt(np.maximum(design @ fit, 0.0))


def _middle_of(values: Floats) -> float:
    """Give the median, without what NumPy's own looks after besides."""
    half = values.size // 2
    places = [half - 1, half] if values.size % 2 == 0 else [half, half]
    low, high = np.partition(values, places)[places]
    return 0.5 * float(low + high)


def _basis(along: Floats, t: Floats) -> Floats:
    """(section, sample, 12) products of 1, s, s², s³ and 1, t, t²."""
    of_s, of_t = along[:, None] ** np.arange(4), t[:, None] ** np.arange(3)
    return np.asarray((of_s[:, None, :, None] * of_t[None, :, None, :]).reshape(along.size, t.size, 12))


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


@kernel
def hollow_depth(across: Floats, height: Floats) -> Floats:
    """Depth of each curve below its upper convex hull (Andrew's monotone chain).

    Parameters
    ----------
    across, height
        (curve, n) strictly increasing places, and heights over them; no NaN.

    Returns
    -------
    ndarray, shape (curve, n)
        Hull less height, at least 0; 0 where the curve touches its hull.
    """
    curves, count = height.shape
    depth = np.zeros((curves, count))
    corner = np.empty(count, np.int64)
    for c in range(curves):
        corners = 0
        for i in range(count):
            while corners > 1:
                a, b = corner[corners - 2], corner[corners - 1]
                turn = (across[c, b] - across[c, a]) * (height[c, i] - height[c, a]) - (
                    height[c, b] - height[c, a]
                ) * (across[c, i] - across[c, a])
                if turn < 0.0:
                    break
                corners -= 1
            corner[corners] = i
            corners += 1
        for k in range(corners - 1):
            a, b = corner[k], corner[k + 1]
            slope = (height[c, b] - height[c, a]) / (across[c, b] - across[c, a])
            for i in range(a + 1, b):
                depth[c, i] = max(height[c, a] + slope * (across[c, i] - across[c, a]) - height[c, i], 0.0)
    return depth


_EVERY = 2
"""Of the samples across a section, those that are shown."""

_FIGURES = (
    "length_seen_mm",
    "length_mm",
    "width_mm",
    "thickness_mm",
    "bend_mm",
    "lean_range_deg",
)


def relief_of(
    sections: Sections,
    surface: SurfaceShape,
    stands_out_mm: Floats,
    regions: Mapping[str, tuple[Region, ...]],
    features: Mapping[str, float],
) -> Relief:
    """Put together what there is to show.

    Parameters
    ----------
    sections
        The product's.
    surface
        Slope, principal curvatures and shape index, away from the edges.
    stands_out_mm
        (section, sample) height above (or below, negative) what dents and humps are measured from.
    regions
        By kind, ``dent`` and ``hump``.
    features
        Of which the sizes are written beside the drawing.
    """
    kept = slice(0, SAMPLES, _EVERY)
    x = np.broadcast_to(sections.middle_mm[:, :1], sections.across_mm.shape)
    y = sections.middle_mm[:, 1:] + sections.across_mm
    return Relief(
        xy_mm=np.stack([x, y], axis=-1)[:, kept],
        middle_mm=sections.middle_mm,
        maps=(
            ReliefMap("Dents (−) and humps (+)", "mm", stands_out_mm[:, kept], True, 1.0),
            ReliefMap(
                "Slope, and normals",
                "°",
                _spread(surface.slope_deg, sections),
                False,
                45.0,
                np.stack([_spread(part, sections) for part in (surface.normal_x, surface.normal_y)], axis=-1),
            ),
            ReliefMap(
                "Shape index: −1 cap, 0 saddle, 1 cup", "", _spread(surface.shape_index, sections), True, 1.0
            ),
            *(
                ReliefMap(f"{which} principal curvature", "1/mm", _spread(values, sections), True, 0.05)
                for which, values in (
                    ("Larger", surface.curvature_max),
                    ("Smaller", surface.curvature_min),
                )
            ),
        ),
        regions=tuple(
            ReliefRegion(
                kind=kind,
                depth_mm=region.depth_mm,
                area_mm2=region.area_mm2,
                xy_mm=np.array([region.x_mm, region.y_mm]),
                cells=np.unique(region.cells // np.array([1, _EVERY]), axis=0),
            )
            for kind, found in regions.items()
            for region in found
        ),
        figures={name: features[name] for name in _FIGURES if name in features},
    )


def _spread(values: Floats, sections: Sections) -> Floats:
    """Put values of the inner places among all, NaN around them."""
    whole = np.full((len(sections.stripe), SAMPLES), np.nan)
    if values.size:
        margin = (SAMPLES - (2 * values.shape[1] - 1)) // 2
        whole[1:-1, margin : SAMPLES - margin : 2] = values
    return whole[:, ::_EVERY]
