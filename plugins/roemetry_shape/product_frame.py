"""A product's surface in its own frame: cross-sections at even places along it, whatever the rig.

Model. Stripes cut a product where the rig's planes happen to lie: obliquely, leaning with the light, 5 to 9
mm apart, and turned against the product's axis. Features read off such cuts are features of the rig. So the
cuts are lofted: sample j of each cut (at the j-th even place from edge to edge) is joined with sample j of
the next by a monotone cubic (Fritsch and Butland 1984) over the distance along the product's axis, which is
the line through the cuts' middles. The lofted surface is then cut again, upright and square to the axis, at
`STATIONS` even places between the first and the last point of the middle line.

Assumed: cuts run from edge to edge and follow each other along the axis; the product is turned by less than
about 45 degrees from the X axis. What lies between two stripes and shows on neither is not in it, whatever
the interpolation. The ends beyond the outer stripes are missing: `end_missing_mm` says by how much, from the
areas of the last cuts, which fall to nothing linearly at a rounded end.

With an outline, length and width are the outline's, and the outliner's features are added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import numpy as np

from roemetry.records import Product, Profiles, Reason
from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.image_levels import median_of
from roemetry_kernels.lens import sight_lines
from roemetry_kernels.slices import body_curves, smoothed

STATIONS = 41
"""Sections along a product: 2 mm apart on one of 80 mm, a third of the finest pitch of stripes in use; an odd
number, so that turning the product by 180 degrees maps stations onto stations. 31 or 61 change no feature by
more than 3 %."""


_STEP_MIN_MM = 0.01
"""Between two cuts: noise may let steep parts of neighbours change places; nothing divides by less."""


class Frame(NamedTuple):
    """A product's surface in its own frame."""

    sections: Sections
    """`STATIONS` sections square to the axis; `middle_mm` in the product's frame: along the axis, and off it.
    """
    pitch_mm: float
    """Median distance of the stripes along the axis, mm."""
    end_missing_mm: Floats
    """(2,) estimated length beyond the first and last section, mm; at most one pitch."""


def in_product_frame(sections: Sections) -> Frame:
    """Cut a product's surface square to its axis; `sections` are at least three cuts along stripes."""
    at, middle, half, height, x_mm, pitch, missing = cut_square(
        sections.x_mm, sections.middle_mm, sections.half_width_mm, sections.height_mm
    )
    square = Sections(
        stripe=np.arange(STATIONS),
        along_mm=at - at[0],
        middle_mm=middle,
        half_width_mm=half,
        height_mm=height,
        across_mm=half[:, None] * EVEN,
        x_mm=x_mm,
    )
    return Frame(square, pitch, missing)


