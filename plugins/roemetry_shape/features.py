"""What can be said of a product's shape in numbers, the same for mirrored, turned and rescaled rigs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats
from roemetry.records import Product, Relief
from roemetry_shape.curvature import curvature_features, surface_shape
from roemetry_shape.hollows import hollows_of
from roemetry_shape.humps import humps_of
from roemetry_shape.lengthwise import lengthwise_features
from roemetry_shape.outline_features import outline_features
from roemetry_shape.regions import Region
from roemetry_shape.relief import relief_of
from roemetry_shape.sections import SAMPLES, Sections, sections_of

SECTIONS_MIN = 3
"""With fewer sections a product has no shape to speak of."""

_INNER = slice(SAMPLES // 8, SAMPLES - SAMPLES // 8)
"""Samples away from the edges, where a section is steep by nature."""


_LINES = list(range(SAMPLES // 8, SAMPLES - SAMPLES // 8, 2))
"""Samples that are followed along the product."""

_SADDLE_LEAST_MM = 0.3
"""Of a shallower one nobody can say how wide it is."""


class Shape(NamedTuple):
    """Features by name (none with fewer than three sections), and the surface they were read off."""

    features: dict[str, float]
    relief: Relief | None = None


def shape_of(product: Product, smoothing_rows: int) -> Shape:
    """Measure a product's shape.

    `length_seen_mm` counts what stripes saw: it ends at the outer stripes. `length_mm`, `across_mm` and
    `footprint_mm2` are the outline's, and are there only if it is.

    Parameters
    ----------
    product
        One product.
    smoothing_rows
        Window, rows, that smooths each curve first; see `sections_of`.
    """
    sections = sections_of(product, smoothing_rows)
    if len(sections.stripe) < SECTIONS_MIN:
        return Shape({})
    below_mm, dents = hollows_of(sections)
    above_mm, humps = humps_of(sections)
    surface = surface_shape(sections)
    features = {
        **_size(sections),
        **outline_features(product, sections),
        **_middle_line(sections),
        **_lean(sections),
        **_saddles(sections),
        **_along(sections),
        **lengthwise_features(sections),
        **_hollow_features(below_mm, dents),
        **_hump_features(humps),
        **curvature_features(surface),
    }
    stands_out_mm = np.where(below_mm >= above_mm, -below_mm, above_mm)
    relief = relief_of(sections, surface, stands_out_mm, {"dent": dents, "hump": humps}, features)
    return Shape(features, relief)


def shape_features(product: Product, smoothing_rows: int) -> dict[str, float]:
    """Give the features alone; empty with fewer than three sections."""
    return shape_of(product, smoothing_rows).features


def _size(sections: Sections) -> dict[str, float]:
    width, peak, area = 2.0 * sections.half_width_mm, sections.peak_mm, sections.area_mm2
    length = float(sections.along_mm[-1])
    return {
        "length_seen_mm": length,
        "width_mm": float(width.max()),
        "thickness_mm": float(peak.max()),
        "sections": float(len(width)),
        "length_to_width": length / float(width.max()),
        "thickness_to_width": float(peak.max() / width.max()),
        "section_area_max_mm2": float(area.max()),
        # How much of its own box a section fills: a half-ellipse π/4, a box 1, a hollow one less.
        "fullness_least": float((area / (width * peak)).min()),
        "fullness_median": float(np.median(area / (width * peak))),
    }


def _middle_line(sections: Sections) -> dict[str, float]:
    """Bend of the line through the sections' middles, in the plane of the belt."""
    x, y = sections.middle_mm.T
    straight = y - np.polyval(np.polyfit(x, y, 1), x)
    half = max(0.5 * float(np.ptp(x)), 1e-9)
    u = (x - 0.5 * (x.min() + x.max())) / half
    bow = np.polyfit(u, y, 2)[0] if len(x) > 3 else 0.0
    s_part = np.polyfit(u, y, 3)[0] if len(x) > 4 else 0.0
    turn = np.degrees(np.diff(np.arctan2(np.diff(y), np.diff(x))))
    width = 2.0 * sections.half_width_mm
    return {
        "bend_mm": float(np.abs(straight).max()),
        "bow_mm": abs(float(bow)),
        "s_bend_mm": abs(float(s_part)),
        "turn_net_deg": abs(float(turn.sum())),
        "turn_total_deg": float(np.abs(turn).sum()),
        "width_step_mm": float(np.abs(np.diff(width)).max()),
        "middle_jump_mm": float(np.abs(np.diff(straight, 2)).max()) if len(x) > 2 else 0.0,
    }


