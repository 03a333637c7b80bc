"""A product's shape in numbers: millimetres, degrees and ratios, the same on every rig that shows it.

Model. All features but those of humps are read off the surface in the product's own frame
(`roemetry_shape.product_frame`), at even places along the product, so that they do not depend on the number
and distance of the stripes, the direction and side of the light, the camera's scale, or how the product
lies. None has a sign or a head end: a product that is mirrored or turned about gives the same numbers (a
twist turns the other way when mirrored; its size stays). All but sizes and what lies beyond the ends are of
the part of each section above `_FOOT` of its height: where the last lit row lies on a steep flank differs by
a millimetre from rig to rig, and an edge that does moves middles, leans and domes.

    axis         m(s) through the sections' middles: bend, bow, S and W against a straight line, and the one
                 kink that explains it best; the same kink of the line through the centres of area
    lean         angle between the flanks of a section; its run along s is twist. Turning a section also makes
                 it narrower and higher, which a lopsided one is not: the spread of height over width
    hollows      depth below the upper convex hull of each section (across) and of each line along (saddles);
                 what lies below both is a cup, the mark of a dent
    pit          depth below a smooth dome that fits most of the surface (robust): a dent that hollows nothing
    runs         heights and widths along s as shares of the largest: at the ends, and what is left of them
                 beside a quartic (Legendre): dips and bumps
    beyond       how many stripes should still have met a product that thins as its outer cuts do

Which of them tell what was found by leaving each out (multinomial regression on three families of bodies on
random rigs): the shape of the run of volume along the product, asymmetry and the slopes told nothing more.

It fails where fewer than three stripes show a cross-section (no features), and where a defect lies between
two stripes (nothing is seen of it). How far each feature spreads over rigs for the same body is measured by
`python -m benchmarks grade`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roemetry.records import Product, Profiles, Relief
from roemetry.records.arrays import Floats
from roemetry_kernels.compiling import float_kernel, kernel
from roemetry_kernels.image_levels import median_of, nth_smallest
from roemetry_shape.product_frame import (
    EVEN,
    SAMPLES,
    STATIONS,
    Frame,
    Sections,
    cut_of,
    in_product_frame,
    outline_features,
)
from roemetry_shape.regions import (
    DENT_LEAST_MM,
    Region,
    dome_over,
    hollow_depth,
    hollows_of,
    humps_of,
    regions_of,
    relief_of,
    surface_shape,
)

SECTIONS_MIN = 3
"""With fewer sections a product has no shape to speak of."""

SMOOTHING_MM = 3.0
"""Window of the quadratic along each curve: a third of the narrowest dent's width (8 mm),
whose depth it lowers by 2 %; 2 or 4 mm change no feature by more than noise does."""

_ALONG = slice(STATIONS // 10, STATIONS - STATIONS // 10)
"""Stations away from the ends, where sections shrink and few samples make them."""

_EDGE = SAMPLES // 8
_LINES = tuple(range(_EDGE, SAMPLES - _EDGE, 2))
"""Samples at either edge, where a section is steep by nature; and those followed along the product."""

_PATCH_MM2 = 4.0
"""A depth is one that so much of the surface reaches: half of the least dent that a stripe
shows over its 8 mm. The single deepest sample would be a sample of the noise; 2 or 8 mm² change no dent's
depth by over a tenth."""


class Shape(NamedTuple):
    """Features by name (none with fewer than three sections), and the surface they were read off."""

    features: dict[str, float]
    relief: Relief | None = None


def shape_of(product: Product, smoothing_mm: float = SMOOTHING_MM) -> Shape:
    """Measure a product's shape.

    `length_seen_mm` counts what stripes saw: it ends at the outer stripes. `length_mm`, `across_mm` and
    `footprint_mm2` are the outline's, and are there only if it is.

    Parameters
    ----------
    product
        One product.
    smoothing_mm
        Window, mm, that smooths each curve first; see `sections_of`.
    """
    cuts, above_mm, humps, of_surface = _surface_of(product.profiles, product.number, smoothing_mm)
    if len(cuts.stripe) < SECTIONS_MIN:
        return Shape({})
    features = {**of_surface, **outline_features(product, cuts)}
    # here of the cuts as the stripes made them: the report draws where something was seen, not where it was
    # interpolated
    below_mm, dents = hollows_of(cuts)
    # below and above are told from two references, the hull and the dome; the larger deviation is drawn
    stands_out_mm = np.where(below_mm >= above_mm, -below_mm, above_mm)
    relief = relief_of(cuts, surface_shape(cuts), stands_out_mm, {"dent": dents, "hump": humps}, features)
    return Shape(features, relief)


def shape_features(product: Product, smoothing_mm: float = SMOOTHING_MM) -> dict[str, float]:
    """Give the features alone; empty with fewer than three sections."""
    cuts, _, _, of_surface = _surface_of(product.profiles, product.number, smoothing_mm)
    # an outline alone is no shape: without sections nothing is judged
    return {**of_surface, **outline_features(product, cuts)} if of_surface else {}


class _Surface(NamedTuple):
    """What a product's surface tells, whatever its outline."""

    cuts: Sections
    above_mm: Floats
    humps: tuple[Region, ...]
    features: dict[str, float]


