"""Lens distortion in OpenCV's rational model, with its derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.arrays import Floats

COEFFICIENTS = 8
"""k1, k2, p1, p2, k3, k4, k5, k6: OpenCV's order."""


class Bent(NamedTuple):
    """Distorted places (n, 2) on the plane at distance 1, and their derivatives.

    `by_place` is (n, 2, 2), `by_coefficient` (n, 2, 8).
    """

    xy: Floats
    by_place: Floats
    by_coefficient: Floats


def bent(xy: Floats, coefficients: Floats) -> Bent:
    """Distort places (n, 2) by eight coefficients."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    r4, r6 = r2 * r2, r2 * r2 * r2
    above = 1.0 + k1 * r2 + k2 * r4 + k3 * r6
    below = 1.0 + k4 * r2 + k5 * r4 + k6 * r6
    radial = above / below
    slope = (k1 + 2.0 * k2 * r2 + 3.0 * k3 * r4 - radial * (k4 + 2.0 * k5 * r2 + 3.0 * k6 * r4)) / below
    xy2 = 2.0 * x * y
    places = np.column_stack(
        [x * radial + p1 * xy2 + p2 * (r2 + 2.0 * x * x), y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy2]
    )
    by_place = np.empty((x.size, 2, 2))
    by_place[:, 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_place[:, 0, 1] = by_place[:, 1, 0] = xy2 * slope + 2.0 * p1 * x + 2.0 * p2 * y
    by_place[:, 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    by_coefficient = np.empty((x.size, 2, COEFFICIENTS))
    for column, factor in enumerate((r2, r4, None, None, r6)):
        if factor is not None:
            by_coefficient[:, :, column] = xy * (factor / below)[:, None]
    by_coefficient[:, 0, 2], by_coefficient[:, 1, 2] = xy2, r2 + 2.0 * y * y
    by_coefficient[:, 0, 3], by_coefficient[:, 1, 3] = r2 + 2.0 * x * x, xy2
    for column, factor in ((5, r2), (6, r4), (7, r6)):
        by_coefficient[:, :, column] = -xy * (factor * radial / below)[:, None]
    return Bent(places, by_place, by_coefficient)


def straightened(places: Floats, coefficients: Floats, start: Floats | None = None) -> tuple[Floats, Bent]:
    """Undistort places (n, 2) by Newton's method; give the result and how it is bent there."""
    if not coefficients.any():
        return places, bent(places, coefficients)
    from roemetry_kernels.straightening import straighten

    places = np.ascontiguousarray(places)
    begin = places if start is None else np.ascontiguousarray(start)
    xy = straighten(places, np.ascontiguousarray(coefficients), begin)
    return xy, bent(xy, coefficients)