@float_kernel
def cut_square(
    x_mm: Floats, middle_mm: Floats, half_width_mm: Floats, height_mm: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats, float, Floats]:
    """Loft cuts and cut them again, square to their axis.

    Parameters
    ----------
    x_mm, middle_mm, half_width_mm, height_mm
        As in `Sections`.

    Returns
    -------
    at : ndarray, shape (STATIONS,)
        Places along the axis.
    middle, half, height, x : ndarray, shape (STATIONS, 2), (STATIONS,), (STATIONS, SAMPLES) twice
        As in `Sections`, in the product's frame.
    pitch, missing
        As in `Frame`.
    """
    cuts, central = half_width_mm.size, SAMPLES // 2
    area, off_x, off_y = np.empty(cuts), x_mm[:, central].copy(), middle_mm[:, 1].copy()
    for k in range(cuts):
        # trapezoids, as in `Sections.area_mm2`: the two edge samples count half
        inner = height_mm[k].sum() - 0.5 * (height_mm[k, 0] + height_mm[k, SAMPLES - 1])
        area[k] = inner * 2.0 * half_width_mm[k] / (SAMPLES - 1)
    # the line through the middles, weighed by area; its slope by least squares over x, along which cuts lie
    # thick sections say where the axis is; a sliver at an end, whose middle is uncertain, hardly counts
    whole, x0, y0 = area.sum(), 0.0, 0.0
    for k in range(cuts):
        x0 += area[k] / whole * off_x[k]
        y0 += area[k] / whole * off_y[k]
    rise, run = 0.0, 0.0
    for k in range(cuts):
        off_x[k] -= x0
        off_y[k] -= y0
        rise += area[k] / whole * off_x[k] * off_y[k]
        run += area[k] / whole * off_x[k] * off_x[k]
    angle = math.atan2(rise, run)
    c, q = math.cos(angle), math.sin(angle)
    # in the order of their middles along the axis; the place of each sample rises from cut to cut
    order, along, sized = np.argsort(c * off_x + q * off_y, kind="mergesort"), np.empty(cuts), area.copy()
    knots, surface = np.empty((cuts, SAMPLES)), np.empty((2, cuts, SAMPLES))
    for k in range(cuts):
        of = order[k]
        sized[k] = area[of]
        for j in range(SAMPLES):
            x, y = x_mm[of, j] - x0, middle_mm[of, 1] + half_width_mm[of] * EVEN[j] - y0
            s = c * x + q * y
            if j == central:
                along[k] = s
            # where a stripe leans or is oblique its samples have places of their own; steps stay positive, so
            # that slopes are finite
            knots[k, j] = max(s, knots[k - 1, j] + _STEP_MIN_MM) if k else s
            # beside the height the place across is lofted, too: where a section lies off the axis between two
            # cuts
            surface[0, k, j], surface[1, k, j] = height_mm[of, j], c * y - q * x
    # from the first central point to the last; nothing is extrapolated
    at = along[0] + (along[-1] - along[0]) / (STATIONS - 1) * np.arange(STATIONS)
    square = lofted(knots, surface, at)
    heights, across = square[0], square[1]
    middle, half = np.empty((STATIONS, 2)), np.empty(STATIONS)
    grid, x_out = np.empty((STATIONS, SAMPLES)), np.empty((STATIONS, SAMPLES))
    for i in range(STATIONS):
        for j in range(SAMPLES):
            # noise puts the foot of a section below the belt; a height below 0 is no height
            heights[i, j] = max(heights[i, j], 0.0)
            if j:
                # `on_even_places` needs places that do not fall; lofting sample by sample may cross
                # neighbours
                across[i, j] = max(across[i, j], across[i, j - 1])
        half[i] = max(0.5 * (across[i, SAMPLES - 1] - across[i, 0]), 1e-6)
        middle[i, 0], middle[i, 1] = at[i], 0.5 * (across[i, 0] + across[i, SAMPLES - 1])
        for j in range(SAMPLES):
            # even places again: lofted ones are uneven where edges of neighbouring cuts differ
            grid[i, j], x_out[i, j] = middle[i, 1] + half[i] * EVEN[j], at[i]
    pitch, missing = median_of(along[1:] - along[:-1]), np.empty(2)
    for end in range(2):
        outer, inner_one = (0, 1) if end == 0 else (cuts - 1, cuts - 2)
        # where the area, falling as from the cut before it, would be nothing
        fall = (sized[inner_one] - sized[outer]) / max(abs(along[inner_one] - along[outer]), 1e-6)
        # at most one pitch: a longer end would have met another stripe. Where the area does not fall nothing
        # is known but that: half a pitch
        missing[end] = min(sized[outer] / fall, pitch) if fall > 0.0 else 0.5 * pitch
    return at, middle, half, on_even_places(across, heights, grid), x_out, pitch, missing