@lru_cache(maxsize=8)
def _surface_of(profiles: Profiles, number: int, smoothing_mm: float) -> _Surface:
    """Measure the surface of one product; where its outline alone has moved, it is not measured again."""
    cuts = cut_of(profiles, number, smoothing_mm)
    if len(cuts.stripe) < SECTIONS_MIN:
        return _Surface(cuts, np.empty((0, SAMPLES)), (), {})
    above_mm, humps = humps_of(cuts)
    return _Surface(cuts, above_mm, humps, {**features_of(cuts), **_hump_features(humps)})


def features_of(cuts: Sections) -> dict[str, float]:
    """Give the features of a product's surface, of at least three cuts along stripes."""
    frame = in_product_frame(cuts)
    # sizes and what is missing beyond the ends need whole sections; all that follows only what stands above
    # the foot
    body = _above_foot(frame.sections)
    return {
        **_size(frame),
        **_axis(body),
        **dict(zip(_LEAN, lean_numbers(body.height_mm, body.half_width_mm), strict=True)),
        **_hollows(body),
        **_pits(body),
        **_runs(body),
        **_beyond(cuts, frame.pitch_mm),
    }


def _above_foot(sections: Sections) -> Sections:
    """Sections from where they reach `_FOOT` of their height on one side to where they do on the other.

    Where a section's last lit row lies on its steep foot is a matter of light: an edge that is seen 1 mm
    farther out moves the middle by half of it, and a dome off its middle leans.
    """
    middle, half, height = above_foot(
        sections.height_mm, sections.across_mm, sections.middle_mm, sections.half_width_mm
    )
    return sections._replace(
        middle_mm=middle, half_width_mm=half, height_mm=height, across_mm=half[:, None] * EVEN
    )


@float_kernel
def above_foot(
    height_mm: Floats, across_mm: Floats, middle_mm: Floats, half_width_mm: Floats
) -> tuple[Floats, Floats, Floats]:
    """Give (section, 2) middles, (section,) half widths and (section, sample) heights above the foot."""
    sections, last = half_width_mm.size, SAMPLES - 1
    middle, half, out = middle_mm.copy(), np.empty(sections), np.empty((sections, SAMPLES))
    for k in range(sections):
        height, across = height_mm[k], across_mm[k]
        level = _FOOT * height.max()
        # from either edge inwards to the first sample as high as the foot; a dent in between is not looked
        # for
        low, high = 0, last
        while low < last and height[low] < level:
            low += 1
        while high > 0 and height[high] < level:
            high -= 1
        from_mm, to_mm = across[low], across[high]
        # back from that sample to where a straight line to its outer neighbour crosses the level
        if low > 0:
            back = (height[low] - level) / max(height[low] - height[low - 1], 1e-9)
            from_mm -= (across[low] - across[low - 1]) * back
        if high < last:
            back = (height[high] - level) / max(height[high] - height[high + 1], 1e-9)
            to_mm -= (across[high] - across[high + 1]) * back
        # half widths and steps are divided by: nothing may be 0
        half[k] = max(0.5 * (to_mm - from_mm), 1e-6)
        middle[k, 1] += 0.5 * (from_mm + to_mm)
        # the places that come in are even, so an index is a distance over the step
        step = max((across[last] - across[0]) / last, 1e-12)
        for j in range(SAMPLES):
            at = from_mm + (to_mm - from_mm) * (0.5 + 0.5 * EVEN[j])
            share = min(max((at - across[0]) / step, 0.0), last)
            below = min(int(share), last - 1)
            share -= below
            out[k, j] = height[below] + share * (height[below + 1] - height[below])
    return middle, half, out


