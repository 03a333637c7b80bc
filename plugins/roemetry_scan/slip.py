"""How far a product slips against the encoder, by the disagreement of several lines.

A second stripe sees the same surface after the belt has run the distance ℓ between both stripes. If the
product went ℓ(1 + s) on that way, its heights come out displaced by δ = s·ℓ along the belt: on slopes
z_x the two scans then differ by Δz = a − δ·z_x, with an a that both stripes' calibrations may differ by. In
each of some windows along the belt δ is fitted by least squares, with its uncertainty by the residuals.

Blind where a product has no slope along the belt; a single line cannot tell slip at all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from roemetry.records import Reason
from roemetry.records.arrays import Floats

_WINDOWS = 12
_ACROSS = 64
"""Windows along the scan, and places across it at which heights are compared."""
_SLOPE_MIN = 0.05
"""Flatter places tell little of δ and only dilute its uncertainty."""
_GAP_STEPS = 2.5
"""Neighbours farther apart than so many usual steps are not joined."""
_POINTS_MIN = 40  # of a window, on slopes: fewer tell no δ
_SIGNIFICANT = 5.0
"""Standard deviations of δ: of 12 windows one passes that by chance in 150,000 scans."""
_SHARE_MIN = 0.004
"""Slip below this share is within what calibrations of two planes disagree by on slopes."""


def slip_of(xyz_mm: Floats, others: Mapping[float, Floats]) -> tuple[float, tuple[Reason, ...]]:
    """Give the relative slip (root of the mean square beyond noise) and what is to be said of it.

    Parameters
    ----------
    xyz_mm
        (line, row, 3) the placed points of the stripe that slices are made of, mm.
    others
        The same of each other stripe, by how far the belt runs between both, mm.
    """
    x, y = _grid(xyz_mm)
    if x.size < 3:
        return math.nan, ()
    mine = resampled(xyz_mm, x, y)
    # of the surface along the belt, per mm
    slope = np.gradient(mine, x, axis=0)
    squares, worst = [], (0.0, 0.0)
    for lag_mm, points in others.items():
        # heights of one place of the product: what differs is slip, and the stripes' calibrations
        apart = resampled(points, x, y) - mine
        for window in np.array_split(np.arange(x.size), _WINDOWS):
            found = _displacement(apart[window], slope[window])
            if found is None:
                continue
            share, std = found[0] / abs(lag_mm), found[1] / abs(lag_mm)
            # what the uncertainty explains is not counted as slip
            squares.append(max(0.0, share**2 - std**2))
            if abs(share) > max(_SHARE_MIN, _SIGNIFICANT * std) and abs(share) > abs(worst[0]):
                worst = share, std
    if not squares:
        return math.nan, ()
    slip = math.sqrt(float(np.mean(squares)))
    if worst[0] == 0.0:
        return slip, ()
    # a slip that was plainly seen in one window holds for all: the worst counts
    return max(slip, abs(worst[0])), (
        Reason(
            "slip",
            f"two stripes disagree: the product slips by {abs(worst[0]):.1%} ± {worst[1]:.1%} of its way "
            "against the counter; the volume's uncertainty includes it",
        ),
    )


def _grid(xyz_mm: Floats) -> tuple[Floats, Floats]:
    """Give places along (every line's) and across the scan, rising."""
    with np.errstate(all="ignore"):
        x = np.sort(np.nanmedian(xyz_mm[..., 0], axis=1))
    low, high = np.nanquantile(xyz_mm[..., 1], [0.02, 0.98])
    # lines without any point have no place
    x = x[np.isfinite(x)]
    return x[np.concatenate([[True], np.diff(x) > 1e-9])], np.linspace(low, high, _ACROSS)


def resampled(xyz_mm: Floats, x: Floats, y: Floats) -> Floats:
    """Give (x, y) heights by straight lines, along each line first; NaN where a neighbour is not seen."""
    lines = len(xyz_mm)
    at_x, height = np.full((lines, y.size), np.nan), np.full((lines, y.size), np.nan)
    for k, line in enumerate(xyz_mm):
        # along each line first, where points are dense
        known = line[np.isfinite(line[:, 0])]
        if len(known) < 2:
            continue
        known = known[np.argsort(known[:, 1])]
        at_x[k] = np.interp(y, known[:, 1], known[:, 0], np.nan, np.nan)
        height[k] = _interpolated(y, known[:, 1], known[:, 2])
    found = np.full((x.size, y.size), np.nan)
    for k in range(y.size):
        there = np.isfinite(height[:, k])
        if np.count_nonzero(there) > 1:
            order = np.argsort(at_x[there, k])
            found[:, k] = _interpolated(x, at_x[there, k][order], height[there, k][order])
    return found


def _interpolated(at: Floats, x: Floats, z: Floats) -> Floats:
    """Join neighbours by straight lines; NaN where the next one is missing, or the surface breaks off."""
    found = np.interp(at, x, z, np.nan, np.nan)
    after = np.clip(np.searchsorted(x, at), 1, len(x) - 1)
    # over a gap or a break no straight line is the surface
    gap, rise = x[after] - x[after - 1], z[after] - z[after - 1]
    return np.where(
        (gap > _GAP_STEPS * np.median(np.diff(x))) | (np.abs(rise) > 3.0 * gap + 0.2), np.nan, found
    )


def _displacement(apart_mm: Floats, slope: Floats) -> tuple[float, float] | None:
    """Give δ and its standard uncertainty, mm, of one window; None where no slope tells it."""
    # very steep places are walls: a small shift makes any height difference there
    good = np.isfinite(apart_mm) & np.isfinite(slope) & (np.abs(slope) > _SLOPE_MIN) & (np.abs(slope) < 2.0)
    for _ in range(3):
        if np.count_nonzero(good) < _POINTS_MIN:
            return None
        # Δz = a − δ·z_x
        design = np.column_stack([np.ones(int(good.sum())), -slope[good]])
        fit, *_ = np.linalg.lstsq(design, apart_mm[good], rcond=None)
        left = apart_mm - fit[0] + fit[1] * slope
        spread = 1.4826 * float(np.median(np.abs(left[good]))) + 1e-9
        # without what lies off by more than noise, three times
        good = good & (np.abs(left) < 4.0 * spread)
    if np.count_nonzero(good) < _POINTS_MIN:
        return None
    # standard uncertainty of a slope: spread over the root of the regressor's sum of squares
    steep = slope[good] - slope[good].mean()
    sum_of_squares = float(steep @ steep)
    if sum_of_squares < 1e-9:
        return None
    return float(fit[1]), spread / math.sqrt(sum_of_squares)
