"""Steps: where slices jump from level to level, the line along which the top does, and how sure it is."""

from __future__ import annotations

from itertools import compress, pairwise
from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import kernel
from roemetry_volume.rim import StripePoints

_LEVEL_SHARE, _TILT_SHARE = (
    0.15,
    0.1,
)  # of the least jump: by how much a level's points differ, and its halves
_LEAST_MM, _LEAST_SHARE = 1.0, 0.12  # of a jump; of the product's top
_SAME = 0.3  # of the jump: levels of one step's crossings agree to that
_GAP_MM = 1.0
_STEEPEST = 0.58  # a line turned by 30 degrees
_AMISS, _INSIDE = 0.04, 0.05
_WHOLE = 0.9  # of the longest slice: a shorter one may run along a wall that none sees


class _Crossing(NamedTuple):
    """A slice's jump: its levels, the places (s, v) on the step's line, and the slice."""

    low_mm: float
    high_mm: float
    on_line: Floats
    slice: int


class Step(NamedTuple):
    """A step along the line s = at + slope·v, by `rise_mm`, towards high s (`uphill` 1) or low s (−1).

    `std_mm3` says how far the volume may be off because the line may run elsewhere.
    """

    at_mm: float
    slope: float
    rise_mm: float
    uphill: float
    std_mm3: float

    def heights(self, s: Floats, v: Floats) -> Floats:
        """Rise at places along and across the product, mm."""
        return np.where(self.uphill * (s - self.at_mm - self.slope * v) >= 0.0, self.rise_mm, 0.0)


def steps_at(steps: tuple[Step, ...], s: Floats, v: Floats) -> Floats:
    """Give how much all steps together rise at places along and across the product, mm."""
    total = np.zeros(s.size)
    for step in steps:
        total += step.heights(s, v)
    return total


def steps_of(points: StripePoints, place: Floats, to_light: Floats | None) -> tuple[Step, ...]:
    """Find the steps of a product.

    A jump within a slice is a step's where the slice is level before and after it. Jumps from the same level
    to the same one are one step's. Two places on its line tell where it runs; of a single one the line is
    square to the product, or as nearly so as the neighbouring slices allow, which lie on either side of it.

    A step that no slice crosses lies between two whole slices that are level, on levels that others have,
    too: halfway from where the lower one's light passes at the height of the upper one.

    Parameters
    ----------
    points
        The product's points.
    place : ndarray, shape (n, 2)
        Along and across the product, mm.
    to_light : ndarray, shape (n, 2), or None
        How far light comes along and across for each millimetre that it is higher; None: not known.
    """
    z = points.xyz_mm[:, 2]
    least = max(_LEAST_MM, _LEAST_SHARE * float(z.max(initial=0.0)))
    bounds = list(pairwise(points.first.tolist()))
    found: list[_Crossing] = []
    for number, (begin, stop) in enumerate(bounds):
        found += _crossings(place[begin:stop], z[begin:stop], number, least)
    steps, waiting = [], found
    while waiting:
        alike = [_is_same(one, waiting[0]) for one in waiting]
        steps.append(_line(list(compress(waiting, alike)), points, place))
        waiting = [one for one, taken in zip(waiting, alike, strict=True) if not taken]
    middle = [float(np.median(z[begin:stop])) for begin, stop in bounds]
    for number, next_number in pairwise(range(len(bounds))):
        two = _uncrossed(points, bounds, middle, number, next_number, found, least)
        if two is not None:
            steps.append(_between(points, place, to_light, *two))
    return tuple(step for step in steps if step is not None)


def _is_same(one: _Crossing, other: _Crossing) -> bool:
    near = _SAME * (other.high_mm - other.low_mm)
    return abs(one.low_mm - other.low_mm) < near and abs(one.high_mm - other.high_mm) < near


def _crossings(place: Floats, z: Floats, number: int, least_mm: float) -> list[_Crossing]:
    """Find one slice's jumps between neighbouring levels."""
    found = []
    for (begin, last), (first, stop) in pairwise(
        levels(z, _LEVEL_SHARE * least_mm, _TILT_SHARE * least_mm).tolist()
    ):
        one, other = float(np.median(z[begin : last + 1])), float(np.median(z[first : stop + 1]))
        if abs(other - one) < least_mm:
            continue
        low, high = (last, first) if one < other else (first, last)
        off = np.abs(place[first] - place[last])
        if off[1] > _GAP_MM and off[0] < _STEEPEST * off[1]:
            # light runs along the wall, whether the camera sees that or not
            on_line = place[[last, first]]
        else:
            on_line = np.array([[place[high, 0], 0.5 * (place[high, 1] + place[low, 1])]])
        found.append(_Crossing(min(one, other), max(one, other), on_line, number))
    return found


def _uncrossed(
    points: StripePoints,
    bounds: list[tuple[int, int]],
    middle: list[float],
    one: int,
    other: int,
    found: list[_Crossing],
    least: float,
) -> tuple[slice, slice] | None:
    """Give the points of two neighbouring slices, the lower one first, with a step between; or None."""
    y, z = points.xyz_mm[:, 1], points.xyz_mm[:, 2]
    step = abs(middle[one] - middle[other])
    if step < least:
        return None
    whole = _WHOLE * max(float(np.ptp(y[begin:stop])) for begin, stop in bounds)
    for number in (one, other):
        begin, stop = bounds[number]
        if (
            np.ptp(y[begin:stop]) < whole
            or (np.abs(z[begin:stop] - middle[number]) > _LEVEL_SHARE * least).mean() > _AMISS
        ):
            return None
        near = _SAME * step
        shared = [abs(height - middle[number]) < near for height in middle]
        crossed = [min(abs(level - middle[number]) for level in (c.low_mm, c.high_mm)) < near for c in found]
        if sum(shared) < 2 and not any(crossed):
            return None  # a slope's slices have each a level of their own
    low, high = (one, other) if middle[one] < middle[other] else (other, one)
    pair = _Crossing(middle[low], middle[high], np.zeros((0, 2)), low)
    if any(_is_same(crossing, pair) for crossing in found):
        return None
    return slice(*bounds[low]), slice(*bounds[high])