def _lean(sections: Sections) -> dict[str, float]:
    """Lean of the sections to one side, and how it changes along: twist."""
    t = np.linspace(-1.0, 1.0, SAMPLES)
    weight = sections.height_mm - sections.height_mm.min(axis=1, keepdims=True)
    mass = np.maximum(weight.sum(axis=1), 1e-9)
    centre = (weight * t).sum(axis=1) / mass
    top = t[np.argmax(sections.height_mm, axis=1)]
    inner = sections.height_mm[:, _INNER]
    # Straight lines over places that lie evenly about 0.
    across = sections.across_mm[:, _INNER]
    slope = (across * inner).sum(axis=1) / (across**2).sum(axis=1)
    lean = np.degrees(np.arctan(slope))
    body = slice(1, -1) if len(lean) > 4 else slice(None)
    mirrored = sections.height_mm - sections.height_mm[:, ::-1]
    return {
        "lean_most_deg": float(np.abs(lean[body]).max()),
        "lean_range_deg": float(np.ptp(lean[body])),
        "lean_step_deg": float(np.abs(np.diff(lean[body])).max(initial=0.0)),
        "ridge_wander": float(np.ptp(top[body])),
        "centre_wander": float(np.ptp(centre[body])),
        "asymmetry": float(np.abs(mirrored).mean() / _thick(sections)),
    }


def _along(sections: Sections) -> dict[str, float]:
    """The run of heights along the product: steps, ends that are cut off."""
    s, peak, area = sections.along_mm, sections.peak_mm, sections.area_mm2
    thick = _thick(sections)
    lines = sections.height_mm[:, [SAMPLES // 4, SAMPLES // 2, 3 * SAMPLES // 4]].T
    rise = np.abs(np.diff(lines, axis=1)) / np.diff(s)
    ends = np.sort(np.array([peak[0], peak[-1]])) / thick
    wide = np.sort(sections.half_width_mm[[0, -1]]) / sections.half_width_mm.max()
    halves = np.sort([area[: len(area) // 2].sum(), area[-(len(area) // 2) :].sum()])
    inner = rise[:, 1:-1] if rise.shape[1] > 3 else rise
    return {
        "rise_most": float(inner.max()),
        "rise_end": float(rise[:, [0, -1]].max()),
        "end_height_low": float(ends[0]),
        "end_height_high": float(ends[1]),
        "end_width_low": float(wide[0]),
        "end_width_high": float(wide[1]),
        "halves_share": float(halves[0] / max(halves[1], 1e-9)),
        "peak_step_mm": float(np.abs(np.diff(peak, 2)).max(initial=0.0)),
    }


def _saddles(sections: Sections) -> dict[str, float]:
    """How deep the heights along the product lie below their hull, and over how much of its width."""
    from roemetry_kernels.shape.hollows import hollow_depth

    lines = np.ascontiguousarray(sections.height_mm[:, _LINES].T)
    along = np.ascontiguousarray(np.broadcast_to(sections.along_mm, lines.shape))
    depth = hollow_depth(along, lines).max(axis=1)
    at_three = depth[[_LINES.index(SAMPLES // 4), len(_LINES) // 2, _LINES.index(3 * SAMPLES // 4)]]
    rising = np.sort(depth)
    deepest = float(at_three.max())
    return {
        "saddle_mm": deepest,
        "saddle_share": deepest / _thick(sections),
        "saddle_median_mm": float(rising[len(rising) // 2]),
        "saddle_least_mm": float(rising[len(rising) // 10]),
        "saddle_wide": float((depth > 0.5 * rising[-1]).mean()) if rising[-1] > _SADDLE_LEAST_MM else 0.0,
    }


def _hollow_features(depth: Floats, hollows: tuple[Region, ...]) -> dict[str, float]:
    deepest = depth.max(axis=1)
    first = hollows[0] if hollows else None
    t = np.linspace(-1.0, 1.0, SAMPLES)
    return {
        "dent_depth_mm": 0.0 if first is None else first.depth_mm,
        "dent_area_mm2": 0.0 if first is None else first.area_mm2,
        "dent_stripes": 0.0 if first is None else float(first.stripes),
        "dents": float(len(hollows)),
        "dent_second_mm": hollows[1].depth_mm if len(hollows) > 1 else 0.0,
        "hollow_median_mm": float(np.median(deepest)),
        "hollow_mean_mm": float(depth.mean()),
        "hollow_depth_mm": float(deepest.max()),
        "hollow_off_middle": float(abs(t[np.argmax(depth.max(axis=0))])) if deepest.max() > 0.2 else math.nan,
    }


def _hump_features(humps: tuple[Region, ...]) -> dict[str, float]:
    return {
        "hump_height_mm": humps[0].depth_mm if humps else 0.0,
        "hump_area_mm2": humps[0].area_mm2 if humps else 0.0,
        "humps": float(len(humps)),
    }


def _thick(sections: Sections) -> float:
    return max(float(sections.peak_mm.max()), 1e-9)
