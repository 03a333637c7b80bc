"""Torn frames: rows that were lost, or a frame whose lower part is another's.

Model. A product's surface is continuous from row to row, and where it is not (an edge, a step), the edge
crosses the stripes one after another: only by accident do five stripes and more jump between the same two
rows while each lies on a product before and after. A sensor's or a transport's fault tears all of them there.
The jump of a stripe between rows r and r + 1 is its step less the mean of the steps before and after it, so
that a slope is none; belt is left out, for its lines hardly change from row to row, and so are the product's
ends.

Fails where the tear crosses no product (then it harms none), where what is joined fits by accident, and on
steps that lie along the rows to a quarter of a degree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from roemetry.records.arrays import Floats, Integers
from roemetry_kernels.compiling import float_kernel
from roemetry_kernels.image_levels import median_of

_OFF_BELT_PX = 2.0
"""Peaks farther from every rest line lie on a product."""
_REACH_SHARE = 1.0
"""Of the lines' distance: as far is a stripe looked for in the next row; farther away none is near."""
_STEP_MAX_PX = 3.0
"""Steps before and after the jump are those of a surface that this camera sees whole."""
_STRIPES_MIN = 5
_JUMP_MIN_PX = 0.4
"""A median jump below it moves no volume by more than some tenths of a percent."""
_ROUNDED_JUMP_MIN_PX = 2.5
"""The same for peaks in whole pixels: rounding alone makes jumps of up to two."""
_TIMES_USUAL = 8.0
"""So many times the jumps of the frame's other rows, which noise and texture make. Of 56 whole images of two
makers the largest jump is five times the mean."""


class Tear(NamedTuple):
    """A frame's tear: the row after which it lies, and the median jump there, px."""

    row: int
    jump_px: float


def tear_of(row_start: Integers, x_px: Floats, lines_px: Floats, spacing_px: float) -> Tear | None:
    """Give the tear of a frame; None of a whole one.

    Parameters
    ----------
    row_start, x_px
        Of the peaks.
    lines_px
        (row, stripe) rest lines, px.
    spacing_px
        Their smallest distance.
    """
    jump = _median_jumps(
        row_start, x_px, lines_px, _REACH_SHARE * spacing_px, _OFF_BELT_PX, _STEP_MAX_PX, _STRIPES_MIN
    )
    if np.isnan(jump).all():
        return None
    worst = int(np.nanargmax(jump))
    usual = float(np.nanmean(jump))  # the median of whole-pixel peaks may be 0
    rounded = bool((x_px == np.rint(x_px)).all())
    least = max(_ROUNDED_JUMP_MIN_PX if rounded else _JUMP_MIN_PX, _TIMES_USUAL * usual)
    return Tear(worst, float(jump[worst])) if jump[worst] >= least else None


@float_kernel
def _median_jumps(
    row_start: Integers, x_px: Floats, lines_px: Floats, reach_px: float, off_belt_px: float,
    step_max_px: float, stripes_min: int,
) -> Floats:  # fmt: skip
    """Give for each row the median jump of the product's stripes to the next, px; NaN for too few stripes."""
    rows, stripes = lines_px.shape
    median = np.full(rows, np.nan)
    on_product = np.zeros(x_px.size, np.bool_)
    for row in range(rows):
        line = 0
        for p in range(row_start[row], row_start[row + 1]):
            while line < stripes - 1 and abs(x_px[p] - lines_px[row, line + 1]) < abs(
                x_px[p] - lines_px[row, line]
            ):
                line += 1
            on_product[p] = abs(x_px[p] - lines_px[row, line]) > off_belt_px
    jumps = np.empty(64 if stripes < 32 else 2 * stripes)
    for row in range(1, rows - 2):
        count, before, after = 0, row_start[row - 1], row_start[row + 1]
        last = row_start[row + 2]
        for p in range(row_start[row], row_start[row + 1]):
            if not on_product[p] or count >= jumps.size:
                continue
            before = _nearest(x_px, before, row_start[row], x_px[p])
            after = _nearest(x_px, after, row_start[row + 2], x_px[p])
            if before < 0 or after < 0:
                break
            last = _nearest(x_px, last, row_start[row + 3], x_px[after])
            if last < 0:
                break
            first_step = x_px[p] - x_px[before]
            last_step = x_px[last] - x_px[after]
            step = x_px[after] - x_px[p]
            near = abs(first_step) <= step_max_px and abs(last_step) <= step_max_px and abs(step) <= reach_px
            if near and on_product[before] and on_product[after] and on_product[last]:
                jumps[count] = abs(step - 0.5 * (first_step + last_step))
                count += 1
        if count >= stripes_min:
            median[row] = median_of(jumps[:count])
    return median


@float_kernel
def _nearest(x_px: Floats, start: int, stop: int, at_px: float) -> int:
    """Give the peak of a row, from `start` on, that is nearest to a place; −1 of an empty row."""
    if start >= stop:
        return -1
    found = start
    while found + 1 < stop and abs(x_px[found + 1] - at_px) <= abs(x_px[found] - at_px):
        found += 1
    return found
