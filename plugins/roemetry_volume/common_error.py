"""What the heights of all of a product's points may be wrong by together.

Each point's stated uncertainty s holds two things: noise, which differs from row to row, and what the model
of the stripe's profile may be wrong by, which does not: light that enters tissue comes out beside the stripe
by nearly the same in all rows (Farrell, Patterson, Wilson 1992, Medical Physics 19:879–888). Noise averages
out over thousands of points; the rest does not. Noise shows: the second differences of heights along a stripe
scatter by √6 n, n its standard deviation, on any surface that is smooth over three rows. So

    common² = ½ (median(s)² − median|z₋₁ − 2 z₀ + z₊₁|² · (1.4826² / 6)), not less than 0.

Half of the variance, since tissue differs over some millimetres, which averages out over a product and not
over three rows.

Assumed: noise of neighbouring rows is independent (an extractor that smooths along the stripe shows less
noise than it has, and counts as surer than it is of nothing: the interval is too wide), and the stated
uncertainty is right. It fails towards 0 where the surface is rough from row to row.
"""

from __future__ import annotations

import math

import numpy as np

from roemetry.records import Product
from roemetry.records.arrays import Flags, Floats, Labels
from roemetry_kernels.compiling import kernel

_SHARED = 0.5
"""Of the variance that does not scatter from row to row. On 23 skeins on five rigs of two renderers with
tissue the mean height was off by 0.0 to 1.5 of its root, 0.8 root mean square; with 0.5 all their intervals
hold (plain-light outline), with 1 they are up to a quarter wider."""
_EVERY = 3
"""Points of which one is looked at: medians of some hundreds are within 5 %, and take a few microseconds."""
_POINTS_MIN = 30
"""Fewer second differences than that say nothing of noise (their median is uncertain by a quarter)."""


def common_height_std_mm(product: Product) -> float:
    """Give the standard uncertainty that all of a product's heights share, mm; 0 where none is stated."""
    profiles = product.profiles
    common: float = _common_std_mm(
        profiles.xyz_mm,
        profiles.height_std_mm,
        profiles.row_px,
        profiles.product,
        profiles.seen,
        product.number,
    )
    return common


@kernel
def _common_std_mm(
    xyz_mm: Floats, height_std_mm: Floats, row_px: Floats, on: Labels, seen: Flags, number: int
) -> float:
    slices, points = on.shape
    stated, second = np.empty(slices * points // _EVERY + 1), np.empty(slices * points // _EVERY + 1)
    count, m = 0, 0
    for i in range(slices):
        for k in range(1, points - 1):
            if on[i, k] != number or on[i, k - 1] != number or on[i, k + 1] != number:
                continue
            if not (seen[i, k] and seen[i, k - 1] and seen[i, k + 1] and height_std_mm[i, k] > 0.0):
                continue
            if abs(row_px[i, k + 1] - row_px[i, k - 1]) > 2.5:
                continue
            m += 1
            if m % _EVERY == 0:
                stated[count] = height_std_mm[i, k]
                second[count] = abs(xyz_mm[i, k - 1, 2] - 2.0 * xyz_mm[i, k, 2] + xyz_mm[i, k + 1, 2])
                count += 1
    if count < _POINTS_MIN:
        return 0.0
    noise = 1.4826 * np.median(second[:count])
    return math.sqrt(_SHARED * max(np.median(stated[:count]) ** 2 - noise * noise / 6.0, 0.0))