_FOOT = 0.4
"""Of a section's height: below, a body's flank is too steep to be seen the same on every rig."""


def _size(frame: Frame) -> dict[str, float]:
    sections = frame.sections
    # stripes see an end only by chance; a length without it would depend on where the stripes fell
    length = float(sections.along_mm[-1] + frame.end_missing_mm.sum())
    width, thickness, area, least, middle = size_of(sections.half_width_mm, sections.height_mm)
    return {
        "length_seen_mm": float(sections.along_mm[-1]),
        "length_extrapolated_mm": length,
        "width_mm": width,
        "thickness_mm": thickness,
        "length_to_width": length / width,
        "thickness_to_width": thickness / width,
        "section_area_max_mm2": area,
        # How much of its own box a section fills: a half-ellipse π/4, a box 1, a hollow one less.
        "fullness_least": least,
        "fullness_median": middle,
    }


@float_kernel
def size_of(half_width_mm: Floats, height_mm: Floats) -> tuple[float, float, float, float, float]:
    """Give largest width, height and area of (station, sample) sections, and how much of a box they fill."""
    width, full = np.empty(STATIONS), np.empty(STATIONS)
    peak, largest = np.empty(STATIONS), 0.0
    for k in range(STATIONS):
        # trapezoids: the two edge samples count half
        width[k], peak[k] = 2.0 * half_width_mm[k], height_mm[k].max()
        area = height_mm[k].sum() - 0.5 * (height_mm[k, 0] + height_mm[k, SAMPLES - 1])
        area *= width[k] / (SAMPLES - 1)
        largest, full[k] = max(largest, area), area / max(width[k] * peak[k], 1e-9)
    full = full[_ALONG]
    return width[_ALONG].max(), peak[_ALONG].max(), largest, full.min(), median_of(full)


_AXIS = ("bend_mm", "bow_mm", "s_bend_mm", "w_bend_mm", "kink_deg", "kink_rest_mm", "edge_kink_deg")


def _axis(sections: Sections) -> dict[str, float]:
    """Bend of the line through the sections' middles, and of that through their centres of area."""
    of = sections.along_mm, sections.middle_mm, sections.height_mm, sections.across_mm
    return dict(zip(_AXIS, axis_numbers(*of), strict=True))


@float_kernel
def axis_numbers(
    along_mm: Floats, middle_mm: Floats, height_mm: Floats, across_mm: Floats
) -> tuple[float, float, float, float, float, float, float]:
    """Give what `_AXIS` names; stations are even, so every fit along them is the same matrix."""
    middle, of_area = middle_mm[:, 1].copy(), np.empty(STATIONS)
    for k in range(STATIONS):
        moment, whole = 0.0, 0.0
        for j in range(SAMPLES):
            moment += height_mm[k, j] * across_mm[k, j]
            whole += height_mm[k, j]
        # the centre of area, not of the edges: a bulge to one side moves it though the edges stay straight
        of_area[k] = middle[k] + moment / max(whole, 1e-9)
    # m(s) off the axis at even stations; every fit below is a constant row times this
    off = middle[_ALONG].copy()
    level, slope, bend = _dot(_LINE[0], off), _dot(_LINE[1], off), 0.0
    for k in range(off.size):
        bend = max(bend, abs(off[k] - level - slope * _PLACES[k]))
    # the even wave (W): the coefficient of P₄, of all stations but the outer two
    wave = _dot(_FIFTH_WAVE, middle[_ENDLESS].copy())
    # kinks of the line through the centres of area, and of the one midway between the edges
    (turn, left), (of_edges, _) = _kink(of_area), _kink(middle)
    # stations are even, so the second one's place is the step, mm; mm a station over mm a station is a slope
    step = along_mm[1]
    return (
        bend, abs(_dot(_BOW, off)), abs(_dot(_S_BEND, off)), abs(wave),
        math.degrees(math.atan(turn / step)), left, math.degrees(math.atan(of_edges / step)),
    )  # fmt: skip


