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

Curvatures. Around each place, over three sections and six samples to either side, z = f + d·x + e·y + ½(a·x²
+ 2b·xy + c·y²) is fitted by least squares; the curvatures are those of the quadric by its first and second
fundamental form, at its own slope; the shape index is Koenderink's (1992). They are shown, not judged by: the
three sections span two pitches of the stripes, so the same body has other curvatures on another rig.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from roemetry.records import Relief, ReliefMap, ReliefRegion
from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.robust_fit import robust_fit
from roemetry_shape.product_frame import EVEN, SAMPLES, Sections

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
    # with fewer sections a cubic along would follow the humps themselves
    if len(sections.stripe) < _SECTIONS_MIN:
        return height, ()
    height[:, _INSIDE] = np.maximum(sections.height_mm - dome_of(sections), 0.0)[:, _INSIDE]
    return height, regions_of(height, sections, HUMP_LEAST_MM)


def dome_of(sections: Sections) -> Floats:
    """(section, sample) heights of the smooth body that fits most of the surface, mm; see `humps_of`."""
    dome: Floats = dome_over(sections.along_mm, sections.height_mm)
    return dome


@float_kernel
def dome_over(along_mm: Floats, height_mm: Floats) -> Floats:
    """Give what `dome_of` does, of (section,) places along the product and (section, sample) heights."""
    sections, fitted = along_mm.size, _FITTED.size
    of_s, rows = np.empty((4, sections)), np.empty((12, sections * fitted))
    wanted = np.empty(sections * fitted)
    for k in range(sections):
        # from −1 to 1 along and across, so that the powers are of one size and the ridge means the same for
        # all
        place = along_mm[k] / max(along_mm[sections - 1], 1e-9) * 2.0 - 1.0
        of_s[0, k], of_s[1, k], of_s[2, k], of_s[3, k] = 1.0, place, place * place, place * place * place
        for j in range(fitted):
            # heights squared: a half-ellipsoid is then a polynomial
            wanted[k * fitted + j] = height_mm[k, _FITTED[j]] ** 2
            for a in range(4):
                for b in range(3):
                    rows[3 * a + b, k * fitted + j] = of_s[a, k] * _OF_T[b, _FITTED[j]]
    ridge = np.full(12, _RIDGE)
    # with Cauchy's weights a dent or a hump becomes an outlier of the dome, instead of pulling it
    fit = robust_fit(rows, wanted, np.ones(wanted.size), ridge, _SPREAD_LEAST_MM2, _ROUNDS)[0]
    dome = np.zeros_like(height_mm)
    for k in range(sections):
        for b in range(3):
            term = 0.0
            for a in range(4):
                term += of_s[a, k] * fit[3 * a + b]
            for j in range(dome.shape[1]):
                dome[k, j] += term * _OF_T[b, j]
        for j in range(dome.shape[1]):
            # beyond the body's edges the polynomial falls below 0
            dome[k, j] = np.sqrt(max(dome[k, j], 0.0))
    return dome


_INSIDE = np.flatnonzero(np.abs(EVEN) <= _INNER)
_FITTED = _INSIDE[::_STEP].copy()
_OF_T = np.ascontiguousarray((EVEN[:, None] ** np.arange(3)).T)
"""Samples in which humps are told, those that a dome is fitted to, and (3, sample) 1, t, t²."""


