"""What is not seen between a product's slices and what is seen beside them.

Where light is too faint, a slice ends before the product does. Then neither product nor belt is seen for
some way beside its end, in the image: where a flank is seen to its rim, the next row shows the belt. So the
product may go on over that way, but no farther than along its tangent down to the belt, where it ends with
less than 45°; and where it is steeper, than a round flank does, which falls off within R·(1 − sin θ), with
half the slice's width for its radius R. That much it may be larger.

A slice that ends behind the product, as the camera looks, shows no belt beside it for another reason. What
faint light has taken there is told by the other ends: as much as from half of those.

It fails where all of a product's ends lie behind it.
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


def unseen_margin_mm3(profiles: Profiles) -> Floats:
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
            area = _unseen_margin_mm2(profiles.xyz_mm[part], label == number, label >= 0, profiles.seen[part])
            found[number] += np.nansum(area * held_mm[part])
    return found


def _unseen_margin_mm2(xyz_mm: Floats, mine: Flags, known: Flags, seen: Flags) -> Floats:
    """Give (slice,) the area that may lie between a product's ends and what is known beside them."""
    steps_mm = np.abs(np.diff(xyz_mm[..., 1], axis=1))
    steps_mm = steps_mm[np.isfinite(steps_mm)]
    step_mm = float(np.median(steps_mm)) if steps_mm.size else 0.0
    some = mine.any(axis=1)
    every, points = np.arange(len(mine)), mine.shape[1]
    y_mm, z_mm = xyz_mm[..., 1], xyz_mm[..., 2]
    ends = np.stack([mine.argmax(axis=1), points - 1 - mine[:, ::-1].argmax(axis=1)])
    radius_mm = 0.5 * np.abs(np.diff(y_mm[every, ends], axis=0)[0])
    # the nearest point before each, and after each, that is known
    place = np.where(known, np.arange(points), -1)
    before = np.maximum.accumulate(np.pad(place[:, :-1], ((0, 0), (1, 0)), constant_values=-1), axis=1)
    place = np.where(known, np.arange(points), points)[:, ::-1]
    after = np.minimum.accumulate(np.pad(place[:, :-1], ((0, 0), (1, 0)), constant_values=points), axis=1)
    beside = np.stack([before[every, ends[0]], after[:, ::-1][every, ends[1]]])
    gap_mm = np.maximum((np.abs(ends - beside) - _STEPS) * step_mm, 0.0)
    inner = np.clip(ends + _SLOPE_POINTS * np.array([[1], [-1]]), 0, points - 1)
    top = z_mm[every, ends]
    run_mm = np.abs(y_mm[every, inner] - y_mm[every, ends])
    sloped = some & mine[every, inner] & (run_mm > 0.0)
    rise_mm = np.where(sloped, np.maximum(z_mm[every, inner] - top, 0.0), 0.0)
    slope = rise_mm / np.where(sloped, run_mm, 1.0)
    arc_mm = radius_mm * (1.0 - slope / np.hypot(1.0, slope))
    with np.errstate(divide="ignore", invalid="ignore"):
        long_mm = np.minimum(gap_mm, np.where(slope < _STEEP, top / slope, arc_mm))
    long_mm = np.where(some, long_mm, 0.0)
    lit = some & seen[every, ends]
    usual_mm = float(np.median(long_mm[lit])) if lit.any() else 0.0
    long_mm = np.where(lit, long_mm, np.minimum(long_mm, usual_mm))
    area = np.where(some, long_mm * (top - 0.5 * np.minimum(slope * long_mm, top)), 0.0)
    return np.asarray(np.maximum(area, 0.0).sum(axis=0))
