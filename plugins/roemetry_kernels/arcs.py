"""Body curves of a product (what each stripe draws on it), and circles through points along them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from roemetry.arrays import Floats, Integers
from roemetry.records import Profiles

_STEP_MAX = 1.5  # rows; a larger step between neighbours means that rows are missing
_STRAIGHT = 1e-9  # sine of the bend below which three points lie on one line as far as float64 can tell


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
    on_product = (profiles.product == number) & np.isfinite(profiles.xyz_mm[:, :, 2])
    slices, points = np.nonzero(on_product)
    row_px = profiles.row_px[slices, points]
    step = np.diff(row_px)
    turn = np.diff(slices) != 0
    if bool(((step <= 0) & ~turn).any()):
        # Points of a slice may stand in any order; a curve is followed down the rows.
        order = np.lexsort((row_px, slices))
        slices, points, row_px = slices[order], points[order], row_px[order]
        step = np.diff(row_px)
    first = np.flatnonzero(np.concatenate([[slices.size > 0], turn | (step > _STEP_MAX)]))
    return BodyCurves(slices, points, first, np.diff(first, append=slices.size))


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


def _quadratic_hat(window: int) -> Floats:
    """(window, window) matrix that takes equally spaced values to their least-squares quadratic."""
    powers = np.linspace(-1.0, 1.0, window)[:, None] ** np.arange(3)
    q, _ = np.linalg.qr(powers)
    hat: Floats = q @ q.T
    return hat


def arc_middles(curves: BodyCurves, delta: int) -> Integers:
    """Index of the middle point of each three that are `delta` samples apart, from each curve's first on.

    N points give floor((N − 1) / delta) − 1 of them.
    """
    position = np.arange(curves.slice.size) - np.repeat(curves.first, curves.size)
    last = np.repeat(curves.size, curves.size) - 1
    return np.flatnonzero((position > 0) & (position % delta == 0) & (position + delta <= last))


def to_centres(before: Floats, middle: Floats, after: Floats) -> Floats:
    """Vectors from the middle point to the centre of the circle through three points, (n, 2).

    Its length is the circle's radius. Points on one line have none: both components are infinite then.
    """
    a, b = before - middle, after - middle
    aa, bb = (a * a).sum(axis=1), (b * b).sum(axis=1)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    bent = np.abs(cross) > _STRAIGHT * np.sqrt(aa * bb)
    across = np.stack([b[:, 1] * aa - a[:, 1] * bb, a[:, 0] * bb - b[:, 0] * aa], axis=1)
    centre: Floats = np.full_like(across, np.inf)
    np.divide(across, 2.0 * cross[:, None], out=centre, where=bent[:, None])
    return centre
