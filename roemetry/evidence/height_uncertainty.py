"""What the calibration's own uncertainty does to heights, over the volume it is meant for."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from roemetry.arrays import Floats
from roemetry.calibration import Calibration
from roemetry.records import BELT, NOTHING, StripeMap
from roemetry.stages import Triangulator

_LEVELS = 5
_ROWS = 3
_REDRAWS = 200
_SEED = 1


class HeightUncertainty(NamedTuple):
    """Standard uncertainty of heights by the calibration alone.

    Attributes
    ----------
    height_mm
        (level,) heights, mm.
    row_px
        (row,) image rows.
    std_mm
        (stripe, level, row) standard uncertainty, mm; NaN where the stripe is not in the image there.
    """

    height_mm: Floats
    row_px: Floats
    std_mm: Floats


def height_uncertainty(calibration: Calibration, triangulator: Triangulator[Any]) -> HeightUncertainty:
    """Triangulate points of known place with redrawn calibrations.

    Stripes are put where a level surface of each height would show them: by the view where that is exact,
    else by the displacement for each millimetre.
    """
    low, high = calibration.height_range_mm
    heights = np.linspace(max(low, 0.0), high, _LEVELS)
    rows = np.linspace(0.1, 0.9, _ROWS) * (calibration.image_size[0] - 1)
    rows = np.rint(rows)
    redraws = calibration.redraws(np.random.default_rng(_SEED))
    drawn = [next(redraws) for _ in range(_REDRAWS)]
    found = np.full((calibration.stripe_count, _LEVELS, _ROWS), np.nan)
    for level, height in enumerate(heights):
        stripes = _level(calibration, float(height))
        at = rows.astype(np.int64)
        z = np.stack([triangulator.triangulate(stripes, one).xyz_mm[:, at, 2] for one in drawn])
        found[:, level] = np.where(np.isnan(z).any(axis=0), np.nan, z.std(axis=0, ddof=1))
    return HeightUncertainty(heights, rows, found)


def _level(calibration: Calibration, height_mm: float) -> StripeMap:
    """Draw all stripes on a level surface."""
    rows, columns = calibration.image_size
    row = np.arange(rows, dtype=np.float64)
    rest = calibration.rest_line_px(row)
    view = calibration.view
    if view is not None and view.exact:
        x_px = _seen_at(calibration, row, height_mm)
    else:
        x_px = rest + calibration.displacement_px_per_mm[:, None] * height_mm
    x_px = np.where((x_px >= 0) & (x_px <= columns - 1), x_px, np.nan)
    there = np.isfinite(x_px)
    return StripeMap(
        x_px=x_px,
        x_std_px=np.where(there, 0.0, np.nan),
        product=np.where(there, BELT, NOTHING),
        seen=there,
        margin=np.full(x_px.shape, np.nan),
        ambiguous=np.zeros(x_px.shape, np.bool_),
        rest_px=rest,
        peak_stripe=np.empty(0, np.int16),
    )


def _seen_at(calibration: Calibration, row: Floats, height_mm: float) -> Floats:
    """(stripe, row) x where each stripe's plane is at a height in each image row, px: by regula falsi."""
    view = calibration.view
    if view is None:
        raise AssertionError("an exact view was promised")
    count, columns = calibration.stripe_count, calibration.image_size[1]
    stripe = np.broadcast_to(np.arange(count)[:, None], (count, row.size))

    def above(x_px: Floats) -> Floats:
        xy = np.stack([x_px, np.broadcast_to(row, x_px.shape)], axis=-1)
        return view.lift(xy, stripe)[..., 2] - height_mm

    start = calibration.rest_line_px(row)
    step = calibration.displacement_px_per_mm[:, None] * max(height_mm, 1.0)
    x0, x1 = start, np.clip(start + step, -columns, 2.0 * columns)
    z0, z1 = above(x0), above(x1)
    for _ in range(20):
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(np.abs(z1 - z0) > 0, x1 - z1 * (x1 - x0) / (z1 - z0), x1)
        x0, z0, x1 = x1, z1, ahead
        z1 = above(x1)
    return np.where(np.abs(z1) < 1e-6, x1, np.nan)