@float_kernel
def _dot(one: Floats, other: Floats) -> float:
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


_POWERS = np.linspace(-1.0, 1.0, STATIONS)[_ALONG, None] ** np.arange(4)
# scaled so that the outermost station kept is at ±1: coefficients are then mm at the ends
_POWERS /= np.abs(_POWERS[0, 1]) ** np.arange(4)
_PLACES = _POWERS[:, 1].copy()
_LINE, _BOW, _S_BEND = (
    # rows of the pseudo-inverse: a coefficient of the fit is one scalar product
    np.ascontiguousarray(np.linalg.pinv(_POWERS[:, : degree + 1])[part])
    for degree, part in ((1, slice(0, 2)), (2, 2), (3, 3))
)
"""Place along, from −1 at one end to 1, and what fits a line, and the last term of two and three degrees."""


def _hinges() -> tuple[Floats, Floats]:
    """(hinge, station) lines with one kink, free of their straight part, of length 1; and these lengths."""
    at = np.arange(STATIONS, dtype=np.float64)[_ENDLESS]
    straight = np.stack([np.ones_like(at), at], axis=1)
    # 0 before its corner, rising by one a station after it: its coefficient is the turn
    hinge = np.maximum(at[:, None] - at[_REACH:-_REACH], 0.0)
    # without its straight part, so that a slanted but straight line has no kink
    rest = hinge - straight @ np.linalg.lstsq(straight, hinge, rcond=None)[0]
    length = np.sqrt((rest**2).sum(axis=0))
    # length 1: the scalar product with a hinge is then what it explains, and hinges can be compared
    return np.ascontiguousarray((rest / length).T), length


_ENDLESS = slice(2, STATIONS - 2)
"""Stations without the outer two, which the last cut alone makes."""

_REACH = STATIONS // 7
"""Stations to either side of a kink that show that the line has turned: 12 mm on a skein of 80 mm."""

_HINGES, _HINGE_LENGTHS = _hinges()
_LEVER = np.linspace(-1.0, 1.0, STATIONS - 4)
_LEVER /= np.sqrt(_LEVER @ _LEVER)
_FIFTH_WAVE = np.ascontiguousarray(
    np.linalg.pinv(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, STATIONS)[_ENDLESS], 5))[4]
)
"""What gives the fourth coefficient of a fit by Legendre's polynomials up to the fifth."""


@float_kernel
def _kink(off_mm: Floats) -> tuple[float, float]:
    """Turn in mm a station, and what is left, rms mm, of the line with one kink that fits best."""
    off = off_mm[_ENDLESS].copy()
    # level and slope go first; what is left is explained by a hinge or by nothing
    off -= off.mean()
    off -= _LEVER * _dot(_LEVER, off)
    best, most = 0, 0.0
    for k in range(_HINGES.shape[0]):
        along = _dot(_HINGES[k], off)
        if abs(along) > abs(most):
            best, most = k, along
    # Pythagoras: the hinge is of length 1 and is square to the straight part
    left = math.sqrt(max(_dot(off, off) - most * most, 0.0) / off.size)
    # back from the hinge of length 1 to mm a station
    return abs(most / _HINGE_LENGTHS[best]), left


_INNER, _SHOULDER = (0.05, 0.4), (0.4, 0.7)
"""Parts of a section's half width whose lean is told: near the ridge, and on the flanks."""


