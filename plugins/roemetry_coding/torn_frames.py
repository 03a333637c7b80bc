"""Torn frames: rows that were lost, or a frame whose lower part is another's.

Model. A product's surface is continuous from row to row, and where it is not (an edge, a step), the edge
crosses the stripes one after another: only by accident do five stripes and more jump between the same two
rows while each lies on a product before and after. A sensor's or a transport's fault tears all of them there.
The jump of a stripe between rows r and r + 1 is its step less the mean of the steps before and after it, so
that a slope is none; the product's ends are left out. On the belt it is the step less that of the rest line:
where all jump alike, what follows was taken from another place.

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
_SAMPLED_ROWS = 8
"""Every so many rows tell how much stripes usually jump."""


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
    rounded = bool((x_px == np.rint(x_px)).all())
    least_px = _ROUNDED_JUMP_MIN_PX if rounded else _JUMP_MIN_PX
    row, jump_px, usual_px = _largest_jump(
        row_start, x_px, lines_px, _REACH_SHARE * spacing_px, _OFF_BELT_PX, _STEP_MAX_PX, _STRIPES_MIN,
        _SAMPLED_ROWS, _TIMES_USUAL, least_px,
    )  # fmt: skip
    return Tear(row, jump_px) if row >= 0 and jump_px >= max(least_px, _TIMES_USUAL * usual_px) else None


@float_kernel
def _largest_jump(
    row_start: Integers, x_px: Floats, lines_px: Floats, reach_px: float, off_belt_px: float,
    step_max_px: float, stripes_min: int, sampled: int, times_usual: float, least_px: float,
) -> tuple[int, float, float]:  # fmt: skip
    """Give the row, the median jump and the usual jump where product or belt jump most; row −1 of none."""
    rows, stripes = lines_px.shape
    on_product = np.empty(x_px.size, np.bool_)
    # of each peak: the nearest one in the next row, −1 where none is near; the peak whose nearest it is; the
    # step to the next row, and what that is beside the rest line's
    after, before = np.full(x_px.size, -1, np.int32), np.full(x_px.size, -1, np.int32)
    step, slip = np.empty(x_px.size), np.empty(x_px.size)
    for row in range(rows - 1):
        line, nearest, stop = 0, row_start[row + 1], row_start[row + 2]
        for p in range(row_start[row], row_start[row + 1]):
            x = x_px[p]
            while line < stripes - 1 and abs(x - lines_px[row, line + 1]) < abs(x - lines_px[row, line]):
                line += 1
            on_product[p] = abs(x - lines_px[row, line]) > off_belt_px
            if nearest == stop:
                continue
            while nearest + 1 < stop and abs(x_px[nearest + 1] - x) <= abs(x_px[nearest] - x):
                nearest += 1
            step[p] = x_px[nearest] - x
            if abs(step[p]) <= reach_px:
                after[p], before[nearest] = nearest, p
                slip[p] = step[p] - (lines_px[row + 1, line] - lines_px[row, line])
    jumps, slips = np.empty(2 * stripes + 64), np.empty(2 * stripes + 64)
    # of product and belt: rows that count, the sum of their jumps, the row that jumps most, and its jump
    counted, total = np.zeros(2), np.zeros(2)
    worst, most = np.full(2, -1), np.zeros(2)
    for row in range(1, rows - 2):
        count, slipped, large, large_slips = 0, 0, 0, 0
        for p in range(row_start[row], row_start[row + 1]):
            if max(count, slipped) >= jumps.size:
                break
            if after[p] < 0:
                continue
            if not on_product[p]:
                slips[slipped] = slip[p]
                large_slips += abs(slip[p]) >= least_px
                slipped += 1
                continue
            first, third = before[p], after[p]
            if first < 0 or after[third] < 0:
                continue
            near = abs(step[first]) <= step_max_px and abs(step[third]) <= step_max_px
            if near and on_product[first] and on_product[third] and on_product[after[third]]:
                jumps[count] = abs(step[p] - 0.5 * (step[first] + step[third]))
                large += jumps[count] >= least_px
                count += 1
        for kind in range(2):
            found = jumps[:count] if kind == 0 else slips[:slipped]
            most_are_large = 4 * (large if kind == 0 else large_slips) >= 3 * found.size
            # among few belt peaks are those of a product's rim, which steps
            if found.size < stripes_min or (kind == 1 and 4 * found.size < 3 * stripes):
                continue
            counts = row % sampled == 0  # a median takes long
            if counts or most_are_large:
                jump = abs(median_of(found))
                if counts:
                    counted[kind] += 1.0
                    total[kind] += jump
                if jump > most[kind]:
                    worst[kind], most[kind] = row, jump
    usual = total / np.maximum(counted, 1.0)
    kind = 0 if most[0] >= max(least_px, times_usual * usual[0]) else 1
    return worst[kind], most[kind], usual[kind]