@float_kernel
def lofted(knots: Floats, values: Floats, at: Floats) -> Floats:
    """Interpolate (value, cut, sample) values over (cut, sample) rising places: (value, station, sample).

    Piecewise cubic with the slopes of Fritsch and Butland (1984): it neither overshoots nor rings. Beyond the
    first and last cut of a sample the value stays.
    """
    kinds, cuts, samples = values.shape
    out = np.empty((kinds, at.size, samples))
    slope, secant = np.zeros(cuts), np.empty(cuts - 1)
    for kind in range(kinds):
        for j in range(samples):
            # knots are the samples' own places along the axis, different for each of them
            for k in range(cuts - 1):
                secant[k] = (values[kind, k + 1, j] - values[kind, k, j]) / (knots[k + 1, j] - knots[k, j])
            # one-sided at the ends: there is no cut beyond them
            slope[0], slope[-1] = secant[0], secant[-1]
            for k in range(1, cuts - 1):
                before, after = knots[k, j] - knots[k - 1, j], knots[k + 1, j] - knots[k, j]
                # weights of the harmonic mean: the shorter interval counts more
                one, other = before + 2.0 * after, 2.0 * before + after
                # where the secants change sign the cut is a crest or a trough: level there, so nothing
                # overshoots
                slope[k] = 0.0
                if secant[k - 1] * secant[k] > 0.0:
                    mean = one * secant[k] + other * secant[k - 1]
                    slope[k] = (one + other) * secant[k - 1] * secant[k] / mean
            k = 0
            for station in range(at.size):
                # stations rise, so the interval is only ever left upwards
                while k < cuts - 2 and at[station] >= knots[k + 1, j]:
                    k += 1
                h = knots[k + 1, j] - knots[k, j]
                # beyond the outer cuts u stays 0 or 1: the value of the cut
                u = min(max((at[station] - knots[k, j]) / h, 0.0), 1.0)
                v = 1.0 - u
                # Hermite's cubic in u and v = 1 − u
                out[kind, station, j] = (
                    values[kind, k, j] * (v * v * (1.0 + 2.0 * u))
                    + values[kind, k + 1, j] * (u * u * (1.0 + 2.0 * v))
                    + h * u * v * (slope[k] * v - slope[k + 1] * u)
                )
    return out


@float_kernel
def on_even_places(across: Floats, heights: Floats, grid: Floats) -> Floats:
    """Interpolate each row of heights from its places across, which do not fall, to those of a grid."""
    out = np.empty_like(grid)
    last = across.shape[1] - 1
    for row in range(grid.shape[0]):
        before = 0
        for k in range(grid.shape[1]):
            place = grid[row, k]
            while before < last - 1 and across[row, before + 1] <= place:
                before += 1
            wide = across[row, before + 1] - across[row, before]
            # places that fall together have no slope: the later one counts
            share = min(max((place - across[row, before]) / wide, 0.0), 1.0) if wide > 0.0 else 1.0
            out[row, k] = heights[row, before] + share * (heights[row, before + 1] - heights[row, before])
    return out


SAMPLES = 65
"""Samples across a section; an odd number, so that one is its middle."""

EVEN = np.linspace(-1.0, 1.0, SAMPLES)
"""Their places, from one edge to the other."""
_POINTS_MIN = 12  # of a section: fewer show no course across it
_WIDTH_MIN_MM = 2.0  # of a section: narrower is a tip or a speck
_SLIVER = 0.15
"""Of the largest height: whether a stripe still shows a lower outer section is a matter of light."""

_GAP_MAX = 2.0 / 3.0
"""Of a section's width: where more is missing in one piece, two slivers at the foot are no section."""


class Sections(NamedTuple):
    """Cross-sections in the order in which they lie along the product's long way."""

    stripe: Integers
    """(section,) stripe index."""
    along_mm: Floats
    """(section,) place of each section's middle along the way through the middles, mm, from the first."""
    middle_mm: Floats
    """(section, 2) X and Y of the middle between its edges, mm."""
    half_width_mm: Floats
    """(section,) half the distance between its edges, mm."""
    height_mm: Floats
    """(section, SAMPLES) height over the belt at even steps from edge to edge, mm."""
    across_mm: Floats
    """(section, SAMPLES) distance from the middle along Y, mm."""
    x_mm: Floats
    """(section, SAMPLES) X of the same places: a plane of light leans, so a section's X changes with height.
    """

    @property
    def peak_mm(self) -> Floats:
        """(section,) largest height, mm."""
        return np.asarray(self.height_mm.max(axis=1))

    @property
    def area_mm2(self) -> Floats:
        """(section,) area between belt and surface, mm²."""
        step = 2.0 * self.half_width_mm / (SAMPLES - 1)
        inner = self.height_mm.sum(axis=1) - 0.5 * (self.height_mm[:, 0] + self.height_mm[:, -1])
        return np.asarray(inner * step)


