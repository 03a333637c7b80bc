"""Slices of a product as arrays: their points by product, smoothed along each curve.

It assumes points at even distances along a curve, as rows are. It fails to keep what is shorter than the
window.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roemetry.records import Profiles
from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel, kernel

_STEP_MAX = 1.5  # rows; a larger step between neighbours means that rows are missing


class BodyCurves(NamedTuple):
    """A product's points in a line: slice after slice, down the rows, cut where rows are missing."""

    slice: Integers
    point: Integers
    """slice, point: (n,) where each point stands in `Profiles`."""
    first: Integers
    """(curve,) index of each curve's first point in the above."""
    size: Integers
    """(curve,) number of points of each curve."""


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
    smooth: Floats = smoothed_curves(values, curves.first, curves.size, window)
    return smooth


@float_kernel
def smoothed_curves(values: Floats, first: Integers, size: Integers, window: int) -> Floats:
    """Smooth curves as `smoothed` says: by 1, t and t² − its mean, which are orthogonal on even places."""
    out = values.copy()
    for curve in range(first.size):
        begin, count = first[curve], size[curve]
        # the longest odd window that fits
        odd = min(window, count - (count + 1) % 2)
        if odd < 3:
            continue
        half = odd // 2
        # mean of t² over the window
        mean = half * (half + 1) / 3.0
        of_line, of_bow = 0.0, 0.0
        for t in range(-half, half + 1):
            of_line += t * t
            of_bow += (t * t - mean) ** 2
        for at in range(count):
            # at a curve's end the window stays and the place moves within it
            start = min(max(at - half, 0), count - odd)
            place = float(at - start - half)
            for k in range(values.shape[1]):
                total = 0.0
                for tap in range(odd):
                    off = float(tap - half)
                    weight = place * off / of_line + (place * place - mean) * (off * off - mean) / of_bow
                    total += (weight + 1.0 / odd) * values[begin + start + tap, k]
                out[begin + at, k] = total
    return out


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
