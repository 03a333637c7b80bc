"""Found points beside true ones, row by row."""

from __future__ import annotations

import numpy as np

from roemetry.records import Frame, Reason, StripeTruth
from roemetry.records.arrays import Floats, Integers

REACH_PX = 3.0
"""Farther than this from a stripe's true centre, px, a point is not taken for a point of that stripe."""


def truth_in(frame: Frame, truth: StripeTruth, turn_deg: int = 0) -> StripeTruth | Reason:
    """Give the truth, which is of the image turned by the data set's `turn_deg`, in the turned image.

    Or why that cannot be: half a turn maps centres of rows on centres of rows. A quarter makes rows of
    columns, and where a stripe crosses those is not in the truth.
    """
    rows, columns = frame.size
    further = (frame.turn_deg - turn_deg) % 360
    if further in (90, 270):
        return Reason(
            "truth-other-turn",
            f"the image is turned by {frame.turn_deg}°, and the truth of its stripes is given for the rows "
            f"of the image turned by {turn_deg}°, as the data set's turn_deg says",
        )
    if truth.x_px.shape[1] != rows:
        return Reason(
            "truth-other-size", f"the image has {rows} rows, the truth of its stripes {truth.x_px.shape[1]}"
        )
    if further == 0:
        return truth
    return StripeTruth(
        columns - 1 - truth.x_px[::-1, ::-1],
        truth.on_product[::-1, ::-1],
        truth.xyz_mm[::-1, ::-1],
        truth.product[::-1, ::-1],
    )


def nearest(row: Integers, x_px: Floats, other_row: Integers, other_x_px: Floats) -> Integers:
    """Find for each point the nearest other point of its row within `REACH_PX`.

    Parameters
    ----------
    row, x_px
        (point,) the points; any order.
    other_row, other_x_px
        (other,) the points to choose from; any order.

    Returns
    -------
    ndarray
        (point,) index of the other point, −1 where there is none.
    """
    if row.size == 0 or other_row.size == 0:
        return np.full(row.shape, -1, np.int64)
    low = min(float(x_px.min()), float(other_x_px.min()))
    high = max(float(x_px.max()), float(other_x_px.max()))
    apart = high - low + 4.0 * REACH_PX  # rows laid end to end, so far apart that they cannot meet
    here, there = row * apart + x_px, other_row * apart + other_x_px
    order = np.argsort(there, kind="stable")
    place = np.searchsorted(there[order], here)
    left = order[np.clip(place - 1, 0, order.size - 1)]
    right = order[np.clip(place, 0, order.size - 1)]
    near = np.where(np.abs(there[left] - here) <= np.abs(there[right] - here), left, right)
    within = (other_row[near] == row) & (np.abs(other_x_px[near] - x_px) <= REACH_PX)
    return np.where(within, near, -1)