def sections_of(product: Product, smoothing_mm: float) -> Sections:
    """Cut a product into its sections; those too short or too torn to have a shape are left out.

    So are outer ones lower than 15 % of it: one more or less of them would change what is said of the
    ends.

    Parameters
    ----------
    product
        Its slices must run along Y, as those of stripes that run from top to bottom do.
    smoothing_mm
        Length of the local quadratic that smooths each curve first, mm, so that a rig of other rows smooths
        as much; 0 smooths nothing.
    """
    return cut_of(product.profiles, product.number, smoothing_mm)


def cut_of(profiles: Profiles, product: int, smoothing_mm: float) -> Sections:
    """Cut the product of a number, as `sections_of` does."""
    curves = body_curves(profiles, product)
    xyz = profiles.xyz_mm[curves.slice, curves.point]
    if smoothing_mm and len(xyz) > 1:
        xyz = smoothed(curves, xyz, _window(xyz[:, 1], smoothing_mm))
    slices, middle, half, height, x_mm = cuts_in_line(xyz, curves.slice)
    step = middle[1:] - middle[:-1]
    return Sections(
        stripe=profiles.stripe[slices].astype(np.int64),
        along_mm=np.append(0.0, np.cumsum(np.hypot(step[:, 0], step[:, 1])))[: half.size],
        middle_mm=middle,
        half_width_mm=half,
        height_mm=height,
        across_mm=half[:, None] * EVEN,
        x_mm=x_mm,
    )


@kernel
def cuts_in_line(xyz: Floats, slices: Integers) -> tuple[Integers, Floats, Floats, Floats, Floats]:
    """Put each slice's points on even places across; slices too short, too torn or too low are left out.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3)
        Slice after slice; of points at one place the first counts.
    slices : ndarray, shape (n,)
        The slice of each.

    Returns
    -------
    slice : ndarray, shape (cut,)
        The slice of each cut, in the order in which their middles lie along x.
    middle, half, height, x : ndarray, shape (cut, 2), (cut,), (cut, SAMPLES), (cut, SAMPLES)
        As in `Sections`.
    """
    total, most = slices.size, 0
    # slices come one after another: each change of number begins a new one
    for k in range(total):
        most += k == 0 or slices[k] != slices[k - 1]
    of, middle, half = np.empty(most, np.int64), np.empty((most, 2)), np.empty(most)
    height, x_mm = np.empty((most, SAMPLES)), np.empty((most, SAMPLES))
    on, order, count, begin = np.empty_like(xyz), np.empty(total, np.int64), 0, 0
    while begin < total:
        stop = begin
        while stop < total and slices[stop] == slices[begin]:
            stop += 1
        placed = 0
        for m in range(stop - 1, begin - 1, -1):  # rows run down, y up: each mostly goes to the end
            k = placed
            while k > 0 and xyz[order[k - 1], 1] >= xyz[m, 1]:
                order[k] = order[k - 1]
                k -= 1
            order[k] = m
            placed += 1
        points, step = 0, 0.0
        for k in range(placed):
            m = order[k]
            # of points at one place only the first is taken; steps between the others are positive
            if k == 0 or xyz[m, 1] > on[points - 1, 1]:
                on[points] = xyz[m]
                if points:
                    step = max(step, on[points, 1] - on[points - 1, 1])
                points += 1
        # a slice of few points, narrow, or torn in the middle shows no course across
        low, wide = on[0, 1], on[points - 1, 1] - on[0, 1]
        if points >= _POINTS_MIN and wide >= _WIDTH_MIN_MM and step <= _GAP_MAX * wide:
            before = 0
            for sample in range(SAMPLES):
                y = low + wide * sample / (SAMPLES - 1)
                while before < points - 2 and on[before + 1, 1] <= y:
                    before += 1
                share = (y - on[before, 1]) / (on[before + 1, 1] - on[before, 1])
                height[count, sample] = on[before, 2] + share * (on[before + 1, 2] - on[before, 2])
                x_mm[count, sample] = on[before, 0] + share * (on[before + 1, 0] - on[before, 0])
            of[count], half[count] = slices[begin], 0.5 * wide
            middle[count, 0] = median_of(xyz[begin:stop, 0].copy())
            middle[count, 1] = low + 0.5 * wide
            count += 1
        begin = stop
    # a stable order, so that equal places keep the order of the stripes
    along = np.argsort(middle[:count, 0].copy(), kind="mergesort")
    peak = np.empty(count)
    for k in range(count):
        peak[k] = height[along[k]].max()
    # outer slivers go one by one from either end; a low section between high ones is a waist and stays
    first, last = 0, count
    while first < last and peak[first] < _SLIVER * peak.max():
        first += 1
    while last > first and peak[last - 1] < _SLIVER * peak.max():
        last -= 1
    kept = along[first:last]
    return of[kept], middle[kept], half[kept], height[kept], x_mm[kept]