_LEAN = (
    "twist_deg", "twist_of_ends_deg", "twist_of_flanks_deg", "lean_range_deg", "lean_uneven_deg",
    "stoutness_spread",
)  # fmt: skip


@float_kernel
def lean_numbers(height_mm: Floats, half_width_mm: Floats) -> tuple[float, float, float, float, float, float]:
    """Give what `_LEAN` names; the lean itself is told in degrees."""
    lean, ratio = np.empty((2, STATIONS)), np.empty(STATIONS)
    for k in range(STATIONS):
        for part in range(2):
            # weights times heights is mm over half widths; divided by the half width it is a slope
            lean[part, k] = math.degrees(math.atan(_dot(_LEANS[part], height_mm[k]) / half_width_mm[k]))
        # A section that is turned about its middle is narrower and higher than one that lies flat.
        ratio[k] = height_mm[k].max() / max(2.0 * half_width_mm[k], 1e-9)
    inner = lean[0]
    # _U has mean 0: the level of the lean does not enter its slope
    turn = _dot(_U, inner) / _dot(_U, _U)  # over half the length: stations are even
    # what neither level nor even twist explains: a lean that jumps along the product
    rest = (inner - inner.mean() - turn * _U)[_ALONG]
    # the middle fifth of the length: a ratio at the ends is of thin, uncertain sections
    middle = median_of(ratio[2 * _FIFTH : -2 * _FIFTH].copy())
    along = inner[_ALONG]
    return (
        2.0 * abs(turn), _end_to_end(inner), _end_to_end(lean[1]), along.max() - along.min(),
        math.sqrt((rest * rest).mean()), ratio[4:-4].std() / middle,
    )  # fmt: skip


def _lean_weights(part: tuple[float, float]) -> Floats:
    """(sample,) what gives, of heights, the mean slope to one side over part of the half width."""
    # 1/t is odd: whatever is alike on both sides, a dome, cancels; what is left is the slope from side to
    # side
    weights = np.where((np.abs(EVEN) > part[0]) & (np.abs(EVEN) < part[1]), 1.0, 0.0)
    return np.asarray(weights / np.where(weights > 0.0, EVEN, 1.0) / weights.sum())


_LEANS = np.stack([_lean_weights(part) for part in (_INNER, _SHOULDER)])
"""(2, sample) of the part near the ridge, and of the flanks."""


@float_kernel
def _end_to_end(values: Floats) -> float:
    # the mean of five stations against that of the last five, not one noisy section against another
    seventh = STATIONS // 7
    return float(abs(values[:seventh].mean() - values[-seventh:].mean()))


def _hollows(sections: Sections) -> dict[str, float]:
    """Depths below the hulls across and along, and the dents: regions below those across."""
    of = sections.along_mm, sections.half_width_mm, sections.height_mm, sections.across_mm
    across, *numbers = hollow_numbers(*of)
    # less area than the patch is noise that happens to exceed the least depth
    dents = [one for one in regions_of(across, sections, DENT_LEAST_MM) if one.area_mm2 >= _PATCH_MM2]
    return {
        **dict(zip(_HOLLOWS, numbers, strict=True)),
        "dent_depth_mm": dents[0].depth_mm if dents else 0.0,
        "dent_area_mm2": dents[0].area_mm2 if dents else 0.0,
        "dents": float(len(dents)),
    }


_HOLLOWS = (
    "hollow_depth_mm", "hollow_median_mm", "hollow_mean_mm", "saddle_mm", "saddle_share",
    "saddle_median_mm", "saddle_least_mm", "cup_depth_mm", "cup_volume_mm3",
)  # fmt: skip


