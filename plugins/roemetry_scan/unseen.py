"""What is not seen between a product's slices and what is seen beside them.

Where light is too faint, a slice ends before the product does. Then neither product nor belt is seen for some
way beside its end. A flank that is seen to its rim ends steeply there, for only what turns away from light
and camera hides what lies beyond it. So where a slice ends with less than 45°, the product may go on along
its tangent up to what is seen next or the image's side: that much it may be larger.

It fails where a flank steeper than that is too dim to be seen whole.
"""

from __future__ import annotations

import numpy as np

from roemetry.records import Profiles
from roemetry.records.arrays import Flags, Floats

_STEPS = 3.0
"""Steps from a slice's end to what is seen beside it, that an edge between two points takes."""
_SLOPE_POINTS = 5
"""From the end inwards, over which its slope is taken."""
_STEEP = 1.0
"""Slope of 45°: what is flatter, light from above and a camera there see alike."""
_AT_ONCE = 128
"""Slices that are looked at together: copies of all of a long scan's points are megabytes."""


def beside_mm3(profiles: Profiles) -> Floats:
    """Give (product + 1,) the volume that each product, by its number, may have beside its slices' ends."""
    highest = int(profiles.product.max(initial=0))
    found = np.zeros(highest + 1)
    if not highest or len(profiles.frame) < 2:
        return found
    # half the way to both neighbours where the planes cut the belt
    place = profiles.plane[:, 3] / np.where(profiles.plane[:, 0] == 0.0, np.nan, profiles.plane[:, 0])
    held_mm = np.abs(np.gradient(place))
    for first in range(0, len(held_mm), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        label = profiles.product[part]
        for number in np.unique(label[label > 0]).tolist():
            area = _beside_mm2(profiles.xyz_mm[part], label == number, label >= 0)
            found[number] += np.nansum(area * held_mm[part])
    return found


def _beside_mm2(xyz_mm: Floats, mine: Flags, seen: Flags) -> Floats:
    """Give (slice,) the area between a product's ends and what is seen next, under their tangents."""
    step_mm = float(np.nanmedian(np.abs(np.diff(xyz_mm[..., 1], axis=1))))
    every, points, total = np.arange(len(mine)), mine.shape[1], np.zeros(len(mine))
    for way in (slice(None), slice(None, None, -1)):  # beyond the first point, and beyond the last
        y, z, own = xyz_mm[:, way, 1], xyz_mm[:, way, 2], mine[:, way]
        end = own.argmax(axis=1)
        before = np.where(seen[:, way], np.arange(points), -1)[:, :-1]
        next_seen = np.maximum.accumulate(np.pad(before, ((0, 0), (1, 0)), constant_values=-1), axis=1)
        gap_mm = (end - next_seen[every, end] - _STEPS) * step_mm
        inner = np.minimum(end + _SLOPE_POINTS, points - 1)
        top = z[every, end]
        slope = (z[every, inner] - top) / np.abs(y[every, inner] - y[every, end])
        slope = np.where(own[every, inner], np.maximum(slope, 0.0), 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            long_mm = np.clip(np.minimum(gap_mm, top / slope), 0.0, None)
        area = long_mm * (top - 0.5 * slope * long_mm)
        total += np.where(mine.any(axis=1) & (slope < _STEEP) & (area > 0.0), area, 0.0)
    return total
