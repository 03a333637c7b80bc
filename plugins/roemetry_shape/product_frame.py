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
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats
from roemetry_shape.sections import SAMPLES, Sections

STATIONS = 41
"""Sections along a product: 2 mm apart on one of 80 mm, a third of the finest pitch of stripes in use; an odd
number, so that turning the product by 180 degrees maps stations onto stations. 31 or 61 change no feature by
more than 3 %."""


_STEP_MIN_MM = 0.01
"""Between two cuts: noise may let steep parts of neighbours change places; nothing divides by less."""


class Frame(NamedTuple):
    """A product's surface in its own frame.

    Attributes
    ----------
    sections
        `STATIONS` sections square to the axis; `middle_mm` in the product's frame: along the axis, and off
        it.
    pitch_mm
        Median distance of the stripes along the axis, mm.
    end_missing_mm
        (2,) estimated length beyond the first and last section, mm; at most one pitch.
    """

    sections: Sections
    pitch_mm: float
    end_missing_mm: Floats


def in_product_frame(sections: Sections) -> Frame:
    """Cut a product's surface square to its axis; `sections` are at least three cuts along stripes."""
    points = np.stack(
        [
            sections.x_mm,
            sections.middle_mm[:, 1:] + sections.across_mm,
            sections.height_mm,
        ],
        axis=-1,
    )
    area = sections.area_mm2
    s, t, z = _along_the_axis(points, area)
    middle = SAMPLES // 2
    order = np.argsort(s[:, middle], kind="stable")
    s, t, z, area = s[order], t[order], z[order], area[order]
    at = np.linspace(s[0, middle], s[-1, middle], STATIONS)
    knots = _rising(s)
    heights = lofted(knots, z, at)
    across = lofted(knots, t, at)
    pitch = float(np.median(np.diff(s[:, middle])))
    return Frame(_square(at, across, np.maximum(heights, 0.0)), pitch, _missing(s[:, middle], area, pitch))


def _along_the_axis(points: Floats, area: Floats) -> tuple[Floats, Floats, Floats]:
    """Turn points about Z so that the line through the middles, weighed by area, lies along s."""
    x, y, z = np.moveaxis(points, -1, 0)
    middle_x, middle_y = x[:, SAMPLES // 2], 0.5 * (y[:, 0] + y[:, -1])
    weight = area / area.sum()
    x0, y0 = float(weight @ middle_x), float(weight @ middle_y)
    off_x, off_y = middle_x - x0, middle_y - y0
    # Slope by least squares over x: cuts lie along x by their nature.
    angle = math.atan2(float(weight @ (off_x * off_y)), float(weight @ off_x**2))
    c, q = math.cos(angle), math.sin(angle)
    return c * (x - x0) + q * (y - y0), c * (y - y0) - q * (x - x0), z


def _rising(s: Floats) -> Floats:
    """Make the places of each sample rise from cut to cut by at least `_STEP_MIN_MM`."""
    least = _STEP_MIN_MM * np.arange(len(s))[:, None]
    return np.asarray(np.maximum.accumulate(s - least, axis=0) + least)


def lofted(knots: Floats, values: Floats, at: Floats) -> Floats:
    """Interpolate (cut, sample) values over (cut, sample) rising places: (station, sample).

    Piecewise cubic with the slopes of Fritsch and Butland (1984): it neither overshoots nor rings. Beyond the
    first and last cut of a sample the value stays.
    """
    step = np.diff(knots, axis=0)
    secant = np.diff(values, axis=0) / step
    slope = np.zeros_like(values)
    if len(step) > 1:
        one, other = step[:-1] + 2.0 * step[1:], 2.0 * step[:-1] + step[1:]
        same = secant[:-1] * secant[1:] > 0.0
        below = np.where(same, one * secant[1:] + other * secant[:-1], 1.0)
        slope[1:-1] = np.where(same, (one + other) * secant[:-1] * secant[1:] / below, 0.0)
    slope[0], slope[-1] = secant[0], secant[-1]
    columns = np.arange(knots.shape[1])[None]
    # Interval of each station in each column: the number of inner knots at or below it.
    k = (at[:, None, None] >= knots[None, 1:-1]).sum(axis=1)
    h = step[k, columns]
    u = np.clip((at[:, None] - knots[k, columns]) / h, 0.0, 1.0)
    v = 1.0 - u
    return np.asarray(
        values[k, columns] * v * v * (1.0 + 2.0 * u)
        + values[k + 1, columns] * u * u * (1.0 + 2.0 * v)
        + h * u * v * (slope[k, columns] * v - slope[k + 1, columns] * u)
    )


def _square(at: Floats, across: Floats, heights: Floats) -> Sections:
    """Put stations on even places from edge to edge."""
    across = np.maximum.accumulate(across, axis=1)
    low, high = across[:, 0], across[:, -1]
    half = np.maximum(0.5 * (high - low), 1e-6)
    even = np.linspace(-1.0, 1.0, SAMPLES)
    middle = 0.5 * (low + high)
    grid = middle[:, None] + half[:, None] * even
    height = np.stack([np.interp(grid[k], across[k], heights[k]) for k in range(len(at))])
    return Sections(
        stripe=np.arange(len(at)),
        along_mm=at - at[0],
        middle_mm=np.column_stack([at, middle]),
        half_width_mm=half,
        height_mm=height,
        across_mm=half[:, None] * even,
        x_mm=np.broadcast_to(at[:, None], height.shape),
    )


def _missing(s: Floats, area: Floats, pitch: float) -> Floats:
    """Length beyond each outer cut: where its area, falling as from the cut before it, would be nothing."""
    found = []
    for place, size in ((s, area), (-s[::-1], area[::-1])):
        fall = (size[1] - size[0]) / max(place[1] - place[0], 1e-6)
        found.append(min(size[0] / fall, pitch) if fall > 0.0 else 0.5 * pitch)
    return np.array(found)
