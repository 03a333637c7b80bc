"""A product's shape in numbers: millimetres, degrees and ratios, the same on every rig that shows it.

Model. All features but those of humps are read off the surface in the product's own frame
(`roemetry_shape.product_frame`), at even places along the product, so that they do not depend on the number
and distance of the stripes, the direction and side of the light, the camera's scale, or how the product
lies. None has a sign or a head end: a product that is mirrored or turned about gives the same numbers (a
twist turns the other way when mirrored; its size stays).

    axis         m(s) through the sections' middles: bend, bow and S against a straight line
    lean         angle of the best line over a section's inner three quarters; its run along s is twist
    hollows      depth below the upper convex hull of each section (across) and of each line along (saddles);
                 what lies below both is a cup, the mark of a dent
    pit          depth below a smooth dome that fits most of the surface (robust): a dent that hollows nothing
    ends         heights and areas over the outer tenths, as shares of the largest
    moments      skewness and kurtosis of the volume along the product

It fails where fewer than three stripes show a cross-section (no features), and where a defect lies between
two stripes (nothing is seen of it). How far each feature spreads over rigs for the same body is measured by
`python -m benchmarks grade`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.records import Product, Relief
from roemetry.records.arrays import Floats
from roemetry_shape.curvature import surface_shape
from roemetry_shape.product_frame import (
    SAMPLES,
    STATIONS,
    Frame,
    Sections,
    in_product_frame,
    outline_features,
    sections_of,
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
    cuts = sections_of(product, smoothing_mm)
    if len(cuts.stripe) < SECTIONS_MIN:
        return Shape({})
    below_mm, dents = hollows_of(cuts)
    above_mm, humps = humps_of(cuts)
    features = {**features_of(cuts), **outline_features(product, cuts), **_hump_features(humps)}
    stands_out_mm = np.where(below_mm >= above_mm, -below_mm, above_mm)
    relief = relief_of(cuts, surface_shape(cuts), stands_out_mm, {"dent": dents, "hump": humps}, features)
    return Shape(features, relief)


def shape_features(product: Product, smoothing_mm: float = SMOOTHING_MM) -> dict[str, float]:
    """Give the features alone; empty with fewer than three sections."""
    return shape_of(product, smoothing_mm).features


def features_of(cuts: Sections) -> dict[str, float]:
    """Give the features of a product's surface, of at least three cuts along stripes."""
    frame = in_product_frame(cuts)
    return {
        **_size(frame),
        **_axis(frame.sections),
        **_lean(frame.sections),
        **_hollows(frame.sections),
        **_pits(frame.sections),
        **_ends(frame.sections),
        **_moments(frame.sections),
    }


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
        "fullness_median": float(np.median(full)),
    }


def _axis(sections: Sections) -> dict[str, float]:
    """Bend of the line through the sections' middles, in the plane of the belt."""
    s, off = sections.middle_mm[_ALONG].T
    straight = off - np.polyval(np.polyfit(s, off, 1), s)
    half = max(0.5 * float(np.ptp(s)), 1e-9)
    u = (s - 0.5 * (s[0] + s[-1])) / half
    bow, s_part = np.polyfit(u, off, 2)[0], np.polyfit(u, off, 3)[0]
    middle = len(s) // 2
    ends = [np.polyfit(s[part], off[part], 1)[0] for part in (slice(0, middle + 1), slice(middle, None))]
    return {
        "bend_mm": float(np.abs(straight).max()),
        "bow_mm": abs(float(bow)),
        "s_bend_mm": abs(float(s_part)),
        "bend_deg": abs(math.degrees(math.atan(ends[1]) - math.atan(ends[0]))),
    }


