"""Slices of a product as arrays: their points by product, and the arcs of their profiles."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from roemetry.records import Profiles
from roemetry.records.arrays import Flags, Floats, Integers
from roemetry_kernels.compiling import kernel

_STEP_MAX = 1.5  # rows; a larger step between neighbours means that rows are missing


class BodyCurves(NamedTuple):
    """A product's points in a line: slice after slice, down the rows, cut where rows are missing.

    Attributes
    ----------
    slice, point : ndarray of int64, shape (n,)
        Where each point stands in `Profiles`.
    first : ndarray of int64, shape (curve,)
        Index of each curve's first point in the above.
    size : ndarray of int64, shape (curve,)
        Number of points of each curve.
    """

    slice: Integers
    point: Integers
    first: Integers
    size: Integers


def body_curves(profiles: Profiles, number: int) -> BodyCurves:
    """Give the curves of one product, seen and bridged points alike; those without a height are left out."""
    slices, points, first, in_order = points_in_line(
        profiles.product, number, profiles.xyz_mm, profiles.row_px, _STEP_MAX
    )
    if not in_order:
        # Points of a slice may stand in any order; a curve is followed down the rows.
        row_px = profiles.row_px[slices, points]
        order = np.lexsort((row_px, slices))
        slices, points, row_px = slices[order], points[order], row_px[order]
        begins = (np.diff(slices) != 0) | (np.diff(row_px) > _STEP_MAX)
        first = np.flatnonzero(np.concatenate([[slices.size > 0], begins]))
    size = np.empty_like(first)
    size[:-1] = first[1:] - first[:-1]
    size[-1:] = slices.size - first[-1:]
    return BodyCurves(slices, points, first, size)


def smoothed(curves: BodyCurves, values: Floats, window: int) -> Floats:
    """Smooth along each curve by a local quadratic over `window` points (Savitzky and Golay 1964).

    Points nearer to a curve's end than half the window take the value of the end's own quadratic. A curve
    shorter than the window gets the longest odd window that fits; one of fewer than 3 points stays.

    Parameters
    ----------
    curves
        As `body_curves` gave them.
    values : ndarray of float64, shape (n, k)
        Coordinates of the curves' points.
    window
        Odd number of points; below 3 means no smoothing.
    """
    out = values.copy()
    for first, size in zip(curves.first.tolist(), curves.size.tolist(), strict=True):
        odd = min(window, size - (size + 1) % 2)
        if odd < 3:
            continue
        half = odd // 2
        hat = _quadratic_hat(odd)
        curve = values[first : first + size]
        smooth = out[first : first + size]
        smooth[half : size - half] = sliding_window_view(curve, odd, axis=0) @ hat[half]
        smooth[:half] = hat[:half] @ curve[:odd]
        smooth[size - half :] = hat[half + 1 :] @ curve[-odd:]
    return out


@lru_cache(maxsize=64)
def _quadratic_hat(window: int) -> Floats:
    """(window, window) matrix that takes equally spaced values to their least-squares quadratic."""
    powers = np.linspace(-1.0, 1.0, window)[:, None] ** np.arange(3)
    q, _ = np.linalg.qr(powers)
    hat: Floats = q @ q.T
    hat.flags.writeable = False
    return hat


def arc_middles(curves: BodyCurves, delta: int) -> Integers:
    """Index of the middle point of each three that are `delta` samples apart, from each curve's first on.

    N points give floor((N − 1) / delta) − 1 of them.
    """
    middles: Integers = middles_in_line(curves.first, curves.size, delta)
    return middles


_STRAIGHT = 1e-9  # sine of the bend below which three points lie on one line as far as float64 can tell


@kernel
def points_in_line(
    product: NDArray[np.int16], number: int, xyz_mm: Floats, row_px: Floats, step_max: float
) -> tuple[Integers, Integers, Integers, bool]:
    """Collect (slice, point) of one product's points with a height, and where a new curve begins.

    The last answer is False where a slice's rows do not increase: then the points want sorting first.
    """
    slices, points = product.shape
    slice_of, point_of = np.empty(product.size, np.int64), np.empty(product.size, np.int64)
    first = np.empty(product.size, np.int64)
    n, curves, in_order = 0, 0, True
    for s in range(slices):
        before = -math.inf
        for p in range(points):
            if product[s, p] != number or not math.isfinite(xyz_mm[s, p, 2]):
                continue
            step = row_px[s, p] - before
            if step <= 0.0:
                in_order = False
            if step > step_max:
                first[curves] = n
                curves += 1
            slice_of[n], point_of[n] = s, p
            before = row_px[s, p]
            n += 1
    return slice_of[:n].copy(), point_of[:n].copy(), first[:curves].copy(), in_order


@kernel
def middles_in_line(first: Integers, size: Integers, delta: int) -> Integers:
    """Index of the middle point of each three that are `delta` points apart, from each curve's first on."""
    middle = np.empty(size.sum() // delta, np.int64)
    n = 0
    for c in range(first.size):
        for m in range(first[c] + delta, first[c] + size[c] - delta, delta):
            middle[n] = m
            n += 1
    return middle[:n].copy()


@kernel
def pairs_in_line(one: Floats, other: Floats, slice_of: Integers, point_of: Integers) -> Floats:
    """Collect two (slice, point) quantities of points in line: (n, 2)."""
    pairs = np.empty((slice_of.size, 2))
    for k in range(slice_of.size):
        pairs[k, 0], pairs[k, 1] = one[slice_of[k], point_of[k]], other[slice_of[k], point_of[k]]
    return pairs


@kernel
def rows_reached(
    row_px: Floats, slice_of: Integers, point_of: Integers, first: Integers
) -> tuple[float, float, int]:
    """Lowest and highest row of points in line, and the rows between two curves of one slice, summed."""
    lowest, highest, between = math.inf, -math.inf, 0
    for k in range(slice_of.size):
        row = row_px[slice_of[k], point_of[k]]
        lowest, highest = min(lowest, row), max(highest, row)
    for c in range(1, first.size):
        k = first[c]
        if slice_of[k] == slice_of[k - 1]:
            step = row_px[slice_of[k], point_of[k]] - row_px[slice_of[k - 1], point_of[k - 1]]
            between += int(np.rint(step)) - 1
    return lowest, highest, between


@kernel
def slice_sums(
    slice_of: Integers,
    point_of: Integers,
    first: Integers,
    size: Integers,
    xyz_mm: Floats,
    seen: Flags,
    row_mm: float,
) -> tuple[Floats, Floats]:
    """Area (mm²) of each slice between belt and product, and of the heights' sizes its seen and bridged part.

    Each point's height counts times the length it stands for along Y: half the way to each neighbour in its
    curve, at an end as much outwards as inwards, and `row_mm` where a curve is one point.

    Returns
    -------
    sums
        (slice, 3) area, its seen part and its bridged part, of the heights' sizes, mm².
    y_mm
        (2,) smallest and largest Y of the points.
    """
    sums = np.zeros((xyz_mm.shape[0], 3))
    y_mm = np.array([math.inf, -math.inf])
    for c in range(first.size):
        last = first[c] + size[c] - 1
        for k in range(first[c], last + 1):
            s, p = slice_of[k], point_of[k]
            y, z = xyz_mm[s, p, 1], xyz_mm[s, p, 2]
            y_mm[0], y_mm[1] = min(y_mm[0], y), max(y_mm[1], y)
            before = abs(y - xyz_mm[slice_of[k - 1], point_of[k - 1], 1]) if k > first[c] else math.nan
            after = abs(xyz_mm[slice_of[k + 1], point_of[k + 1], 1] - y) if k < last else math.nan
            if k == first[c]:
                before = after
            if k == last:
                after = before
            length = row_mm if math.isnan(before) else 0.5 * (before + after)
            part = z * length
            sums[s, 0] += part
            sums[s, 1 if seen[s, p] else 2] += abs(part)
    return sums, y_mm


@kernel
def held_over(
    rest_mm: Floats, stripe: Integers, frame: Integers, dead: Flags
) -> tuple[Floats, Floats, Integers]:
    """Over what each live slice is held, slices in the order of their rest positions.

    Stripe numbers tell of stripes without a slice, within a frame: a scan's frames overlap as they like.

    Returns
    -------
    spacing
        (slice,) mm to the next live slice; 0 of dead ones and of the last.
    own
        (slice,) the part of it that reaches to the next stripe, dead or live, mm.
    missing
        (slice,) number of dead stripes in it.
    """
    count = rest_mm.size
    spacing, own, missing = np.zeros(count), np.zeros(count), np.zeros(count, np.int64)
    live = -1
    for k in range(count):
        if not dead[k]:
            if live >= 0:
                spacing[live] = rest_mm[k] - rest_mm[live]
                missing[live] -= 1
                if spacing[live] <= 0.0:
                    own[live] = 0.0
            live = k
        if k < count - 1:
            step = max(abs(stripe[k + 1] - stripe[k]), 1) if frame[k + 1] == frame[k] else 1
            if live >= 0:
                missing[live] += step
            if live == k:
                own[k] = (rest_mm[k + 1] - rest_mm[k]) / step
    if live >= 0:
        own[live], missing[live] = 0.0, 0
    return spacing, own, missing


@kernel
def circles(xy: Floats, middle: Integers, delta: int) -> tuple[Floats, Floats, Floats]:
    """Circles through points `delta` before, at and `delta` after each middle one, of (point, 2) places.

    Returns
    -------
    to_centre
        (middle, 2) vector from the middle point to the circle's centre; infinite where the three lie on one
        line.
    radius
        (middle,) its length.
    bow
        (middle,) distance of the middle point from the chord.
    """
    count = middle.size
    to_centre, radius, bow = np.full((count, 2), np.inf), np.empty(count), np.empty(count)
    for k in range(count):
        m = middle[k]
        ax, ay = xy[m - delta, 0] - xy[m, 0], xy[m - delta, 1] - xy[m, 1]
        bx, by = xy[m + delta, 0] - xy[m, 0], xy[m + delta, 1] - xy[m, 1]
        aa, bb = ax * ax + ay * ay, bx * bx + by * by
        cross = ax * by - ay * bx
        if abs(cross) > _STRAIGHT * math.sqrt(aa * bb):
            to_centre[k, 0] = (by * aa - ay * bb) / (2.0 * cross)
            to_centre[k, 1] = (ax * bb - bx * aa) / (2.0 * cross)
        radius[k] = math.hypot(to_centre[k, 0], to_centre[k, 1])
        chord = math.hypot(bx - ax, by - ay)
        bow[k] = abs(cross) / chord if chord > 0.0 else math.nan
    return to_centre, radius, bow