@kernel
def hollow_numbers(
    along_mm: Floats, half_width_mm: Floats, height_mm: Floats, across_mm: Floats
) -> tuple[Floats, float, float, float, float, float, float, float, float, float]:
    """Give (station, sample) depths below the hulls across, and what `_HOLLOWS` names."""
    across = hollow_depth(across_mm, height_mm)
    # At its edges a section ends where the last row was seen: a step there is no hollow.
    across[:, :_EDGE] = 0.0
    across[:, SAMPLES - _EDGE :] = 0.0
    first, stations, lines = STATIONS // 10, STATIONS - 2 * (STATIONS // 10), len(_LINES)
    s, surface = np.empty((lines, stations)), np.empty((lines, stations))
    for line in range(lines):
        for k in range(stations):
            # along the product every second sample is followed; its neighbours show the same saddle
            s[line, k], surface[line, k] = along_mm[first + k], height_mm[first + k, _LINES[line]]
    along = hollow_depth(s, surface)
    saddles, deepest, cup = np.empty(lines), np.empty(STATIONS), np.empty((stations, lines))
    for line in range(lines):
        saddles[line] = along[line].max()
        for k in range(stations):
            # the lesser of the two depths: a cup is closed on all sides, a groove or a saddle in one
            # direction only
            cup[k, line] = min(across[first + k, _LINES[line]], along[line, k])
    sample, volume = np.empty(STATIONS), 0.0  # mm² of a sample
    for k in range(STATIONS):
        deepest[k] = across[k].max()
        # width of a sample times the distance of stations, mm²
        sample[k] = 2.0 * half_width_mm[k] / (SAMPLES - 1) * along_mm[1]
    # only every second sample is a line, so each stands for two
    every_second = 2.0 * sample[first : first + stations]
    for k in range(stations):
        volume += cup[k].sum() * every_second[k]
    # the third deepest of the lines: one or two of them may be noise
    third = nth_smallest(saddles, lines - 3)
    return (
        across, depth_reached(across, sample, _PATCH_MM2), median_of(deepest), across.mean(), third,
        third / max(height_mm.max(), 1e-9), nth_smallest(saddles, lines // 2),
        nth_smallest(saddles, lines // 10), depth_reached(cup, every_second, _PATCH_MM2), volume,
    )  # fmt: skip


@kernel
def depth_reached(depth: Floats, area_mm2: Floats, patch_mm2: float) -> float:
    """Depth that so much of the surface reaches: (row, sample) depths, and (row,) each sample's area."""
    # were all samples as small as the smallest, so many would reach the patch: no more need to be kept
    most = min(int(patch_mm2 / area_mm2.min()) + 1, depth.size)
    deepest, area = np.full(most, -np.inf), np.zeros(most)
    for row in range(depth.shape[0]):
        for sample in range(depth.shape[1]):
            value, k = depth[row, sample], most - 1
            if not value > deepest[k]:
                continue
            # insertion into the list of the deepest, in falling order
            while k > 0 and value > deepest[k - 1]:
                deepest[k], area[k] = deepest[k - 1], area[k - 1]
                k -= 1
            deepest[k], area[k] = value, area_mm2[row]
    total = 0.0
    for k in range(most):
        # from the deepest on, until the patch is filled: the depth of the sample that fills it
        total += area[k]
        if total >= patch_mm2:
            return float(deepest[k])
    return float(deepest[most - 1])


def _pits(sections: Sections) -> dict[str, float]:
    """Depth below a smooth dome that fits most of the surface, and how smooth the surface is against it."""
    deepest, rms, middle = pit_numbers(sections.along_mm, sections.half_width_mm, sections.height_mm)
    return {"pit_depth_mm": deepest, "off_dome_mm": rms, "off_dome_median_mm": middle}


@kernel
def pit_numbers(along_mm: Floats, half_width_mm: Floats, height_mm: Floats) -> tuple[float, float, float]:
    """Give the depth of pits below the dome, and how far the surface is off it, rms and median, mm."""
    # ends and edges, where the surface is steep, are left out
    off = (height_mm - dome_over(along_mm, height_mm))[_ALONG, _EDGE : SAMPLES - _EDGE].copy()
    sample = 2.0 * half_width_mm[_ALONG] / (SAMPLES - 1) * along_mm[1]
    pit = max(depth_reached(-off, sample, _PATCH_MM2), 0.0)
    return pit, math.sqrt((off * off).mean()), median_of(np.abs(off).ravel())


def _runs(sections: Sections) -> dict[str, float]:
    """Run of height and width along the product, as shares of the largest: ends cut off, dips and bumps."""
    every = run_numbers(sections.height_mm, sections.half_width_mm).tolist()
    return {
        f"{name}_{which}": every[k][_OF_RUNS.index(which)]
        for k, (name, kept) in enumerate(_KEPT_OF_RUNS.items())
        for which in kept
    }


_OF_RUNS = ("end_low", "end_high", "tenth_low", "tenth_high", "arch", "dip", "bump", "uneven")


@float_kernel
def run_numbers(height_mm: Floats, half_width_mm: Floats) -> Floats:
    """Give (run, number) what `_OF_RUNS` names, of peaks, the ridge and half widths."""
    share, found = np.empty(STATIONS), np.empty((3, len(_OF_RUNS)))
    # peak: the highest point wherever it is; ridge: the height at the middle, which a dent on the ridge
    # lowers
    for run in range(3):
        for k in range(STATIONS):
            share[k] = height_mm[k].max() if run == 0 else height_mm[k, SAMPLES // 2]
            share[k] = half_width_mm[k] if run == 2 else share[k]
        # shares, so that large and small products have the same numbers
        share /= max(share.max(), 1e-9)
        rest, arch = share.copy(), 0.0
        for degree in range(5):
            term = _dot(_QUARTIC_FIT[degree], share)
            # P₂ rises to the ends: a run that is highest in the middle has a negative coefficient
            arch = -term if degree == 2 else arch
            for k in range(STATIONS):
                rest[k] -= term * _QUARTIC[k, degree]
        for n, at in enumerate((0, _TENTH)):
            # sorted: which end is the head is not known
            one, other = share[at], share[STATIONS - 1 - at]
            found[run, 2 * n], found[run, 2 * n + 1] = min(one, other), max(one, other)
        # the outer stations fall by nature: no dip or bump is told there
        found[run, 4], found[run, 5], found[run, 6] = arch, -rest[3:-3].min(), rest[3:-3].max()
        found[run, 7] = math.sqrt((rest * rest).mean())
    return found


_KEPT_OF_RUNS = {
    "height": ("end_low", "tenth_low", "tenth_high", "arch", "dip", "bump"),
    "ridge": ("dip", "bump", "uneven"),
    "width": ("end_high", "tenth_low", "tenth_high", "bump"),
}


def _beyond(cuts: Sections, pitch_mm: float) -> dict[str, float]:
    """Stripes that should still meet the product beyond its outer cuts, if it went on thinning as it does.

    More than one was looked for and not found: there the product is cut off.
    """
    told = {}
    # of a rounded end both the area and the squared width fall linearly to nothing
    for name, size in (("area", cuts.area_mm2.tolist()), ("width", (cuts.half_width_mm**2).tolist())):
        most = 0.0
        for outer, inner in ((0, 1), (-1, -2)):
            step = abs(float(cuts.along_mm[inner] - cuts.along_mm[outer]))
            fall = (size[inner] - size[outer]) / max(step, 1e-3)
            # an end that does not fall is cut off, and would go on for as many stripes as one counts
            most = max(most, size[outer] / fall / max(pitch_mm, 1e-3) if fall > 0.0 else _MISSING_MOST)
        told[f"stripes_missing_by_{name}"] = min(most, _MISSING_MOST)
    return told


_MISSING_MOST = 3.0
"""Stripes: where an end does not thin at all, three are as many as any."""

_U = np.linspace(-1.0, 1.0, STATIONS)
_TENTH, _FIFTH = STATIONS // 10, STATIONS // 5  # stations: a tenth and a fifth of the length
_QUARTIC = np.polynomial.legendre.legvander(_U, 4)
_QUARTIC_FIT = np.ascontiguousarray(np.linalg.pinv(_QUARTIC))


def _hump_features(humps: tuple[Region, ...]) -> dict[str, float]:
    return {
        "hump_height_mm": humps[0].depth_mm if humps else 0.0,
        "hump_area_mm2": humps[0].area_mm2 if humps else 0.0,
        "humps": float(len(humps)),
    }