def _between(
    points: StripePoints, place: Floats, to_light: Floats | None, lower: slice, upper: slice
) -> Step | None:
    """Lay a step halfway between two slices."""
    z = points.xyz_mm[:, 2]
    rise = float(np.median(z[upper]) - np.median(z[lower]))
    low, high = place[lower], place[upper]
    way = 1.0 if high[:, 0].mean() > low[:, 0].mean() else -1.0
    passed = low if to_light is None else low + rise * to_light[lower]
    if way * (passed[:, 0].mean() - low[:, 0].mean()) > 0.0:
        low = passed
    lines = [np.polyfit(one[:, 1], one[:, 0], 1) for one in (low, high)]
    slope, at = 0.5 * (lines[0] + lines[1])
    apart = way * float(np.polyval(lines[1] - lines[0], place[upper, 1].mean()))
    if abs(slope) > _STEEPEST or apart < 0.0:
        return None
    std = rise * float(np.ptp(place[upper, 1])) * apart / np.sqrt(12.0)
    return Step(float(at), float(slope), rise, way, float(std))


def _line(mine: list[_Crossing], points: StripePoints, place: Floats) -> Step | None:
    """Lay a step's line through its crossings; None where points lie on the wrong side of it."""
    on = np.concatenate([one.on_line for one in mine])
    low, high = (float(np.mean([getattr(one, name) for one in mine])) for name in ("low_mm", "high_mm"))
    z, tolerance = points.xyz_mm[:, 2], _SAME * (high - low)
    upper, lower = z > high - tolerance, z < low + tolerance
    # the slices that cross it, and their neighbours
    numbers = [one.slice for one in mine]
    near = (points.slice >= min(numbers) - 1) & (points.slice <= max(numbers) + 1)
    upper, lower = upper & near, lower & near
    if not (upper.any() and lower.any()):
        return None
    way = 1.0 if place[upper, 0].mean() > place[lower, 0].mean() else -1.0
    slope, std = 0.0, 0.0
    if on.shape[0] > 1 and np.ptp(on[:, 1]) > _GAP_MM:
        slope = float(np.polyfit(on[:, 1], on[:, 0], 1)[0])
    else:
        least, most = _allowed(on[0], place[upper], place[lower], way)
        if least > most:
            return None
        inside = _INSIDE * (most - least)  # not along the slice itself
        slope = min(max(0.0, least + inside), most - inside)
        v = place[near, 1]
        aside = abs(0.5 * float(v.min() + v.max()) - float(on[0, 1]))
        std = (high - low) * float(np.ptp(v)) * aside * (most - least) / np.sqrt(12.0)
    if abs(slope) > _STEEPEST:
        return None
    at = float((on[:, 0] - slope * on[:, 1]).mean())
    step = Step(at, slope, high - low, way, float(std))
    over = step.heights(place[:, 0], place[:, 1]) > 0.0
    amiss = int((~over[upper]).sum() + over[lower].sum())
    return step if amiss <= _AMISS * (upper.sum() + lower.sum()) else None


def _allowed(edge: Floats, upper: Floats, lower: Floats, uphill: float) -> tuple[float, float]:
    """Give the least and the steepest slope of a line through an edge that leaves levels on its two sides."""
    least, most = -_STEEPEST, _STEEPEST
    for places, side in ((upper, uphill), (lower, -uphill)):
        off = places - edge
        far = np.abs(off[:, 1]) > _GAP_MM
        ratio = off[far, 0] / off[far, 1]
        # side·(s − slope·v) ≥ 0
        from_above = side * off[far, 1] > 0.0
        most = min(most, float(ratio[from_above].min(initial=most)))
        least = max(least, float(ratio[~from_above].max(initial=least)))
    return least, most


_LEVEL, _FEW = 5, 3  # points of a level at least; points together that end it, single ones are noise


@kernel
def levels(z_mm: Floats, within_mm: float, tilt_mm: float) -> Integers:
    """Give the first and the last point of each level; what rises or falls evenly is none.

    Parameters
    ----------
    z_mm : ndarray, shape (n,)
        Heights along a slice.
    within_mm
        By how much a level's points lie off the median of its first five.
    tilt_mm
        By how much the medians of its two halves differ.

    Returns
    -------
    ndarray of int64, shape (levels, 2)
    """
    n = z_mm.size
    found = np.empty((n // _LEVEL + 1, 2), np.int64)
    count, begin = 0, 0
    while begin < n:
        height = np.median(z_mm[begin : min(begin + _LEVEL, n)])
        size, off = n - begin, 0
        for k in range(begin, n):
            off = off + 1 if abs(z_mm[k] - height) > within_mm else 0
            if off == _FEW:
                size = k - begin + 1 - _FEW
                break
        if size >= _LEVEL:
            half = size // 2
            run = z_mm[begin : begin + size]
            if abs(np.median(run[size - half :]) - np.median(run[:half])) < tilt_mm:
                found[count, 0], found[count, 1] = begin, begin + size - 1
                count += 1
        begin += max(size, 1)
    return found[:count]