def regions_of(depth: Floats, sections: Sections, least_mm: float) -> tuple[Region, ...]:
    """Give the regions of (section, sample) depths beyond the least, the deepest first."""
    if not (depth > least_mm).any():
        return ()
    from scipy.ndimage import label

    # corners count as neighbours: a dent that runs obliquely moves by a sample from stripe to stripe
    numbers, count = label(depth > least_mm, structure=np.ones((3, 3)))
    stands_for = _stands_for_mm(sections.along_mm)
    step = 2.0 * sections.half_width_mm / (SAMPLES - 1)
    # mm² of each sample: the distance that its section stands for times its share of the width
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
    # the outer sections reach outwards as far as to their only neighbour
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
        # the upper hull of the points so far, from left to right
        corners = 0
        for i in range(count):
            while corners > 1:
                a, b = corner[corners - 2], corner[corners - 1]
                turn = (across[c, b] - across[c, a]) * (height[c, i] - height[c, a]) - (
                    height[c, b] - height[c, a]
                ) * (across[c, i] - across[c, a])
                # a turn to the right at the last corner: the hull is convex there and the corner stays
                if turn < 0.0:
                    break
                corners -= 1
            corner[corners] = i
            corners += 1
        for k in range(corners - 1):
            a, b = corner[k], corner[k + 1]
            # between two corners the hull is a straight line; the curve can only lie below it
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
                # two neighbouring samples fall on one drawn cell
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
        # of n places, two samples apart and in the middle of the section: as much is left free at either side
        margin = (SAMPLES - (2 * values.shape[1] - 1)) // 2
        whole[1:-1, margin : SAMPLES - margin : 2] = values
    return whole[:, ::_EVERY]


_REACH = 6
"""Samples to either side that a local quadric is fitted to, of every second sample."""
_EDGE = 8  # samples at either end without curvature: the fit there is one-sided


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
    # the places of the fit: without the outer sections, every second sample away from the edges
    inner = slice(1, count - 1), slice(_EDGE, SAMPLES - _EDGE, 2)
    # first and second derivatives of z over x and y at the place itself
    d, e, a, b, c = (fit[..., k] for k in range(1, 6))
    long = np.sqrt(1.0 + d**2 + e**2)
    # K = (LN − M²) / (EG − F²), with the second fundamental form divided by the normal's length twice
    gauss = (a * c - b**2) / long**4
    across = np.sqrt(d**2 + e**2)
    # H of a graph z(x, y); positive where it is hollow from above
    mean = ((1 + e**2) * a - 2 * d * e * b + (1 + d**2) * c) / (2 * long**3)
    # H² ≥ K for every surface; rounding may break it where both curvatures are alike
    root = np.sqrt(np.maximum(mean**2 - gauss, 0.0))
    high, low = mean + root, mean - root
    # arctan2 copes with two equal curvatures, where their difference is 0
    index = 2.0 / np.pi * np.arctan2(high + low, high - low)
    return SurfaceShape(
        x_mm=x[inner],
        y_mm=y[inner],
        z_mm=heights[inner],
        slope_deg=np.degrees(np.arctan(across)),
        # the normal of z(x, y) is (−d, −e, 1): it leans downhill
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
    # every second sample: half the work, and neighbours share their noise after the smoothing
    near = places[:, None] + np.arange(-reach, reach + 1, 2)
    count = len(x)

    def about(values: Floats) -> Floats:
        """(section, place, point) values of the points about each place."""
        # the three sections about each place, of which the middle one is its own
        three = [values[k : count - 2 + k][:, near] for k in range(3)]
        return np.concatenate(three, axis=-1)

    # Scales make the equations even, whatever the spacing of the sections.
    wide = np.maximum(0.5 * np.abs(x[2:, first] - x[:-2, first]), 1e-9)[:, None]
    fine = np.maximum(np.abs(y[1:-1, first + 1] - y[1:-1, first]) * reach, 1e-9)[:, None]
    # in units of half the distance of the outer sections, and of the reach: about ±1 at the farthest points
    u = (about(x) - x[1:-1, places, None]) / wide[..., None]
    v = (about(y) - y[1:-1, places, None]) / fine[..., None]
    rows = np.stack([np.ones_like(u), u, v, 0.5 * u**2, u * v, 0.5 * v**2], axis=-1)
    across = np.swapaxes(rows, -1, -2)
    normal = across @ rows + _RIDGE * np.eye(rows.shape[-1])
    fit = np.linalg.solve(normal, across @ about(z)[..., None])[..., 0]
    # back from the scaled coordinates: each coefficient by the powers of x and y that it stands beside
    one = np.ones_like(wide)
    scales = np.stack([one, wide, fine, wide**2, wide * fine, fine**2], axis=-1)
    return np.asarray(fit / scales)
