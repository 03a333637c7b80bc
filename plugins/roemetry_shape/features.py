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
from roemetry_kernels.image_levels import median_of
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
    dome_of,
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

_ACROSS = slice(SAMPLES // 8, SAMPLES - SAMPLES // 8)
"""Samples away from the edges, where a section is steep by nature."""

_ALONG = slice(STATIONS // 10, STATIONS - STATIONS // 10)
"""Stations away from the ends, where sections shrink and few samples make them."""

_LINES = list(range(SAMPLES // 8, SAMPLES - SAMPLES // 8, 2))
"""Samples that are followed along the product."""

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
    below_mm, dents = hollows_of(cuts)
    stands_out_mm = np.where(below_mm >= above_mm, -below_mm, above_mm)
    relief = relief_of(cuts, surface_shape(cuts), stands_out_mm, {"dent": dents, "hump": humps}, features)
    return Shape(features, relief)


def shape_features(product: Product, smoothing_mm: float = SMOOTHING_MM) -> dict[str, float]:
    """Give the features alone; empty with fewer than three sections."""
    cuts, _, _, of_surface = _surface_of(product.profiles, product.number, smoothing_mm)
    return {**of_surface, **outline_features(product, cuts)} if of_surface else {}


class _Surface(NamedTuple):
    """What a product's surface tells, whatever its outline."""

    cuts: Sections
    above_mm: Floats
    humps: tuple[Region, ...]
    features: dict[str, float]


@lru_cache(maxsize=2)
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
    body = _above_foot(frame.sections)
    return {
        **_size(frame),
        **_axis(body),
        **_lean(body),
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
    middle, half, height = from_foot_to_foot(
        sections.height_mm, sections.across_mm, sections.middle_mm, sections.half_width_mm
    )
    return sections._replace(
        middle_mm=middle, half_width_mm=half, height_mm=height, across_mm=half[:, None] * EVEN
    )


@float_kernel
def from_foot_to_foot(
    height_mm: Floats, across_mm: Floats, middle_mm: Floats, half_width_mm: Floats
) -> tuple[Floats, Floats, Floats]:
    """Give (section, 2) middles, (section,) half widths and (section, sample) heights above the foot."""
    sections, last = half_width_mm.size, SAMPLES - 1
    middle, half, out = middle_mm.copy(), np.empty(sections), np.empty((sections, SAMPLES))
    for k in range(sections):
        height, across = height_mm[k], across_mm[k]
        level = _FOOT * height.max()
        low, high = 0, last
        while low < last and height[low] < level:
            low += 1
        while high > 0 and height[high] < level:
            high -= 1
        from_mm, to_mm = across[low], across[high]
        if low > 0:
            back = (height[low] - level) / max(height[low] - height[low - 1], 1e-9)
            from_mm -= (across[low] - across[low - 1]) * back
        if high < last:
            back = (height[high] - level) / max(height[high] - height[high + 1], 1e-9)
            to_mm -= (across[high] - across[high + 1]) * back
        half[k] = max(0.5 * (to_mm - from_mm), 1e-6)
        middle[k, 1] += 0.5 * (from_mm + to_mm)
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
    width, peak, area = 2.0 * sections.half_width_mm, sections.peak_mm, sections.area_mm2
    length = float(sections.along_mm[-1] + frame.end_missing_mm.sum())
    full = (area / np.maximum(width * peak, 1e-9))[_ALONG]
    return {
        "length_seen_mm": float(sections.along_mm[-1]),
        "length_extrapolated_mm": length,
        "width_mm": float(width[_ALONG].max()),
        "thickness_mm": float(peak[_ALONG].max()),
        "length_to_width": length / float(width[_ALONG].max()),
        "thickness_to_width": float(peak[_ALONG].max() / width[_ALONG].max()),
        "section_area_max_mm2": float(area.max()),
        # How much of its own box a section fills: a half-ellipse π/4, a box 1, a hollow one less.
        "fullness_least": float(full.min()),
        "fullness_median": median_of(full),
    }


def _axis(sections: Sections) -> dict[str, float]:
    """Bend of the line through the sections' middles, and of that through their centres of area."""
    off = sections.middle_mm[_ALONG, 1]  # stations are even: every fit along them is the same matrix
    straight = off - _POWERS[:, :2] @ (_FITS[1] @ off)
    bow, s_bend = _FITS[2][2] @ off, _FITS[3][3] @ off
    height, middle = sections.height_mm, sections.middle_mm[:, 1]
    off_middle = (height * sections.across_mm).sum(axis=1) / np.maximum(height.sum(axis=1), 1e-9)
    of_edges, of_area = _kink(middle), _kink(middle + off_middle)
    step = float(sections.along_mm[1])
    wave = float(_FIFTH_WAVE @ middle[_ENDLESS])
    return {
        "bend_mm": float(np.abs(straight).max()),
        "bow_mm": abs(float(bow)),
        "s_bend_mm": abs(float(s_bend)),
        "w_bend_mm": abs(wave),
        "kink_deg": math.degrees(math.atan(of_area[0] / step)),
        "kink_rest_mm": of_area[1],
        "edge_kink_deg": math.degrees(math.atan(of_edges[0] / step)),
    }


_POWERS = np.linspace(-1.0, 1.0, STATIONS)[_ALONG, None] ** np.arange(4)
_POWERS /= np.abs(_POWERS[0, 1]) ** np.arange(4)
_FITS = {degree: np.linalg.pinv(_POWERS[:, : degree + 1]) for degree in (1, 2, 3)}
"""Powers of the place along, from −1 at one end to 1, and what fits a polynomial of each degree."""


def _hinges() -> tuple[Floats, Floats]:
    """(hinge, station) lines with one kink, free of their straight part, of length 1; and these lengths."""
    at = np.arange(STATIONS, dtype=np.float64)[_ENDLESS]
    straight = np.stack([np.ones_like(at), at], axis=1)
    hinge = np.maximum(at[:, None] - at[_REACH:-_REACH], 0.0)
    rest = hinge - straight @ np.linalg.lstsq(straight, hinge, rcond=None)[0]
    length = np.sqrt((rest**2).sum(axis=0))
    return np.asarray((rest / length).T), length


_ENDLESS = slice(2, STATIONS - 2)
"""Stations without the outer two, which the last cut alone makes."""

_REACH = STATIONS // 7
"""Stations to either side of a kink that show that the line has turned: 12 mm on a skein of 80 mm."""

_HINGES, _HINGE_LENGTHS = _hinges()
_LEVER = np.linspace(-1.0, 1.0, STATIONS - 4)
_LEVER /= np.sqrt(_LEVER @ _LEVER)
_FIFTH_WAVE = np.linalg.pinv(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, STATIONS)[_ENDLESS], 5))[
    4
]
"""What gives the fourth coefficient of a fit by Legendre's polynomials up to the fifth."""


def _kink(off_mm: Floats) -> tuple[float, float]:
    """Turn in mm a station, and what is left, rms mm, of the line with one kink that fits best."""
    off = off_mm[_ENDLESS]
    off = off - off.mean() - _LEVER * (_LEVER @ off)
    along = _HINGES @ off
    best = int(np.abs(along).argmax())
    left = math.sqrt(max(float((off**2).sum() - along[best] ** 2), 0.0) / off.size)
    return abs(float(along[best] / _HINGE_LENGTHS[best])), left


_INNER, _SHOULDER = (0.05, 0.4), (0.4, 0.7)
"""Parts of a section's half width whose lean is told: near the ridge, and on the flanks."""


def _lean(sections: Sections) -> dict[str, float]:
    """Lean of the sections to one side, and how it changes along: twist."""
    inner, shoulder = np.degrees(np.arctan(_LEANS @ sections.height_mm.T / sections.half_width_mm))
    turn = float(_U @ inner) / float(_U @ _U)  # over half the length: stations are even
    rest = (inner - inner.mean() - turn * _U)[_ALONG]
    ratio = sections.peak_mm / np.maximum(2.0 * sections.half_width_mm, 1e-9)
    middle: float = median_of(ratio[2 * _FIFTH : -2 * _FIFTH])
    return {
        "twist_deg": 2.0 * abs(turn),
        "twist_of_ends_deg": _end_to_end(inner),
        "twist_of_flanks_deg": _end_to_end(shoulder),
        "lean_range_deg": float(np.ptp(inner[_ALONG])),
        "lean_uneven_deg": _rms(rest),
        # A section that is turned about its middle is narrower and higher than one that lies flat.
        "stoutness_spread": float(np.std(ratio[4:-4])) / middle,
    }


def _lean_weights(part: tuple[float, float]) -> Floats:
    """(sample,) what gives, of heights, the mean slope to one side over part of the half width."""
    weights = np.where((np.abs(EVEN) > part[0]) & (np.abs(EVEN) < part[1]), 1.0, 0.0)
    return np.asarray(weights / np.where(weights > 0.0, EVEN, 1.0) / weights.sum())


_LEANS = np.stack([_lean_weights(part) for part in (_INNER, _SHOULDER)])
"""(2, sample) of the part near the ridge, and of the flanks."""


def _end_to_end(values: Floats) -> float:
    seventh = STATIONS // 7
    return abs(float(values[:seventh].mean() - values[-seventh:].mean()))


def _hollows(sections: Sections) -> dict[str, float]:
    """Depths below the hulls across and along, and the dents: regions below those across."""
    across = hollow_depth(sections.across_mm, np.ascontiguousarray(sections.height_mm))
    # At its edges a section ends where the last row was seen: a step there is no hollow.
    across[:, : _ACROSS.start] = across[:, _ACROSS.stop :] = 0.0
    lines = np.ascontiguousarray(sections.height_mm[_ALONG][:, _LINES].T)
    s = np.ascontiguousarray(np.broadcast_to(sections.along_mm[_ALONG], lines.shape))
    along = hollow_depth(s, lines)
    deepest, saddles = across.max(axis=1), np.sort(along.max(axis=1))
    cup = np.minimum(across[_ALONG][:, _LINES], along.T)
    step = float(sections.along_mm[1])
    sample = 2.0 * sections.half_width_mm / (SAMPLES - 1) * step  # mm² of a sample
    every_second = 2.0 * sample[_ALONG]
    dents = [one for one in regions_of(across, sections, DENT_LEAST_MM) if one.area_mm2 >= _PATCH_MM2]
    return {
        "hollow_depth_mm": depth_reached(across, sample, _PATCH_MM2),
        "hollow_median_mm": median_of(deepest),
        "hollow_mean_mm": float(across.mean()),
        "dent_depth_mm": dents[0].depth_mm if dents else 0.0,
        "dent_area_mm2": dents[0].area_mm2 if dents else 0.0,
        "dents": float(len(dents)),
        "saddle_mm": float(saddles[-3]),
        "saddle_share": float(saddles[-3]) / _thick(sections),
        "saddle_median_mm": float(saddles[len(saddles) // 2]),
        "saddle_least_mm": float(saddles[len(saddles) // 10]),
        "cup_depth_mm": depth_reached(cup, every_second, _PATCH_MM2),
        "cup_volume_mm3": float(cup.sum(axis=1) @ every_second),
    }


@kernel
def depth_reached(depth: Floats, area_mm2: Floats, patch_mm2: float) -> float:
    """Depth that so much of the surface reaches: (row, sample) depths, and (row,) each sample's area."""
    most = min(int(patch_mm2 / area_mm2.min()) + 1, depth.size)
    deepest, area = np.full(most, -np.inf), np.zeros(most)
    for row in range(depth.shape[0]):
        for sample in range(depth.shape[1]):
            value, k = depth[row, sample], most - 1
            if not value > deepest[k]:
                continue
            while k > 0 and value > deepest[k - 1]:
                deepest[k], area[k] = deepest[k - 1], area[k - 1]
                k -= 1
            deepest[k], area[k] = value, area_mm2[row]
    total = 0.0
    for k in range(most):
        total += area[k]
        if total >= patch_mm2:
            return float(deepest[k])
    return float(deepest[most - 1])


def _pits(sections: Sections) -> dict[str, float]:
    """Depth below a smooth dome that fits most of the surface, and how smooth the surface is against it."""
    off = (sections.height_mm - dome_of(sections))[_ALONG, _ACROSS]
    sample = 2.0 * sections.half_width_mm[_ALONG] / (SAMPLES - 1) * sections.along_mm[1]
    return {
        "pit_depth_mm": max(depth_reached(-off, sample, _PATCH_MM2), 0.0),
        "off_dome_mm": _rms(off),
        "off_dome_median_mm": median_of(np.abs(off).ravel()),
    }


def _runs(sections: Sections) -> dict[str, float]:
    """Run of height and width along the product, as shares of the largest: ends cut off, dips and bumps."""
    runs = np.stack([sections.peak_mm, sections.height_mm[:, SAMPLES // 2], sections.half_width_mm])
    share = runs / np.maximum(runs.max(axis=1), 1e-9)[:, None]
    smooth = share @ _QUARTIC_FIT.T
    rest = share - smooth @ _QUARTIC.T
    ends, tenths = np.sort(share[:, [0, -1]]), np.sort(share[:, [_TENTH, -1 - _TENTH]])
    every = {
        "end_low": ends[:, 0],
        "end_high": ends[:, 1],
        "tenth_low": tenths[:, 0],
        "tenth_high": tenths[:, 1],
        "arch": -smooth[:, 2],
        "dip": -rest[:, 3:-3].min(axis=1),
        "bump": rest[:, 3:-3].max(axis=1),
        "uneven": np.sqrt((rest**2).mean(axis=1)),
    }
    return {
        f"{name}_{which}": float(every[which][k])
        for k, (name, kept) in enumerate(_KEPT_OF_RUNS.items())
        for which in kept
    }


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
    for name, size in (("area", cuts.area_mm2.tolist()), ("width", (cuts.half_width_mm**2).tolist())):
        most = 0.0
        for outer, inner in ((0, 1), (-1, -2)):
            step = abs(float(cuts.along_mm[inner] - cuts.along_mm[outer]))
            fall = (size[inner] - size[outer]) / max(step, 1e-3)
            most = max(most, size[outer] / fall / max(pitch_mm, 1e-3) if fall > 0.0 else _MISSING_MOST)
        told[f"stripes_missing_by_{name}"] = min(most, _MISSING_MOST)
    return told


_MISSING_MOST = 3.0
"""Stripes: where an end does not thin at all, three are as many as any."""

_U = np.linspace(-1.0, 1.0, STATIONS)
_TENTH, _FIFTH = STATIONS // 10, STATIONS // 5  # stations: a tenth and a fifth of the length
_QUARTIC = np.polynomial.legendre.legvander(_U, 4)
_QUARTIC_FIT = np.linalg.pinv(_QUARTIC)


def _hump_features(humps: tuple[Region, ...]) -> dict[str, float]:
    return {
        "hump_height_mm": humps[0].depth_mm if humps else 0.0,
        "hump_area_mm2": humps[0].area_mm2 if humps else 0.0,
        "humps": float(len(humps)),
    }


def _thick(sections: Sections) -> float:
    return max(float(sections.peak_mm.max()), 1e-9)


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))