def _lean(sections: Sections) -> dict[str, float]:
    """Lean of the sections to one side, and how it changes along: twist."""
    inner, across = sections.height_mm[:, _ACROSS], sections.across_mm[:, _ACROSS]
    # Straight lines over places that lie evenly about 0.
    slope = (across * inner).sum(axis=1) / np.maximum((across**2).sum(axis=1), 1e-9)
    lean = np.degrees(np.arctan(slope))[_ALONG]
    s = sections.along_mm[_ALONG]
    fit = np.polyfit(s, lean, 1)
    rest = lean - np.polyval(fit, s)
    t = np.linspace(-1.0, 1.0, SAMPLES)
    height = sections.height_mm[_ALONG]
    centre = (height * t).sum(axis=1) / np.maximum(height.sum(axis=1), 1e-9)
    mirrored = height - height[:, ::-1]
    return {
        "twist_deg": abs(float(fit[0])) * float(s[-1] - s[0]),
        "lean_most_deg": float(np.abs(lean).max()),
        "lean_range_deg": float(np.ptp(lean)),
        "lean_mean_deg": abs(float(lean.mean())),
        "lean_uneven_deg": float(np.sqrt((rest**2).mean())),
        "centre_wander": float(np.ptp(centre)),
        "asymmetry": float(np.abs(mirrored).mean() / _thick(sections)),
    }


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
    sample = (2.0 * sections.half_width_mm / (SAMPLES - 1) * step)[:, None]  # mm² of a sample
    every_second = np.broadcast_to(2.0 * sample[_ALONG], cup.shape)
    dents = [one for one in regions_of(across, sections, DENT_LEAST_MM) if one.area_mm2 >= _PATCH_MM2]
    return {
        "hollow_depth_mm": _reached(across, np.broadcast_to(sample, across.shape)),
        "hollow_median_mm": float(np.median(deepest)),
        "hollow_mean_mm": float(across.mean()),
        "dent_depth_mm": dents[0].depth_mm if dents else 0.0,
        "dent_area_mm2": dents[0].area_mm2 if dents else 0.0,
        "dents": float(len(dents)),
        "saddle_mm": float(saddles[-3]),
        "saddle_share": float(saddles[-3]) / _thick(sections),
        "saddle_median_mm": float(saddles[len(saddles) // 2]),
        "saddle_least_mm": float(saddles[len(saddles) // 10]),
        "cup_depth_mm": _reached(cup, every_second),
        "cup_volume_mm3": float((cup * every_second).sum()),
    }


def _reached(depth: Floats, area_mm2: Floats) -> float:
    """Depth that `_PATCH_MM2` of the surface reach, mm, of depths of samples and their areas."""
    order = np.argsort(-depth, axis=None)
    total = np.cumsum(area_mm2.ravel()[order])
    return float(depth.ravel()[order[min(int((total < _PATCH_MM2).sum()), order.size - 1)]])


def _pits(sections: Sections) -> dict[str, float]:
    """Depth below a smooth dome that fits most of the surface, and how smooth the surface is against it."""
    off = (sections.height_mm - dome_of(sections))[_ALONG, _ACROSS]
    sample = 2.0 * sections.half_width_mm[_ALONG, None] / (SAMPLES - 1) * sections.along_mm[1]
    return {
        "pit_depth_mm": max(_reached(-off, np.broadcast_to(sample, off.shape)), 0.0),
        "off_dome_mm": float(np.sqrt((off**2).mean())),
        "off_dome_median_mm": float(np.median(np.abs(off))),
    }


def _ends(sections: Sections) -> dict[str, float]:
    """The run of heights and areas towards the ends: ends that are cut off."""
    peak, area = sections.peak_mm, sections.area_mm2
    tenth = STATIONS // 10
    end_area = np.sort([area[:tenth].mean(), area[-tenth:].mean()]) / area.max()
    end_height = np.sort([peak[:tenth].mean(), peak[-tenth:].mean()]) / peak.max()
    lines = sections.height_mm[:, [SAMPLES // 4, SAMPLES // 2, 3 * SAMPLES // 4]]
    rise = np.abs(np.diff(lines, axis=0)) / sections.along_mm[1]
    return {
        "end_area_low": float(end_area[0]),
        "end_area_high": float(end_area[1]),
        "end_height_low": float(end_height[0]),
        "end_height_high": float(end_height[1]),
        "rise_most": float(rise[_ALONG].max()),
    }


def _moments(sections: Sections) -> dict[str, float]:
    """Skewness (its size: there is no head end) and kurtosis of the volume along the product.

    Third and fourth standardised moments of the sections' areas over their places. An ellipsoid has 0 and
    15/7, a prism 0 and 9/5; what is thick at one end is skewed.
    """
    s, area = sections.along_mm, sections.area_mm2
    half = len(area) // 2
    halves = np.sort([area[:half].sum(), area[-half:].sum()])
    whole = _integral(area, s)
    off = s - _integral(area * s, s) / whole
    variance = _integral(area * off**2, s) / whole
    return {
        "halves_share": float(halves[0] / max(halves[1], 1e-9)),
        "lengthwise_skew": abs(_integral(area * off**3, s) / whole) / variance**1.5,
        "lengthwise_kurtosis": _integral(area * off**4, s) / whole / variance**2,
    }


def _integral(values: Floats, places: Floats) -> float:
    """Simpson's rule over stations, which are evenly spaced and odd in number."""
    inner = 4.0 * values[1:-1:2].sum() + 2.0 * values[2:-1:2].sum()
    return float((values[0] + inner + values[-1]) * (places[1] - places[0]) / 3.0)


def _hump_features(humps: tuple[Region, ...]) -> dict[str, float]:
    return {
        "hump_height_mm": humps[0].depth_mm if humps else 0.0,
        "hump_area_mm2": humps[0].area_mm2 if humps else 0.0,
        "humps": float(len(humps)),
    }


def _thick(sections: Sections) -> float:
    return max(float(sections.peak_mm.max()), 1e-9)
