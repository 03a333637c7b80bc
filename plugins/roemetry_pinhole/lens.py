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
    from roemetry_kernels.calibration.lens_bending import bend

    return Bent(*bend(np.ascontiguousarray(xy), np.ascontiguousarray(coefficients)))


def straightened(places: Floats, coefficients: Floats, start: Floats | None = None) -> Floats:
    """Undistort places (n, 2) by Newton's method."""
    if not coefficients.any():
        return places
    from roemetry_kernels.calibration.straightening import straighten

    places = np.ascontiguousarray(places)
    begin = places if start is None else np.ascontiguousarray(start)
    return np.asarray(straighten(places, np.ascontiguousarray(coefficients), begin))