def _window(y_mm: Floats, smoothing_mm: float) -> int:
    """Odd number of points whose length is nearest to `smoothing_mm`."""
    step: float = median_of(np.abs(y_mm[1:] - y_mm[:-1]))
    return 2 * round(0.5 * (smoothing_mm / max(step, 1e-3) - 1.0)) + 1


_ENDS = (0, -1)  # first and last section


_SURE = 2.0  # standard deviations: 95 %, as of the intervals


def decisive_feature(
    features: Mapping[str, float],
    names: Collection[str],
    called: str,
    call: Callable[[Mapping[str, float]], str],
) -> Reason | None:
    """Say which feature may as well be one that makes another class; None where none may.

    Parameters
    ----------
    features
        By name; of some the standard uncertainty stands beside them, as `NAME_std`.
    names
        Those that are judged by.
    called
        The class.
    call
        Gives the class of other features.
    """
    # one feature at a time: together they could make almost any class
    for name in sorted(names):
        std = features.get(f"{name}_std", 0.0)
        # a feature without uncertainty is taken as exact: nothing to try
        for value in (features[name] - _SURE * std, features[name] + _SURE * std) if std > 0.0 else ():
            other = call({**features, name: value})
            if other != called:
                return Reason(
                    "feature-unsure",
                    f"{name} is {features[name]:.3g} ± {_SURE * std:.2g} (95 %): "
                    f"{called} may as well be {other}",
                )
    return None


def outline_features(product: Product, sections: Sections) -> dict[str, float]:
    """Give ``length_mm``, ``across_mm`` and ``footprint_mm2``, where there are an outline and a view.

    The outliner's own features go with them, such as its bend and colours; but for those in pixels, which
    would be others on a rig of another scale.

    The outline is where the surface turns away from the camera: it is taken to lie as high as the sections
    end, on the median. Length and width are the sides of the smallest rectangle around it, so they do not
    depend on how the product lies.
    """
    outline, view = product.outline, product.view
    if outline is None:
        return {}
    seen = {name: value for name, value in outline.features.items() if not name.endswith(("_px", "_px2"))}
    if view is None or not len(sections.stripe):
        return seen
    import cv2

    ends_mm = np.maximum(sections.height_mm[:, _ENDS], 0.0)
    start, way = sight_lines(view, outline)
    # each sight line is followed down (or up) to that height over the belt
    along = (median_of(ends_mm.ravel()) - start[:, 2]) / way[:, 2]
    x, y = (start[:, k] + along * way[:, k] for k in (0, 1))
    # a sight line that runs level never comes to that height
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        return seen
    # OpenCV reckons in float32: about the middle that is enough.
    about = np.stack([x - x.mean(), y - y.mean()], axis=1).astype(np.float32)
    sides = cv2.minAreaRect(about)[1]
    # Gauss's formula for the area within a closed polygon; the last product closes it
    area = 0.5 * abs(float(x[:-1] @ y[1:] - y[:-1] @ x[1:] + x[-1] * y[0] - y[-1] * x[0]))
    size = {"length_mm": float(max(sides)), "across_mm": float(min(sides)), "footprint_mm2": area}
    # an outliner that states a size itself has measured it; it counts
    return {**size, **seen}
